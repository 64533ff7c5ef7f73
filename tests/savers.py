"""Worlds without MuJoCo that save and restore their state, and some that do not keep to it."""

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict

RADIUS, FULL = 0.1, 0.2  # of a success; how far an action moves at most


class Plane(gymnasium.Env):
    """A place in the plane, from left to right. Its end at the goal, and a pit in the middle, are the subclasses'."""

    max_episode_steps = 25
    pit, ends_at_goal, noise = 0.0, False, 0.0

    def __init__(self):
        ends = Box(-10.0, 10.0, (2,), np.float64)
        self.observation_space = Dict(observation=Box(-10.0, 10.0, (4,)), achieved_goal=ends, desired_goal=ends)
        self.action_space = Box(-FULL, FULL, (2,), np.float32)
        self.place = self.speed = self.goal = np.zeros(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        near = self.np_random.uniform(-0.1, 0.1, (2, 2))
        self.place, self.goal = np.array([-0.8, 0.0]) + near[0], np.array([0.8, 0.0]) + near[1]
        self.speed, self.over = np.zeros(2), False
        return self.observe(), {}

    def step(self, action):
        assert not self.over, "stepped after its end"
        assert self.action_space.contains(action)
        self.speed = np.asarray(action, np.float64) + self.noise * self.np_random.normal(size=2)
        self.place += self.speed  # in place: who shares this array would see it
        fell = np.linalg.norm(self.place) < self.pit
        arrived = bool(self.compute_reward(self.place, self.goal, {}) == 0.0)
        self.over = bool(fell or (self.ends_at_goal and arrived))
        return self.observe(), float(arrived) - 1.0, self.over, False, {}

    def observe(self):
        observation = np.concatenate((self.place, self.speed)).astype(np.float32)
        return {"observation": observation, "achieved_goal": self.place.copy(), "desired_goal": self.goal.copy()}

    def compute_reward(self, achieved_goal, desired_goal, info):
        return -(np.linalg.norm(achieved_goal - desired_goal, axis=-1) >= RADIUS).astype(np.float32)

    def get_state(self):
        return {"place": self.place, "goal": self.goal, "over": self.over, "rng": self.np_random}

    def set_state(self, state):
        self.place, self.goal, self.over, self.np_random = (state[name] for name in ("place", "goal", "over", "rng"))


class Arriving(Plane):
    """Terminates at its goal."""

    ends_at_goal = True


class Pit(Plane):
    """Terminates in the middle of the straight line."""

    pit = 0.3


class Noisy(Plane):
    """Every step draws from the generator, which the state holds."""

    noise = 0.02


class Heavy(Plane):
    """Speeds up by its actions, half of the speed is lost in every step: twice ``FULL`` at most."""

    def step(self, action):
        self.momentum = 0.5 * self.momentum + np.asarray(action, np.float64)
        return super().step(np.clip(self.momentum, -FULL, FULL).astype(np.float32))

    def reset(self, **options):
        self.momentum = np.zeros(2)
        return super().reset(**options)

    def get_state(self):
        return super().get_state(), self.momentum

    def set_state(self, state):
        super().set_state(state[0])
        self.momentum = state[1]


class Forgetful(Heavy):
    """Leaves out its momentum."""

    def get_state(self):
        return super().get_state()[0], np.zeros(2)


class Chancy(Noisy):
    """Leaves out its generator."""

    def get_state(self):
        return {**super().get_state(), "rng": None}

    def set_state(self, state):
        super().set_state({**state, "rng": self.np_random})


class Slippery(Plane):
    """Leaves out what its reset draws: how far its actions go."""

    def reset(self, **options):
        answer = super().reset(**options)
        self.grip = self.np_random.uniform(0.5, 1.0)
        return answer

    def step(self, action):
        return super().step((self.grip * action).astype(np.float32))


class Aimless(Plane):
    """Leaves out its goal."""

    def get_state(self):
        return {**super().get_state(), "goal": np.zeros(2)}


class Silent(Plane):
    """Only half of the two methods."""

    get_state = None


class Broken(Plane):
    def set_state(self, state):
        raise KeyError("speed")


class Entangled(Plane):
    def get_state(self):
        return {**super().get_state(), "cost": lambda: 0.0}


class Dense(Plane):
    def compute_reward(self, achieved_goal, desired_goal, info):
        return -np.linalg.norm(achieved_goal - desired_goal, axis=-1)


class Still(Plane):
    """Nothing moves."""

    def step(self, action):
        return super().step(np.zeros(2, np.float32))


class Drawn(Plane):
    """Draws itself: a dot on white."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode

    def render(self):
        image = np.full((32, 64, 3), 255, np.uint8)
        column, row = np.clip((32 + 30 * self.place[0], 16 + 15 * self.place[1]), 2, 30).astype(int)
        image[row - 1 : row + 2, column - 1 : column + 2] = 0
        return image


class Halved(gymnasium.ObservationWrapper):
    """Shows half of what there is."""

    def observation(self, observation):
        return {**observation, "observation": 0.5 * observation["observation"]}


def halved():
    return Halved(Plane())


def counted():
    return gymnasium.wrappers.RecordEpisodeStatistics(Plane())
