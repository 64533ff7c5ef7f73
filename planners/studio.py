"""The studio: the simulation in the browser, live, with the plans it samples.

Run it with ``python -m planners.studio --env fetch_wall``.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point of ``python -m planners.studio``."""
    from napsp.errors import run_command
    from planners.app.gl import choose_gl

    choose_gl()  # before anything imports mujoco
    run_command(lambda: run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Serve the page; see :func:`planners.app.studio.serve.run`."""
    from planners.app.studio.serve import run as serve

    return serve(arguments)


if __name__ == "__main__":
    main()
