"""What the columns of a planner's table and files mean, with their units."""

from __future__ import annotations

from collections.abc import Mapping

from napsp.columns import TRAINING

PLANNING = {
    "success": "at the goal in the last step; an episode ends once the goal was held for `--hold` steps in succession",
    "at goal in some step": "reached the goal, whether or not it held",
    "first hit, steps to goal": "control step at which the goal was first reached; its mean over those episodes",
    "final gap": "straight line left to the goal at the end, in centimetres (claw: degrees left to turn; unknown "
    "units: as they are)",
    "action rate": "mean squared change from one action to the next, actions in [-1, 1]: `--smooth` lowers it",
    "jerk": "root mean square of the end effector's jerk, m/s^3 (claw: of its joints, rad/s^3)",
    "ms per plan": "median wall time of a plan call, beside the control period that it may take in real time",
    "cost, steps_to_go": "J of the executed plan; the cost's estimate after its action; both in steps",
    "effective_samples, effective_share": "how many samples the search's update really used, and what share of them",
    "plan_ms, smoothing_ms": "milliseconds of a plan call; the part of it that went into smoothing",
    "gap, final_gap_m": "straight line to the goal in the world, in metres (claw: of the tip of the marked arm)",
}


def explained() -> str:
    """Both tables as text."""
    return "\n\n".join([_table("a training: its table and metrics.csv", TRAINING),
                        _table("a planner: its table, episodes.csv and steps.csv", PLANNING)])  # fmt: skip


def _table(title: str, meanings: Mapping[str, str]) -> str:
    width = max(map(len, meanings)) + 2
    return "\n".join([title, *(f"  {name:{width}s}{meaning.replace('`', '')}" for name, meaning in meanings.items())])
