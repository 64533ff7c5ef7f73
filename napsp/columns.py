"""What the columns of a training's table and of ``metrics.csv`` mean; planners have ``planners.app.columns``.

The glossary of the documentation has the same words, which a test sees to.
"""

from __future__ import annotations

TRAINING = {
    "episodes": "training episodes so far",
    "success, any": "share of evaluation episodes at the goal in the last step, in some step",
    "gap [m]": "mean distance to the goal in the last step; of the claw, `gap [deg]`, the angle left to turn; of goal "
    "environments, `gap`, in units of their goals",
    "mean d": "mean distance over the policy's training samples, in steps",
    "d(goal)": "d at states at the goal, in steps: near 0 is true",
    "merge, relax": "share of tuples that eq. 4b found a longer, a shorter way for",
    "alpha": "SAC's entropy weight: how much the policy still explores",
    "cells, known": "cells of the graph; share of labels that are shortest paths (plus)",
    "steps/s, min left": "environment steps per second since the start; minutes to the end",
}
