"""The command ``napsp``: what ``python -m napsp.train`` and its neighbours do, under one name."""

from __future__ import annotations

import difflib
import importlib
import sys

from napsp.errors import UserError, run_command

USAGE = """napsp: planning with learned distances

  napsp plan [SEARCH] --env TASK ...   plan with a learned distance; SEARCH is {searches} (default mppi)
  napsp studio --env TASK ...          the same live, in the browser
  napsp train --env TASK ...           train a distance and a policy
  napsp evaluate --env TASK ...        run a trained policy alone
  napsp report                         all results of a clone as one page (results/report.html)
  napsp list                           tasks, searches, and the models that ship

Each with --help says what it can do."""
TRAINING = ("train", "evaluate")
WORDS = ("plan", "studio", *TRAINING, "report", "list")


def main() -> None:
    """Entry point of ``napsp``."""
    run_command(lambda: run(sys.argv[1:]))


def run(arguments: list[str]) -> int | None:
    """Do what the first word says with the rest.

    Raises:
        UserError: there is no such word.
    """
    if not arguments or arguments[0] in ("--help", "-h", "help"):
        print(USAGE.format(searches=", ".join(_searches())))
        return 0
    word, *rest = arguments
    if word == "list":
        print(listing())
        return 0
    if word in TRAINING:
        sys.argv = [f"napsp {word}", *rest]
        return importlib.import_module(f"napsp.{word}").main()
    if word == "report":
        sys.argv = ["napsp report", *rest]
        return importlib.import_module("benchmarks.report.__main__").main()  # by name: nothing here needs benchmarks
    if word == "plan":
        return _plan(rest)
    if word == "studio":
        from planners.app.gl import choose_gl

        choose_gl()  # before anything imports mujoco
        return importlib.import_module("planners.studio").run(rest)
    raise UserError(f"there is no napsp {word}{_meant(word, WORDS)}; napsp --help lists what there is")


def _plan(arguments: list[str]) -> int:
    from planners.app.cli import run as plan
    from planners.app.gl import choose_gl

    search = "mppi"
    if arguments and not arguments[0].startswith("-"):
        search, *arguments = arguments
    if search not in _searches():
        raise UserError(f"there is no search {search!r}{_meant(search, _searches())}; choose from: "
                        f"{', '.join(_searches())}")  # fmt: skip
    choose_gl()  # before anything imports mujoco
    return plan(search, arguments)


def listing() -> str:
    """Tasks with what each ships, and the searches."""
    from napsp.envs.cards import CARDS
    from napsp.storage.checkpoint import MODEL_FILE, SHIPPED

    models = sorted(path.parent.name for path in SHIPPED.glob(f"*/{MODEL_FILE}"))
    lines = [f"{'task':30s}{'T':>5s}  models that ship (--checkpoint NAME)"]
    for task, card in CARDS.items():
        others = [name for name in CARDS if name != task and name.startswith(task)]
        own = [name for name in models if name.startswith(task) and not name.startswith(tuple(others))]
        lines.append(f"{task:30s}{card.episode_length:5d}  {', '.join(own) or '-'}")
    return "\n".join([*lines, "", f"searches: {', '.join(_searches())}"])


def _searches() -> list[str]:
    from planners.app.searches import SEARCHES

    return list(SEARCHES)


def _meant(word: str, known: tuple[str, ...] | list[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f", did you mean {close[0]}?" if close else ""
