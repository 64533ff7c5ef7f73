"""How smooth a motion is."""

from __future__ import annotations

import numpy as np


def action_rate(actions: np.ndarray) -> float:
    """Mean squared change from one action to the next of actions ``(T, A)``, in action units."""
    return float(np.square(np.diff(actions.astype(float), axis=0)).sum(-1).mean()) if len(actions) > 1 else 0.0


def jerk(positions: np.ndarray, control_step: float) -> float:
    """Root mean square of the third derivative of positions ``(T, P)``, taken ``control_step`` seconds apart."""
    if len(positions) < 4:
        return 0.0
    third = np.diff(positions, 3, axis=0) / control_step**3
    return float(np.sqrt(np.square(third).sum(-1).mean()))
