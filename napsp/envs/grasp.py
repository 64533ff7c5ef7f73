"""A scripted grasp: the head start that training episodes of pick and place may ask for.

Andrychowicz et al. (2017) start half of their pick-and-place episodes with the box in the
gripper, without which random play hardly ever lifts it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

STEP_LENGTH = 0.033  # metres per control step at full action
ABOVE = 0.07  # metres from box up to the grip while it moves over the box
TOLERANCE = 0.012  # metres from grip to box, per axis, at which the fingers close
HELD = 0.028  # metres: both finger positions are below this when they hold the 5 cm box
MAX_STEPS = 40


def grasp(observation: np.ndarray, act: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Move over the box, down, and close the fingers.

    Args:
        observation: Fetch's, ``(25,)``.
        act: takes an action ``(4,)`` and returns the observation it leads to.

    Returns:
        The last observation; the box is held unless the arm could not get there.
    """
    closing = 0
    for _ in range(MAX_STEPS):
        offset, fingers = observation[3:6] - observation[0:3], observation[9:11]
        centred = np.abs(offset[:2]).max() < TOLERANCE
        if closing >= 2 and fingers.max() <= HELD:
            break
        if closing or (centred and abs(offset[2]) < TOLERANCE):
            closing += 1
            move, opening = offset, -1.0
        else:
            move, opening = offset + np.array([0.0, 0.0, 0.0 if centred else ABOVE]), 1.0
        observation = act(np.append(np.clip(move / STEP_LENGTH, -1.0, 1.0), opening).astype(np.float32))
    return observation
