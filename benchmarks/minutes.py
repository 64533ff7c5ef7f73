"""Minutes of one core until .9 of a task's goals are held: ``python -m benchmarks.minutes --env fetch_wall``.

Methods of this package beside Stable-Baselines3's SAC + HER with the settings that RL Baselines3 Zoo publishes: those
of FetchReach for an arm alone, those of FetchPickAndPlace, of its TQC, where there is a box. All are asked for the same
goals after as many episodes, and a run ends at the first evaluation that holds enough of them, or when its minutes are
up: Stable-Baselines3's between evaluations, and is asked once more, for with the networks of its zoo the first may be
more than half an hour away. Minutes are CPU time of one thread, so that other work beside them counts little;
evaluations are part of them, the imports before are not.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

import napsp
from benchmarks.cells import RESULTS, add_result, as_text, read_results, usual_recipe
from benchmarks.command import read_options
from benchmarks.machine import machine, processor
from napsp import envs as tasks
from napsp.config import PAPER, TrainConfig, preset
from napsp.envs.cards import CARDS
from napsp.errors import UserError, choose, run_command
from napsp.run import EVALUATION_SEED

FILE = RESULTS / "minutes.csv"
PEER = "stable_baselines3"
METHODS = ("plus", "sparse", "ours", PEER)
ENOUGH = 0.9
UNBOUNDED = 1_000_000  # episodes: a run is given up by its minutes
KEY = ("env", "method", "seed", "settings", "processor")
Watch = Callable[[float, float], bool]
"""Told episodes and success of each evaluation; False ends the run."""


@dataclass(frozen=True)
class MinutesOptions:
    """Time methods of this package and Stable-Baselines3 until they hold .9 of the goals."""

    env: str = "fetch_wall"
    """Task."""
    methods: tuple[str, ...] = ("plus", PEER)
    """plus, sparse, ours; or stable_baselines3."""
    seed: int = 0
    """Training seed."""
    minutes: float = 60.0
    """Of one core, after which a run is given up."""


@dataclass(frozen=True)
class Published:
    """Settings of Stable-Baselines3's SAC + HER, in its words, as RL Baselines3 Zoo publishes them."""

    batch_size: int
    net_arch: tuple[int, ...]
    buffer_size: int
    tau: float = 0.005
    gamma: float = 0.95
    learning_rate: float = 1e-3
    learning_starts: int = 1000
    n_sampled_goal: int = 4
    normalize: bool = False

    @classmethod
    def of(cls, env: str) -> Published:
        """Those of the zoo's task that is most like ``env``: with a box, or without.

        A buffer of the zoo's million steps would be searched whole in every update; without a box no run fills a tenth.
        """
        if usual_recipe(env) == PAPER:
            return cls(256, (64, 64), 100_000, normalize=True)
        return cls(1024, (512, 512, 512), 1_000_000, tau=0.05, learning_starts=100)


@dataclass
class Watched:
    """What a run has shown so far, on the clock of its process."""

    budget: float
    """Minutes."""
    began: float = field(default_factory=time.process_time)
    evaluations: list[tuple[int, float, float]] = field(default_factory=list)
    """Episodes, success, minutes."""

    @property
    def minutes(self) -> float:
        """So far."""
        return (time.process_time() - self.began) / 60

    def is_up(self) -> bool:
        """Whether the minutes are over."""
        return self.minutes >= self.budget

    def __call__(self, episodes: float, success: float) -> bool:
        """Note an evaluation; whether to go on."""
        minutes = self.minutes
        self.evaluations.append((int(episodes), success, minutes))
        print(f"{episodes:8.0f} episodes  success {success:.2f}  {minutes:6.2f} min", flush=True)
        return success < ENOUGH and minutes < self.budget

    def figures(self) -> dict[str, Any]:
        """Columns of a row."""
        episodes, success, minutes = self.evaluations[-1]
        curve = " ".join(f"{n}:{share:g}:{spent:.2f}" for n, share, spent in self.evaluations)
        return {"reached": int(success >= ENOUGH), "episodes": episodes, "minutes": round(minutes, 2),
                "success_rate": success, "budget": self.budget, "evaluations": curve}  # fmt: skip


def run_own(config: TrainConfig, watch: Watch) -> None:
    """A method of this package, in a folder that is thrown away."""
    with TemporaryDirectory() as folder:
        napsp.train(
            config.env, config.method, seed=config.seed, recipe=config.recipe, episodes=UNBOUNDED,
            out=Path(folder) / "run", on_evaluation=lambda row: watch(row["episodes"], row["success_rate"]),
        )  # fmt: skip


def run_peer(
    env: str, settings: Published, every: int, n_goals: int, seed: int, watch: Watch, is_up: Callable[[], bool]
) -> Any:
    """Stable-Baselines3's SAC + HER, evaluated after every so many episodes and once its minutes are up; its model."""
    from stable_baselines3 import SAC, HerReplayBuffer
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    world: Any = DummyVecEnv([lambda: tasks.make(env)])
    if settings.normalize:
        world = VecNormalize(world, gamma=settings.gamma)
    judged = tasks.make(env)
    length = tasks.episode_length(env)
    model = SAC(
        "MultiInputPolicy", world, replay_buffer_class=HerReplayBuffer, seed=seed, device="cpu",
        replay_buffer_kwargs={"n_sampled_goal": settings.n_sampled_goal, "goal_selection_strategy": "future"},
        policy_kwargs={"net_arch": list(settings.net_arch)}, batch_size=settings.batch_size, tau=settings.tau,
        gamma=settings.gamma, learning_rate=settings.learning_rate, buffer_size=settings.buffer_size,
        learning_starts=max(settings.learning_starts, length),  # hindsight needs an episode
    )  # fmt: skip

    def act(observation: dict[str, np.ndarray]) -> np.ndarray:
        rows = {name: value[None] for name, value in observation.items()}
        rows = world.normalize_obs(rows) if settings.normalize else rows
        return model.predict(rows, deterministic=True)[0][0]

    goes_on = True
    while goes_on:
        model.learn(every * length, callback=lambda *_: not is_up(), reset_num_timesteps=False)
        episodes = model.num_timesteps // length
        held = [holds(judged, act, EVALUATION_SEED + i, length) for i in range(n_goals)]
        goes_on = watch(episodes, float(np.mean(held)))
    judged.close()
    world.close()
    return model


def holds(env: Any, act: Callable[[dict[str, np.ndarray]], np.ndarray], seed: int, length: int) -> bool:
    """Whether an episode ends at its goal."""
    observation, info = env.reset(seed=seed)
    for _ in range(length):
        observation, _, _, _, info = env.step(act(observation))
    return bool(info["is_success"])


def question(env: str, method: str, seed: int, where: str | None = None) -> dict[str, Any]:
    """What a row answers: task, method, seed, today's settings, what is asked how often, and the processor."""
    config = preset(env, "plus" if method == PEER else method, usual_recipe(env))
    settings = asdict(Published.of(env)) if method == PEER else config.identity()
    asked = {"every": config.evaluate.every, "n_goals": config.evaluate.n_episodes, "enough": ENOUGH}
    return {"env": env, "method": method, "seed": seed, "settings": as_text({**settings, **asked}),
            "processor": processor() if where is None else where}  # fmt: skip


def answer(rows: list[dict[str, str]], asked: dict[str, Any], budget: float = 0.0) -> dict[str, str] | None:
    """The row of a run that held enough, or was given up after no fewer minutes than ``budget``."""
    own = [row for row in rows if all(row.get(name, "") == str(asked[name]) for name in KEY)]
    return next((row for row in reversed(own) if row["reached"] == "1" or float(row["budget"]) >= budget), None)


def run_cell(env: str, method: str, options: MinutesOptions) -> dict[str, str]:
    """The row of a run; measured if it is not there yet."""
    asked = question(env, method, options.seed)
    row = answer(read_results(FILE), asked, options.minutes)
    if row is None:
        config = preset(env, "plus" if method == PEER else method, usual_recipe(env), seed=options.seed)
        print(f"{env}: {method}, until {ENOUGH:g} of {config.evaluate.n_episodes} goals are held", flush=True)
        tasks.make(env).close()  # what is imported for it is not training
        version = _version_of_peer() if method == PEER else ""
        watched = Watched(options.minutes)
        if method == PEER:
            every, n_goals = config.evaluate.every, config.evaluate.n_episodes
            run_peer(env, Published.of(env), every, n_goals, options.seed, watched, watched.is_up)
        else:
            run_own(config, watched)
        add_result(FILE, asked, {**watched.figures(), "library": version, **machine()})
        row = answer(read_results(FILE), asked, options.minutes)
    assert row is not None
    return row


def _version_of_peer() -> str:
    try:
        import stable_baselines3
    except ImportError:
        raise UserError("Stable-Baselines3 is not installed; run: pip install 'napsp[test]'") from None
    return f"stable-baselines3 {stable_baselines3.__version__}"


def main() -> int:
    """Run what is missing and say what took how long."""
    options = read_options(MinutesOptions, "minutes")
    if not options.minutes > 0:
        raise UserError(f"--minutes is {options.minutes}; it must be more than 0")
    for method in options.methods:
        if method not in METHODS:
            raise UserError(f"unknown method {method!r}; {choose(method, METHODS)}")
    env = tasks.canonical_name(options.env)
    if env not in CARDS:
        raise UserError(f"there are no published settings for {env}; {choose(env, CARDS)}")
    torch.set_num_threads(1)
    for method in options.methods:
        row = run_cell(env, method, options)
        end = f"held {ENOUGH:g}" if row["reached"] == "1" else f"given up at {float(row['success_rate']):.2f}"
        print(f"{env}: {method} {end} after {row['episodes']} episodes, {float(row['minutes']):.1f} min of a core")
    return 0


if __name__ == "__main__":
    run_command(main)
