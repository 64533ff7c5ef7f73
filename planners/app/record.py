"""What identifies the results of a session: its folder, and the head of ``summary.json``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from napsp.envs import file_name
from napsp.settings import digest
from napsp.storage.revision import git_revision
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


def default_folder(config: PlanConfig[Any], run: RunOptions) -> Path:
    """Where the results go unless the user says otherwise: another folder for everything that makes other plans.

    And for other numbers of episodes, or of steps that a goal has to be held: a quick look replaces no long run.
    """
    name = f"{file_name(config.env)}-{config.planner}-{config.cost.replace(':', '-')}-s{run.seed}"
    asked, usual = config.identity(), PlanConfig.of(config.planner, {"env": config.env}).identity()
    asked |= {"cost": config.cost}
    models = {"checkpoint": run.checkpoint, "distance.ensemble": config.distance.ensemble}
    asked |= {key: _plain_values(value) for key, value in models.items() if value}
    asked |= {key: getattr(run, key) for key in ("episodes", "hold") if getattr(run, key) != getattr(RunOptions, key)}
    return Path("plans") / (name if asked == usual | {"cost": config.cost} else f"{name}-{digest(asked)}")


def describe_session(session: Session) -> dict[str, Any]:
    """What identifies a session."""
    config, run = session.config, session.run
    return {
        "env": config.env,
        "planner": config.planner,
        "cost": config.cost,
        "seed": run.seed,
        "config": _plain_values(asdict(config)),
        "differences": config.identity(),
        "run": _plain_values(asdict(run)),
        "revision": git_revision(),
        "checkpoint": session.model.header if session.model else None,
        "ensemble": [member.header for member in session.models[1:]],
    }


def _plain_values(values: Any) -> Any:
    """Values that JSON knows."""
    if isinstance(values, dict):
        return {name: _plain_values(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return [_plain_values(value) for value in values]
    return str(values) if isinstance(values, Path) else values
