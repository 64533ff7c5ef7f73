"""The critic of a trained policy, read as steps: a yardstick for distances that costs nothing extra."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from napsp.errors import UserError
from napsp.policy.critic import Critic
from napsp.storage.checkpoint import Model
from napsp.storage.files import read_tensors
from napsp.storage.state import STATE_FILE

PREFIX = "critic."


def load_critic(folder: Path, model: Model) -> Critic:
    """The critic of a finished run, from its training state.

    Raises:
        UserError: that is gone; the model alone holds no critic.
    """
    path, policy = folder / STATE_FILE, model.config.policy
    if not path.is_file():
        raise UserError(f"{path} is missing, and a model alone holds no critic; train it again")
    tensors = {name.removeprefix(PREFIX): value for name, value in read_tensors(path, "training state")[0].items()
               if name.startswith(PREFIX)}  # fmt: skip
    n_critics = 2 if policy.agent == "sac" else 1 + policy.clipped_double_q
    critic = Critic(tuple(model.header["sizes"]), model.config.hidden, n_critics)
    critic.load_state_dict(tensors)
    return critic


def critic_steps(folder: Path, model: Model) -> Callable[[np.ndarray, np.ndarray | None, np.ndarray], np.ndarray]:
    """Steps ``(n,)`` that the sparse critic of a finished run means, within [1, T].

    n further steps at a reward of -1, discounted, are worth Q = -(1 - discount^n) / (1 - discount). Of several critics
    the least value counts, as in their own training.

    Raises:
        UserError: the run's training state is gone; the model alone holds no critic.
    """
    config = model.config
    if config.learns_distance:
        raise UserError(f"{folder} was trained with --method {config.method}, whose critic's rewards are no steps")
    critic = load_critic(folder, model)
    discount, length = config.policy.discount, model.header["episode_length"]

    def steps(observations: np.ndarray, actions: np.ndarray | None, goals: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            rows = [torch.from_numpy(np.asarray(part, np.float32)) for part in (observations, goals)]
            chosen = model.policy.mode(*rows) if actions is None else torch.from_numpy(actions.astype(np.float32))
            values = critic(rows[0], chosen, rows[1]).amin(0).double()
            left = (1.0 + values * (1.0 - discount)).clamp(min=discount ** (length - 1), max=1.0)
            return (1.0 + left.log() / np.log(discount)).numpy()

    return steps
