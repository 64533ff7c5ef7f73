"""Did a simulation blow up? MuJoCo puts one back to finite values at time zero; only its warning counters tell."""

from __future__ import annotations

import mujoco
import numpy as np

_COUNTED = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)  # BADQVEL between
_MARK = 1 << 20
"""What the counters are set to beforehand. From zero MuJoCo would print every sample that blows up."""


def watch(data: mujoco.MjData) -> None:
    """Begin to look out, after the state was loaded."""
    data.warning.number[_COUNTED] = _MARK


def blew_up(data: mujoco.MjData) -> bool:
    """Whether the simulation has blown up since :func:`watch`.

    MuJoCo's own reset clears the counters and then counts one; without it (autoreset disabled) they count on. All
    zero is a reset by the task.
    """
    return any(count not in (0, _MARK) for count in data.warning.number[_COUNTED].tolist())


def any_blew_up(diverged: np.ndarray, features: np.ndarray) -> np.ndarray:
    """Bool ``(N,)``: of samples marked as ``diverged`` ``(N,)``, or with features ``(N, H, F)`` that are not finite."""
    return (diverged != 0.0) | ~np.isfinite(features).all((1, 2))
