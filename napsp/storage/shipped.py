"""The models that come with the package, without torch: they can be listed at once."""

from __future__ import annotations

from pathlib import Path

from napsp.envs import canonical_name, file_name
from napsp.envs.cards import CARDS
from napsp.errors import UserError

MODEL_FILE = "model.safetensors"
SHIPPED = Path(__file__).parents[1] / "checkpoints"


def shipped_names(task: str | None = None) -> list[str]:
    """Names of the models that ship, sorted: all, or those of one task."""
    names = sorted(path.parent.name for path in SHIPPED.glob(f"*/{MODEL_FILE}"))
    return names if task is None else [name for name in names if named_after(name, task)]


def named_after(name: str, task: str) -> bool:
    """Whether a model's folder is called after this task, and not after one whose name begins with the task's."""
    others = tuple(other for other in CARDS if other != task and other.startswith(task))
    return name.startswith(file_name(task)) and not name.startswith(others)


def shipped_model(env: str) -> Path:
    """Path of the checkpoint that comes with the package.

    Raises:
        UserError: none ships for this environment.
    """
    path = SHIPPED / canonical_name(env) / MODEL_FILE
    if not path.is_file():
        raise UserError(
            f"no checkpoint ships for {env}; train one with: python -m napsp.train --env {env}, "
            "then pass it with --checkpoint"
        )
    return path
