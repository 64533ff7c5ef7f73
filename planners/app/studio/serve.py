"""The command of the studio: its options, the server, and its end."""

from __future__ import annotations

import contextlib
import io
import signal
import time
import warnings
from dataclasses import dataclass, fields
from typing import Any

from napsp.command_line import ask_in_part
from napsp.errors import UserError, choose
from napsp.settings import check_ranges
from planners.app.options import parse
from planners.app.searches import SEARCHES
from planners.app.studio.choices import Choices
from planners.app.studio.live import Live

FRAMES_PER_SECOND = 30.0
LINGER = 5.0  # seconds without a page, after there was one, before the studio ends: reloading takes less
NO_MEANING = ("--episodes", "--hold", "--out", "--video", "--no-video", "--video-episodes", "--render")


@dataclass(frozen=True)
class StudioOptions:
    """Simulate and plan live in the browser.

    Beside these it takes the options of ``python -m planners.PLANNER``, such as --env, --checkpoint, --seed, --samples
    and --cost, as what the page begins with.
    """

    planner: str = "mppi"
    """Name of the search to begin with."""
    port: int = 8080
    """Port of the page; the next free one if it is taken."""
    host: str = "127.0.0.1"
    """Address that the page is served at. The default is this machine alone; 0.0.0.0 lets everybody in the network
    in, without a password."""
    realtime: bool = False
    """Begin in real time with the newest plan instead of waiting for each one."""
    run: bool = False
    """Begin at once instead of at the press of the button."""
    stay: bool = False
    """Go on without a page; by default the studio ends soon after the last one is closed."""

    def __post_init__(self) -> None:
        check_ranges(self, port=(1, 65535))
        if self.planner not in SEARCHES:
            raise UserError(f"there is no search {self.planner!r}; {choose(self.planner, SEARCHES)}")


def read(arguments: list[str]) -> tuple[StudioOptions, Choices]:
    """What a command line asks for.

    Raises:
        UserError: an option is impossible, or means nothing here.
    """
    options, rest = ask_in_part(StudioOptions, arguments, "python -m planners.studio")
    for argument in rest:
        if argument.partition("=")[0].replace("_", "-") in NO_MEANING:
            raise UserError(f"{argument} means nothing to the studio; leave it out")
    own = [option.name for option in fields(StudioOptions)]
    return options, Choices(*parse(options.planner, rest, own))


def run(arguments: list[str]) -> int:
    """Serve the page until Ctrl-C, or until it is closed.

    Raises:
        UserError: an option is impossible, or what draws the page is not installed.
    """
    options, choices = read(arguments)
    try:
        import mjviser  # pyright: ignore[reportMissingImports] # noqa: F401 - here, so that it is said at once
        import viser  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise UserError("the studio needs viser and mjviser: pip install 'napsp[studio]'") from None
    import torch

    torch.set_num_threads(1)  # as in the planners' commands
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        live = Live(choices, options.realtime)
        server: Any = None
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # it prints a box whatever it is told
                server = viser.ViserServer(options.host, options.port, label="napsp studio", verbose=False)
            print(f"studio: http://{options.host}:{server.get_port()} (Ctrl-C ends it)", flush=True)
            if options.run:
                live.run()
            _serve(server, live, options.stay)
            print("studio: the page was closed")
        except KeyboardInterrupt:
            print("studio: ended")
        finally:
            live.close()
            if server is not None:
                with contextlib.redirect_stdout(io.StringIO()):
                    server.stop()
    return 0


def _serve(server: Any, live: Live, stay: bool) -> None:
    from planners.app.studio.page import Page

    page = Page(server, live)
    seen, due = None, time.monotonic()
    while True:
        page.draw()
        now = time.monotonic()
        if server.get_clients():
            seen = now
        elif seen is not None and not stay and now - seen > LINGER:
            return
        due = max(due + 1.0 / FRAMES_PER_SECOND, now)
        time.sleep(due - now)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt
