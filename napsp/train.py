"""Algorithm 1 of the paper as one loop: ``python -m napsp.train --env NAME --method ours``."""

from __future__ import annotations

import itertools
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro

from napsp import envs as tasks
from napsp.callable_module import callable_module
from napsp.command_line import Flat, ask
from napsp.config import PAPER, PAPER_METHODS, TrainConfig, preset, recipes
from napsp.envs.goal_task import saves_its_state
from napsp.errors import run_command
from napsp.execution import Execution
from napsp.renamed import FLAGS
from napsp.run import Run, how_it_goes_on
from napsp.settings import flat, refuse_old_flags, to_dict
from napsp.storage.checkpoint import load_model
from napsp.storage.lock import only_writer
from napsp.storage.progress import Row
from napsp.storage.record import RECORD_FILE
from napsp.storage.trackers import TRACKERS
from napsp.unread import tell_of_unread


def train(
    config: TrainConfig,
    folder: Path,
    restart: bool = False,
    trackers: Sequence[str] = (),
    execution: Execution | None = None,
    on_evaluation: Callable[[Row], Any] | None = None,
) -> list[Row]:
    """Run Algorithm 1; write ``model.safetensors`` and ``metrics.csv`` into ``folder``.

    A folder that holds an unfinished run with the same settings is continued, unless ``restart``. ``on_evaluation`` is
    handed each new row of ``metrics.csv``, and ends the run, saved, by returning False. ``trackers`` are names of
    :data:`napsp.storage.trackers.TRACKERS`. Returns all rows.
    """
    with only_writer(folder):
        return _train(config, folder, restart, trackers, execution or Execution(), on_evaluation)


def _train(
    config: TrainConfig,
    folder: Path,
    restart: bool,
    trackers: Sequence[str],
    execution: Execution,
    on_evaluation: Callable[[Row], Any] | None,
) -> list[Row]:
    try:
        run = Run.open(config, folder, restart, trackers, execution)
    except KeyboardInterrupt:
        print(f"\nnothing was saved in {folder} this time; {how_it_goes_on(folder)}", flush=True)
        raise
    run.on_evaluation = on_evaluation
    learner, config = run.learner, run.config
    try:
        for iteration in range(run.iteration, config.n_iterations):  # Algorithm 1, line 1
            recent = run.collect(learner.agent.policy)  # 3: D_last
            learner.counts.update(recent)  # 4
            metrics: Row = {}
            if config.jointly:  # beyond the paper: the same networks are distance and critic
                metrics |= learner.search_graph(iteration) | learner.train_jointly()
            elif config.learns_distance:
                metrics |= learner.train_temporal(recent)  # 5-8: eq. 4a
                learner.update_target()  # 9
            if config.method == "ours":
                metrics |= learner.train_triangular(recent)  # 10-17: eq. 3, 4b
            if not config.jointly:
                metrics |= learner.train_policy()  # 18-21
            learner.extend_buffer(recent)  # 22
            if run.finish_iteration(iteration, metrics):
                break
        run.record()
    finally:
        run.close()
    return run.progress.rows


@dataclass(frozen=True)
class Options:
    """Where a run lives and how it is shown."""

    out: Flat[Path | None] = None
    """Folder of the run; default runs/ENV-METHOD-sSEED."""
    restart: Flat[bool] = False
    """Overwrite the run in that folder instead of continuing it."""
    tensorboard: Flat[bool] = False
    """Write TensorBoard event files as well (needs the tensorboard extra)."""
    wandb: Flat[bool] = False
    """Log to Weights & Biases as well (needs the wandb extra); WANDB_MODE=offline keeps it on this machine."""

    @property
    def trackers(self) -> tuple[str, ...]:
        """Names of those asked for."""
        return tuple(name for name in TRACKERS if getattr(self, name))


DEFAULT_OPTIONS, DEFAULT_EXECUTION = Options(), Execution()


def parse(arguments: list[str]) -> tuple[TrainConfig, Options, Execution]:
    """Read the command line; the defaults depend on ``--env``, ``--method`` and ``--recipe``.

    Raises:
        UserError: an option has another name now, or a value is out of its range.
    """
    refuse_old_flags(arguments, {old.replace("_", "-"): new.replace("_", "-") for old, new in FLAGS.items()})
    chosen = {"env": "fetch_wall", "method": "ours", "recipe": PAPER}
    for flag, following in itertools.pairwise([*arguments, ""]):
        name, joined, value = flag.removeprefix("--").partition("=")
        if flag.startswith("--") and name in chosen:
            chosen[name] = value if joined else following
    default = preset(chosen["env"], chosen["method"], chosen["recipe"])

    def all_of(
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = default,
        output: Options = DEFAULT_OPTIONS,
        execution: Execution = DEFAULT_EXECUTION,
    ) -> tuple[TrainConfig, Options, Execution]:
        """Train a distance and a policy (Algorithm 1)."""
        return config, output, execution

    names = ["episodes", *flat(to_dict(default)), *(f.name for kind in (Options, Execution) for f in fields(kind))]
    return ask(all_of, arguments, "python -m napsp.train", names)


def usual_folder(config: TrainConfig) -> Path:
    """Where a run lives unless the user says otherwise."""
    return Path("runs") / f"{tasks.file_name(config.env)}-{config.method}-s{config.seed}"


def main() -> int:
    """Run the command."""
    config, options, execution = parse(sys.argv[1:])
    tell_of_unread(config)
    folder = options.out or usual_folder(config)
    print(f"{config.env}: {config.method}, seed {config.seed}, {config.n_episodes} episodes -> {folder}")
    others = [name for name in recipes(config.env) if name != PAPER]
    if config.recipe == PAPER and others and config.method in PAPER_METHODS:
        print(f"the paper's method alone; what ships for this task was trained with --recipe {' or '.join(others)}")
    torch.set_num_threads(execution.threads)
    train(config, folder, options.restart, options.trackers, execution)
    if not (folder / RECORD_FILE).is_file():
        return 130
    print(what_next(config, folder))
    return 0


def what_next(config: TrainConfig, folder: Path) -> str:
    """Where a finished run is, and the command that uses it: a planner where d is known, and dynamics or states."""
    model = load_model(folder)
    plans = model.distance is not None and (model.header.get("action_box") is None or saves_its_state(config.env))
    command = f"python -m {'planners.mppi' if plans else 'napsp.evaluate'} --env {config.env}"
    return (f"done: model.safetensors, metrics.csv and training_curve.png are in {folder}\n"
            f"next: {command} --checkpoint {shlex.quote(str(folder))}")  # fmt: skip


callable_module(__name__, "train")

if __name__ == "__main__":
    run_command(main)
