"""A picture of the first episode in the maze: the distance over it, the way taken, the sampled plans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mpc.controller import Plan
from mpc.cost import NoSteps
from napsp.envs.point_maze import PointMazeEnv
from napsp.storage.record import save_figure
from planners.app.episode import EpisodeResult
from planners.app.maze_map import draw_field, steps_field
from planners.app.session import Session

SHOWN_STEPS = 4  # at which the sampled plans are drawn, evenly over the way to the goal
SHOWN_PLANS = 16  # the cheapest of each


class DistanceField:
    """Remembers the plans of one episode and draws them over the steps to its goal, as its cost sees them."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._fans: list[np.ndarray] = []

    @staticmethod
    def drawable(session: Session) -> bool:
        """Whether the task is seen whole from above and the cost estimates a distance."""
        is_distance = not isinstance(session.controller.cost.to_go, NoSteps)
        return is_distance and isinstance(session.env.unwrapped, PointMazeEnv)

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Keep the cheapest sampled plans, from the place they start at."""
        ways = plan.trajectories.achieved_goals[plan.cheapest(SHOWN_PLANS)]
        here = np.broadcast_to(observation["achieved_goal"], (len(ways), 1, 2))
        self._fans.append(np.concatenate([here, ways], axis=1))

    def draw(self, path: Path, result: EpisodeResult) -> None:
        """Write the picture of the episode that was watched."""
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot as plt

        world, config = self._session.env.unwrapped, self._session.config
        figure, axis = plt.subplots(figsize=(6, 5.3), layout="constrained")
        field = steps_field(self._session.controller.cost.to_go, world.scale, result.desired_goal)
        figure.colorbar(draw_field(axis, field, world.scale), ax=axis, label="steps to go, at rest")
        end = result.first_hit or len(self._fans)
        for step in np.unique(np.linspace(0, end - 1, SHOWN_STEPS).astype(int)):
            axis.plot(*self._fans[step].T, color="white", linewidth=0.7, alpha=0.8)
        axis.plot([], [], color="white", linewidth=0.7, label="sampled plans")
        _draw_way(axis, result, world.goal_radius)
        outcome = f"there after {result.first_hit} steps" if result.first_hit else "never there"
        name = "the learned distance" if config.cost == "distance" else config.cost
        axis.set_title(f"{config.planner}, {name}, seed {result.seed}: {outcome}", fontsize=10)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=4, fontsize=8, facecolor="lightgrey")
        save_figure(figure, path)


def _draw_way(axis: Any, result: EpisodeResult, goal_radius: float) -> None:
    from matplotlib.patches import Circle

    axis.plot(*result.achieved_goals.T, color="red", linewidth=1.5, marker=".", markersize=3, label="executed")
    axis.plot(*result.achieved_goals[0], "o", color="black", markeredgecolor="white", markersize=7, label="start")
    axis.plot(*result.desired_goal, "*", color="red", markeredgecolor="white", markersize=12, label="goal")
    axis.add_patch(Circle(tuple(result.desired_goal), goal_radius, fill=False, edgecolor="white", linewidth=1))
