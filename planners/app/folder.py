"""An output folder belongs to one configuration: results never silently replace those of other options."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from napsp.errors import UserError
from napsp.storage.files import read_json, write_json

OWNER, SUMMARY = "configuration.json", "summary.json"
REPLACED = ("video.mp4", "distance_field.png", "episodes.csv", "steps.csv", "steps.png", "distance_to_go.png", SUMMARY)
"""What a command writes beside it."""
TOLD_APART = ("env", "planner", "cost", "seed", "differences", "checkpoint", "ensemble", "hold")

FIX = "choose another --out"


def identity(described: dict[str, Any]) -> dict[str, Any]:
    """What plans and their success depend on, of :func:`planners.app.record.describe_session` or an older one's."""
    found = {name: described[name] for name in TOLD_APART[:5]}
    paths = described["config"].get("distance", {}).get("ensemble", [])
    run = described["run"]
    return found | {"checkpoint": run.get("checkpoint"), "ensemble": paths, "hold": run.get("hold", 0)}


def claim(folder: Path, described: dict[str, Any]) -> str | None:
    """Take a folder for a session's results, before any work is done.

    Args:
        folder: is made when missing.
        described: the session, by :func:`planners.app.record.describe_session`.

    Returns:
        A line about the results of the same configuration that are replaced; None where there are none.

    Raises:
        UserError: it holds results of other options, or of options that are not known.
    """
    folder.mkdir(parents=True, exist_ok=True)
    asked = json.loads(json.dumps(identity(described)))
    if not (folder / OWNER).is_file():
        _inherit(folder, asked)
    held = read_json(folder / OWNER, FIX)
    if "hold" not in held:  # a folder of before
        held["hold"] = _hold_of(folder, asked["hold"])
        write_json(folder / OWNER, held)
    different = [name for name in TOLD_APART if held.get(name) != asked[name]]
    if "differences" in different:
        own, others = asked["differences"], held.get("differences")
        others = others if isinstance(others, dict) else {}
        named = sorted(name for name in own.keys() | others.keys() if own.get(name) != others.get(name))
        different = [name for name in different if name != "differences"] + named
    if different:
        raise UserError(f"{folder} holds plans of other options ({', '.join(different)}); choose another --out")
    replaced = [name for name in REPLACED if (folder / name).is_file()]
    return f"replacing the results of the same options in {folder}" if replaced else None


def _hold_of(folder: Path, asked: int) -> int:
    """What the results of a folder say of ``--hold``; without any, what is asked."""
    if not (folder / SUMMARY).is_file():
        return asked
    run = read_json(folder / SUMMARY, FIX).get("run")
    return run.get("hold", 0) if isinstance(run, dict) else 0


def clear(folder: Path) -> None:
    """Remove what an older run left, once there is a first result to take its place: it would look like this one's."""
    for name in REPLACED:
        (folder / name).unlink(missing_ok=True)


def release(folder: Path) -> None:
    """Give a folder back that no result was left in."""
    if [path.name for path in folder.iterdir()] == [OWNER]:
        (folder / OWNER).unlink()


def _inherit(folder: Path, asked: dict[str, Any]) -> None:
    """Write whose folder it is: of who planned in it before, or else of who asks; of two at once, one."""
    found = [name for name in REPLACED if (folder / name).exists()]
    owner = asked
    if SUMMARY in found:
        try:
            owner = identity(read_json(folder / SUMMARY, FIX))
        except (KeyError, TypeError, AttributeError):
            raise UserError(f"{folder} holds plans of an older version; choose another --out") from None
    elif found:
        raise UserError(f"{folder} holds {', '.join(found)} of options that are not known; choose another --out")
    own = folder / f".{OWNER}.{os.getpid()}"
    write_json(own, owner)
    try:
        os.link(own, folder / OWNER)  # unlike a rename it fails where another command was first
    except FileExistsError:
        pass
    except OSError:  # a file system without links
        os.replace(own, folder / OWNER)
    finally:
        own.unlink(missing_ok=True)
