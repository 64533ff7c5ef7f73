"""Where else the figures of a training go, beside ``metrics.csv``: TensorBoard and Weights & Biases, both extras."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from napsp.errors import UserError

Row = dict[str, float]
TRACKERS = {"tensorboard": "TensorBoard", "wandb": "Weights & Biases"}
"""By the name of the extra, which is that of the module as well."""


class Tracker(Protocol):
    """Takes one row per evaluation."""

    def add(self, row: Row) -> None:
        """Log the numbers of a row at its number of training episodes."""
        ...

    def close(self) -> None:
        """Write what is left."""
        ...


def require(names: Collection[str]) -> None:
    """Check that trackers are installed, before any work is done and any folder made.

    Raises:
        UserError: one is not; the message says how to install it.
    """
    for name in names:
        if find_spec(name) is None:
            raise UserError(f"{TRACKERS[name]} is not installed; run: pip install 'napsp[{name}]'")


def forget(folder: Path) -> None:
    """Remove what trackers keep of a run in a folder where another one begins."""
    shutil.rmtree(folder / "tensorboard", ignore_errors=True)


def open_trackers(names: Collection[str], folder: Path, config: Mapping[str, Any], continued: bool) -> list[Tracker]:
    """The trackers of a run that lives in ``folder``; ``continued`` says whether it has rows already."""
    kinds: dict[str, Any] = {"tensorboard": TensorBoard, "wandb": WandB}
    return [kinds[name](folder, config, continued) for name in names]


class TensorBoard:
    """Event files in ``folder/tensorboard``."""

    def __init__(self, folder: Path, config: Mapping[str, Any], continued: bool) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder / "tensorboard"))

    def add(self, row: Row) -> None:
        """A curve per column."""
        for name, value in row.items():
            self._writer.add_scalar(name, value, int(row["episodes"]))

    def close(self) -> None:
        """Flush."""
        self._writer.close()


class WandB:
    """A run of project ``napsp``, named after the folder; wandb's own variables, such as WANDB_MODE, have their say."""

    def __init__(self, folder: Path, config: Mapping[str, Any], continued: bool) -> None:
        import wandb  # pyright: ignore[reportMissingImports]

        name = folder / "wandb" / "run_id.txt"  # a run that is continued here is continued there
        known = name.read_text().strip() if continued and name.is_file() else None
        self._run = wandb.init(
            project="napsp", name=folder.name, dir=str(folder), config=dict(config), id=known, resume="allow"
        )
        name.parent.mkdir(exist_ok=True)
        name.write_text(self._run.id)

    def add(self, row: Row) -> None:
        """A curve per column."""
        self._run.log(row, step=int(row["episodes"]))

    def close(self) -> None:
        """Flush."""
        self._run.finish()
