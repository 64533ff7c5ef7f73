"""A search, an engine and a smoother that record what the receding-horizon loop hands them."""

from types import SimpleNamespace

import numpy as np

from mpc.controller import Controller
from mpc.cost import Cost
from mpc.knots import SplineConfig
from mpc.rollout import Followed, Trajectories
from mpc.simulators import state_of
from planners.smooth import HeldConfig

STATE = np.array([0.0, 5.0])
GOAL = np.array([0.0])
OBSERVATION = {"observation": np.array([5.0]), "achieved_goal": np.array([5.0]), "desired_goal": GOAL}
RNG = np.random.default_rng(0)


def search(kind, n_knots, n_controls, **settings):
    """The one place that knows how a search is built."""
    return kind(n_knots, n_controls, HeldConfig(**settings))


def controller_of(engine, planner, cost, horizon, n_knots=None, interpolation="linear", **settings):
    """The one place that knows how a controller is built."""
    return Controller(engine, planner, cost, horizon, RNG, SplineConfig(n_knots, interpolation), **settings)


class Line:
    """An engine whose world is a line: an action is added to the position. State: the clock and the position."""

    def __init__(self, log):
        self.log = log
        self.dynamics = SimpleNamespace(model=None)
        self.diverged = False

    def reset(self):
        self.log.append(("engine.reset",))

    def update(self):
        self.log.append(("engine.update",))

    def state_of(self, world):
        self.update()
        return state_of(self.dynamics, world)

    def rollout(self, state, actions, known=()):
        self.log.append(("rollout", state, actions, known))
        positions = state[1] + np.cumsum(actions, 1, np.float64)
        return Trajectories(positions, positions, np.broadcast_to(self.diverged, len(actions)))

    def follow(self, state, observation, actor, horizon):
        self.log.append(("follow", state, observation, actor, horizon))
        actions = np.array(actor(horizon), np.float32).reshape(horizon, -1)
        return Followed(actions, actions, np.zeros(horizon, bool))


class Recorder:
    """A search that tries what the test says, round after round, and executes what it says."""

    effective_samples = 2.5

    def __init__(self, log, tried, plan):
        self.log, self.tried, self.plan = log, [np.array(one, float) for one in tried], np.array(plan, float)
        self.rounds = 0

    def reset(self):
        self.log.append(("reset",))

    def sample(self, rng, proposals=None):
        self.log.append(("sample", rng, proposals))
        self.rounds += 1
        return self.tried[(self.rounds - 1) % len(self.tried)]

    def update(self, knots, costs):
        self.log.append(("update", knots, costs))
        self.effective_samples = float(self.rounds)

    def adopt(self, knots):
        self.log.append(("adopt", knots))

    def shift(self, shift):
        self.log.append(("shift", shift))


class Smoother:
    """Hands back what the test says."""

    def __init__(self, log, *answers):
        self.log, self.answers = log, list(answers)

    def reset(self):
        self.log.append(("smoother.reset",))

    def skip(self, steps):
        self.log.append(("smoother.skip", steps))

    def __call__(self, state, observation, actions, executed):
        self.log.append(("smooth", state, observation, actions, executed))
        return self.answers.pop(0)


def reached(achieved, goals):
    assert achieved.shape == goals.shape
    return np.abs(achieved - goals)[..., 0] < 0.5


def far(observations, achieved, actions, goal):
    """Metres to the goal; an action of one's own counts a hundred times."""
    steps = np.abs(achieved - goal)[:, 0]
    return steps if actions is None else steps + 100.0 * actions[:, 0]


# Two plans of three steps, and the plan to execute.
TRIED = [[[[-1.0], [-0.5], [-0.5]], [[0.0], [0.25], [0.0]]]]
PLAN = [[0.1], [0.2], [0.3]]


def recorded(tried=TRIED, plan=PLAN, horizon=3, action_of="policy", answers=None, **settings):
    """A controller and the log of all it does."""
    log = []
    if answers is not None:
        settings["smoother"] = Smoother(log, *answers)
    cost = Cost(far, reached, "terminal", action_of)
    return controller_of(Line(log), Recorder(log, tried, plan), cost, horizon, **settings), log


def names(log):
    return [entry[0] for entry in log]


def calls(log, name):
    return [entry[1:] for entry in log if entry[0] == name]


def plan(controller, state=STATE, **changes):
    return controller.plan_from(state, {**OBSERVATION, **changes})
