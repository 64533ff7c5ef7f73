"""One episode as it goes on: where things are, what was planned, and the figures of every control step."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mpc.controller import Plan
from napsp import envs as tasks
from napsp.envs.blowups import BlowUpDetector
from napsp.errors import UserError
from planners.app.episode import Step
from planners.app.session import Session


@dataclass(frozen=True)
class Lived:
    """A control step that was executed.

    Attributes:
        step: its figures.
        late_ms: milliseconds from the state that its plan began in to its execution, wall time.
        late_steps: control steps between the two; 0 where the simulation waited.
    """

    step: Step
    late_ms: float
    late_steps: int


@dataclass(frozen=True)
class Scenery:
    """All that a picture needs, copied, so that it can be drawn while the simulation goes on.

    Attributes:
        session: what it belongs to; another task or option makes another one.
        number: control steps since the episode began.
        qpos: joint positions, ``(nq,)``.
        mocap: position and quaternion of mocap bodies, ``(M, 7)``.
        goal: ``(G,)``.
        way: achieved goals so far, ``(number + 1, G)``.
        lived: the control steps so far.
        plan: the newest; None before the first.
        reached: whether the goal is reached now.
        at: when, :func:`time.monotonic`.
    """

    session: Session
    number: int
    qpos: np.ndarray
    mocap: np.ndarray
    goal: np.ndarray
    way: np.ndarray
    lived: tuple[Lived, ...]
    plan: Plan | None
    reached: bool
    at: float


@dataclass
class Trial:
    """An episode of a session, one control step at a time.

    Attributes:
        session: plans and simulates.
        seed: of start, goal and planning.
        observation: the last one.
        plan: the newest.
        planned: the control step that the session planned for last.
    """

    session: Session
    seed: int
    observation: dict[str, np.ndarray] = field(init=False)
    plan: Plan | None = None
    planned: int = -1
    _way: list[np.ndarray] = field(default_factory=list)
    _lived: list[Lived] = field(default_factory=list)
    _executed: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.observation = self.session.begin(self.seed)
        self._ended, self._detector = False, BlowUpDetector(self.session.env)
        self._detector.begin()
        self._way.append(self.observation["achieved_goal"].copy())

    @property
    def world(self) -> Any:
        """The environment without wrappers."""
        return self.session.env.unwrapped

    @property
    def number(self) -> int:
        """Control steps so far."""
        return len(self._lived)

    @property
    def executed(self) -> np.ndarray:
        """The last actions ``(k, A)``, k <= 2, the latest last."""
        n_actions = self.session.env.action_space.shape[0]
        return np.array(self._executed[-2:], np.float32).reshape(-1, n_actions)

    @property
    def over(self) -> bool:
        """Whether it has lasted as long as an episode of its task, or the task ended it; it can go on all the same."""
        return self._ended or self.number >= tasks.episode_length(self.session.env_name)

    def move_goal(self, goal: np.ndarray) -> None:
        """Put the goal ``(G,)`` elsewhere."""
        self.session.set_goal(self.observation, goal)

    def advance(self) -> None:
        """Plan, the simulation waiting, and execute the plan's first action.

        Raises:
            UserError: the simulation blew up, or a cost of the user's own failed.
        """
        controller = self.session.controller
        controller.skip(self.number - self.planned - 1)  # steps of plans that were late
        plan, self.planned = controller.plan(self.world, self.observation, self.executed), self.number
        cost = controller.cost_of(self.world, self.observation, plan.actions)
        self.execute(plan.action, plan, cost, plan.milliseconds, 0)

    def execute(self, action: np.ndarray, plan: Plan, cost: float, late_ms: float, late_steps: int) -> None:
        """Execute an action ``(A,)`` of a plan that costs ``cost`` steps alone; see :class:`Lived`.

        Raises:
            UserError: the simulation blew up.
        """
        found, _, terminated, truncated, _ = self.session.env.step(action)
        if self._detector.blew_up(found, terminated or truncated):
            raise UserError(f"the simulation of {self.session.env_name} blew up in step {self.number + 1}; reset it")
        self._ended = self._ended or terminated
        self.observation = {key: np.array(values) for key, values in found.items()}
        self.plan = plan
        self._executed = [*self._executed[-1:], np.array(action)]
        self._lived.append(Lived(self.session.record(self.observation, plan, cost, late_steps), late_ms, late_steps))
        self._way.append(self.observation["achieved_goal"])

    def scenery(self) -> Scenery:
        """What is to be seen now."""
        data, here = self.world.data, self.observation
        return Scenery(
            self.session,
            self.number,
            data.qpos.copy(),
            np.concatenate([data.mocap_pos, data.mocap_quat], axis=1),
            here["desired_goal"].copy(),
            np.array(self._way),
            tuple(self._lived),
            self.plan,
            bool(self.world.reached(here["achieved_goal"], here["desired_goal"])),
            time.monotonic(),
        )
