"""Rows of results and trained runs: what every benchmark shares."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from napsp.config import TrainConfig, identity_of, recipes
from napsp.envs import file_name
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.storage import lock
from napsp.storage.files import read_json, sound, write_atomically, write_json
from napsp.storage.progress import read_rows
from napsp.storage.record import RECORD_FILE
from napsp.storage.shipped import SHIPPED, shipped_model, shipped_names
from napsp.train import train

RESULTS = Path("results")
RUNS = Path("runs") / "benchmarks"
AGAIN = "put back a copy, or remove it and measure again"
ROWS = RESULTS / "runs"  # one small file per trained cell: no two processes write the same one


def usual_recipe(env: str) -> str:
    """The recipe that a task is compared by: its own if it has one, else the paper's."""
    return list(recipes(env))[-1]


def cell_name(config: TrainConfig) -> str:
    """Name of a cell: equal configurations share it."""
    return f"{file_name(config.env)}-{config.method}-s{config.seed}-{config.digest()}"


def as_text(identity: Mapping[str, Any] | None) -> str:
    """The column of a row for what its model was trained with; empty without a model."""
    return "" if identity is None else json.dumps(identity, sort_keys=True, separators=(",", ":"))


def training_of(row: Mapping[str, str]) -> dict[str, Any] | None:
    """What the model of a row was trained with, from its column ``training``; None without a model."""
    try:
        return json.loads(row["training"]) if row["training"] else None
    except (ValueError, RecursionError):
        raise UserError(f"a row says it was trained with {row['training']!r}, which is no JSON; measure anew") from None


@contextmanager
def exclusive(folder: Path, wait: bool) -> Iterator[None]:
    """Hold a cell; the system lets go of it even if the process is killed.

    Raises:
        BusyError: another process holds it and ``wait`` is false.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with lock.exclusive(folder.with_name(f".{folder.name}.lock"), wait):
        yield


def trained(config: TrainConfig, execution: Execution | None = None, wait: bool = True) -> Path:
    """Folder of the finished run of a configuration; trains it, or finishes it, when needed.

    Its curve lands in ``results/runs``.

    Raises:
        BusyError: another process trains it and ``wait`` is false.
    """
    folder = RUNS / cell_name(config)
    with exclusive(folder, wait):
        if not (folder / RECORD_FILE).is_file():
            print(f"training {folder}", flush=True)
            train(config, folder, execution=execution)
        if not (folder / RECORD_FILE).is_file():
            raise KeyboardInterrupt  # an interrupted run is not a result
        publish(folder)
    return folder


def checkpoint_of(config: TrainConfig) -> Path:
    """Folder of a model of this configuration and seed: the one that ships with the package, or :func:`trained`."""
    for path in sorted(SHIPPED.glob(f"*/{RECORD_FILE}")):
        if recorded_training(path.parent) == (config.identity(), config.seed):
            return path.parent
    return trained(config)


def recorded_training(folder: Path) -> tuple[dict[str, Any], int]:
    """What a finished run was trained with, and its seed."""
    path = folder / RECORD_FILE
    record = read_json(path, "finish its run again")
    with sound(path, "finish its run again"):
        return identity_of(record["config"]), int(record["seed"])


def training_beside(checkpoint: Path | None, env: str) -> tuple[dict[str, Any], int]:
    """What a model was trained with, and its seed; ``checkpoint`` as for :func:`napsp.storage.checkpoint.load_model`.

    Args:
        checkpoint: None is the one that ships for ``env``.
        env: the task.

    Raises:
        UserError: the record of the run is not beside the model.
    """
    path = checkpoint or shipped_model(env)
    path = path if path.exists() else SHIPPED / path
    folder = path if path.is_dir() else path.parent
    if not (folder / RECORD_FILE).is_file():
        raise UserError(f"{folder} has no {RECORD_FILE}, which says how the model was trained; finish its run")
    return recorded_training(folder)


def shipped_training(env: str, variant: str = "") -> tuple[dict[str, Any], int] | None:
    """What the model that ships for a task was trained with, and its seed; None if none ships.

    ``variant`` is the rest of its name, ``_plus`` for method plus.
    """
    folder = SHIPPED / f"{file_name(env)}{variant}"
    return recorded_training(folder) if (folder / RECORD_FILE).is_file() else None


def published(config: TrainConfig) -> bool:
    """Whether the curve of a configuration is in the results, here or brought along with them."""
    return (ROWS / f"{cell_name(config)}.json").is_file()


def publish(folder: Path) -> None:
    """Copy what describes a finished run, and its learning curve, to ``results/runs``."""
    path = ROWS / f"{folder.name}.json"
    if not path.is_file():
        record = read_json(folder / RECORD_FILE, "finish its run again")
        columns = {"episodes", "success_rate", "any_success_rate", "max_reward", "mean_distance", "distance_at_goal",
                   "merging_rate", "relaxation_rate", "seconds"}  # fmt: skip
        curve = [{k: round(v, 4) for k, v in row.items() if k in columns}
                 for row in read_rows(folder / "metrics.csv", float("inf"))]  # fmt: skip
        kept = {k: record[k] for k in ("command", "revision", "seed", "config", "minutes", "versions")}
        write_json(path, {**kept, "curve": curve})


def learning_curves(env: str | None = None) -> list[dict[str, Any]]:
    """All published runs (of a task): command, configuration, and ``curve`` of evaluations."""
    paths = sorted(ROWS.glob(f"{env or ''}*.json"))
    runs = [_run(path) for path in paths]
    return [run for run in runs if env in (None, run["config"]["env"])]


def _run(path: Path) -> dict[str, Any]:
    run = read_json(path, AGAIN)
    with sound(path, AGAIN):
        _ = run["config"]["env"], run["seed"] + 0, [float(row["episodes"]) for row in run["curve"]]  # what all need
    return run


def read_results(path: Path) -> list[dict[str, str]]:
    """Rows of a results file; none if it does not exist."""
    if not path.is_file():
        return []
    with sound(path, AGAIN), open(path, newline="") as file:
        rows = list(csv.DictReader(file, strict=True))
        if any(None in row or None in row.values() for row in rows):
            raise ValueError("rows of different lengths")
        return rows


def find(rows: Iterable[Mapping[str, str]], key: Mapping[str, Any]) -> Mapping[str, str] | None:
    """The row whose columns equal ``key``."""
    wanted = {name: str(value) for name, value in key.items()}
    return next((row for row in rows if wanted.items() <= row.items()), None)


def figures_folder(options: Any) -> Path:
    """Where figures go: published ones are of published episodes and models, those of a trial lie beside its runs."""
    told = ("episodes", "seed", "training_seed")
    usual = all(getattr(options, name, None) == getattr(type(options), name, None) for name in told)
    ships = options.checkpoint is None or str(options.checkpoint) in shipped_names()
    return RESULTS if usual and ships else RUNS


def add_result(path: Path, cell: Mapping[str, Any], figures: Mapping[str, Any]) -> None:
    """Add the row of a cell, atomically; if another process measured it meanwhile, in place of its row."""
    replace_results(path, tuple(cell), [{**cell, **figures}])


def replace_results(path: Path, key: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Add rows, atomically; a measurement made again takes the place of those that agree in the columns of ``key``.

    Processes that write at the same time wait for each other.
    """
    with exclusive(RUNS / path.name, wait=True):
        _replace(path, key, rows)


def _replace(path: Path, key: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    added = [{name: str(value) for name, value in row.items()} for row in rows]
    cells = [{name: row[name] for name in key} for row in added if key]
    kept = [row for row in read_results(path) if not any(cell.items() <= row.items() for cell in cells)]
    text = io.StringIO()
    names = dict.fromkeys(name for row in [*kept, *added] for name in row)
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows([*kept, *added])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.getvalue().encode())


def report(figures: Mapping[str, Any], path: Path | None) -> None:
    """Print named figures, one per line, and write them as JSON if a file is named."""
    for name, value in figures.items():
        print(f"{name:36s} {value:.3f}" if isinstance(value, float) else f"{name:36s} {value}")
    if path is not None:
        write_json(path, dict(figures))
