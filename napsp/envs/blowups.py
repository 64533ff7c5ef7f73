"""Noticing that a simulation blew up: MuJoCo resets it without a word, and what follows is no physics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import mujoco
import numpy as np

WARNINGS = [int(kind) for kind in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
                                   mujoco.mjtWarning.mjWARN_BADQACC)]  # fmt: skip


class BlowUpDetector:
    """Tells after every step of an environment whether it left physics; :meth:`begin` after every reset.

    Args:
        env: any; of one that simulates otherwise than by an ``MjData`` named ``data``, numbers that are not finite are
            all that can be noticed.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        self._env, self._warned, self._time = env, 0, 0.0

    def begin(self) -> None:
        """What is now is physics."""
        self._warned, self._time = self._clock()

    def blew_up(self, observation: Mapping[str, Any], over: bool) -> bool:
        """Whether the last step led to ``observation`` by a blow-up.

        Args:
            observation: with Gymnasium's three keys.
            over: the environment has ended the episode, and may have reset itself.
        """
        warned, time = self._clock()
        reset = warned > self._warned or (time < self._time and not over)
        self._warned, self._time = warned, time
        return reset or not all(np.isfinite(observation[part]).all() for part in ("observation", "achieved_goal"))

    def _clock(self) -> tuple[int, float]:
        """MuJoCo's warnings of unstable states so far, and its time."""
        data: Any = getattr(self._env.unwrapped, "data", None)
        if not isinstance(data, mujoco.MjData):
            return 0, 0.0
        return sum(int(data.warning[kind].number) for kind in WARNINGS), float(data.time)
