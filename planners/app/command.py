"""The command ``napsp``: what ``python -m napsp.train`` and its neighbours do, under one name."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable

from napsp.errors import UserError, choose, run_command

USAGE = """napsp: planning with learned distances

  napsp plan [SEARCH] --env TASK ...   plan with a learned distance; SEARCH is {searches} (default mppi)
  napsp studio --env TASK ...          the same live, in the browser
  napsp train --env TASK ...           train a distance and a policy
  napsp evaluate --env TASK ...        run a trained policy alone
  napsp list                           tasks, searches, and the models that ship
  napsp columns                        what the columns of tables and files mean, with their units
  napsp report                         all results of a clone as one page (results/report.html)

Each with --help says what it can do."""


def main() -> None:
    """Entry point of ``napsp``."""
    run_command(lambda: run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Do what the first word says with the rest.

    Raises:
        UserError: there is no such word.
    """
    if not arguments or arguments[0] in ("--help", "-h", "help"):
        print(USAGE.format(searches=", ".join(_searches())))
        return 0
    word, *rest = arguments
    if word not in WORDS:
        raise UserError(f"there is no napsp {word}; {choose(word, WORDS)}")
    return WORDS[word](rest) or 0


def _train(arguments: list[str]) -> int | None:
    sys.argv = ["napsp train", *arguments]
    return importlib.import_module("napsp.train").main()


def _evaluate(arguments: list[str]) -> int | None:
    sys.argv = ["napsp evaluate", *arguments]
    return importlib.import_module("napsp.evaluate").main()


def _studio(arguments: list[str]) -> int | None:
    from planners.app.gl import choose_gl

    choose_gl()  # before anything imports mujoco
    return importlib.import_module("planners.studio").run(arguments)


def _list(arguments: list[str]) -> None:
    print(listing())


def _columns(arguments: list[str]) -> None:
    from planners.app.columns import explained

    print(explained())


def _plan(arguments: list[str]) -> int:
    from planners.app.cli import run as plan
    from planners.app.gl import choose_gl

    search = "mppi"
    if arguments and not arguments[0].startswith("-"):
        search, *arguments = arguments
    if search not in _searches():
        raise UserError(f"there is no search {search!r}; {choose(search, _searches())}")
    choose_gl()  # before anything imports mujoco
    return plan(search, arguments, f"napsp plan {search}")


def _report(arguments: list[str]) -> int | None:
    sys.argv = ["napsp report", *arguments]
    return importlib.import_module("benchmarks.report.__main__").main()  # by name: nothing here needs benchmarks


def listing() -> str:
    """Tasks with what each ships, and the searches."""
    from napsp.envs.cards import CARDS
    from napsp.storage.shipped import shipped_names

    lines = [f"{'task':30s}{'T':>5s}  models that ship (--checkpoint NAME)"]
    for task, card in CARDS.items():
        lines.append(f"{task:30s}{card.episode_length:5d}  {', '.join(shipped_names(task)) or '-'}")
    return "\n".join([*lines, "", f"searches: {', '.join(_searches())}"])


def _searches() -> list[str]:
    from planners.app.searches import SEARCHES

    return list(SEARCHES)


WORDS: dict[str, Callable[[list[str]], int | None]] = {
    "plan": _plan,
    "studio": _studio,
    "train": _train,
    "evaluate": _evaluate,
    "list": _list,
    "columns": _columns,
    "report": _report,
}
