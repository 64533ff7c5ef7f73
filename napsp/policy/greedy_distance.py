"""The action that a distance itself calls best: a = argmin_a d(s, a, g), by search over actions."""

from __future__ import annotations

import numpy as np
import torch

from napsp.distance.network import DistanceNetwork


class GreedyDistance:
    """Follows d downhill, one action at a time; needs no policy and no simulation.

    Candidates fill the action space; further rounds look around the best one so far, each at half
    the width. They are the same at every state, so equal states get equal actions.

    Args:
        distance: d(s, a, g).
        n_actions: A.
        n_candidates: actions compared per round.
        n_rounds: of comparison.
        seed: of the candidates.
    """

    def __init__(
        self, distance: DistanceNetwork, n_actions: int, n_candidates: int = 64, n_rounds: int = 3, seed: int = 0
    ) -> None:
        rng = np.random.default_rng(seed)
        offsets = rng.uniform(-1.0, 1.0, (n_candidates, n_actions)).astype(np.float32)
        offsets[0] = 0.0  # the best one so far
        self._distance, self._offsets, self._n_rounds = distance, torch.from_numpy(offsets), n_rounds

    def __call__(self, observations: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Actions ``(B, A)`` in [-1, 1] for float32 observations ``(B, O)`` and goals ``(B, G)``."""
        n_rows, (n_candidates, n_actions) = len(observations), self._offsets.shape
        states, wanted = (torch.from_numpy(rows).repeat_interleave(n_candidates, 0) for rows in (observations, goals))
        best, width = torch.zeros(n_rows, n_actions, dtype=torch.float32), 1.0
        with torch.inference_mode():
            for _ in range(self._n_rounds):
                actions = (best[:, None] + width * self._offsets).clamp(-1.0, 1.0)
                # Not clipped to [0, T]: where all are far, the raw prediction still orders them.
                steps = self._distance(states, actions.reshape(-1, n_actions), wanted).reshape(n_rows, n_candidates)
                best, width = actions[torch.arange(n_rows), steps.argmin(1)], 0.5 * width
        return best.numpy()
