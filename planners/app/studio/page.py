"""The page: the scene, what one can do in it, and what it says; drawn by the thread that calls :meth:`Page.draw`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import viser  # pyright: ignore[reportMissingImports] - an extra

from planners.app.studio.controls import Controls
from planners.app.studio.curves import Curves
from planners.app.studio.live import Live
from planners.app.studio.scene import Scene
from planners.app.studio.words import goal, lateness, progress

WORDS_EVERY = 0.25  # seconds between two looks at figures, which nobody reads faster
SECOND = 1.0


class Page:
    """Shows a live simulation in every browser that is connected, and hands on what is ordered there."""

    def __init__(self, server: viser.ViserServer, live: Live) -> None:
        self._server, self._live = server, live
        self._stale = True
        self._frames: deque[float] = deque()
        self._worded = 0.0
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()  # beside the scene, not over it
        gui.set_panel_label("napsp studio")
        self._says = gui.add_markdown("")
        self._run = gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY)
        self._run.on_click(lambda _: self._order(live.pause if live.running else live.run))
        gui.add_button("Step", icon=viser.Icon.PLAYER_TRACK_NEXT).on_click(lambda _: self._order(live.step))
        gui.add_button("Reset", icon=viser.Icon.REFRESH).on_click(lambda _: self._order(live.reset))
        self._realtime = gui.add_checkbox("real time, newest plan", live.realtime)
        self._realtime.on_update(lambda event: setattr(live, "realtime", event.target.value))
        goes_on = gui.add_checkbox("next seed after an episode", live.goes_on)
        goes_on.on_update(lambda event: setattr(live, "goes_on", event.target.value))
        with gui.add_folder("Curves"):
            self._curves = Curves(server)
        self._controls = Controls(server, live.choices, self._change)
        self._choices = live.choices
        self._scene = Scene(server, live.scenery, live.move_goal)

    @property
    def frames_per_second(self) -> float:
        """Pictures of the scene that were sent in the last second."""
        return len(self._frames) / SECOND

    def draw(self) -> None:
        """Send the newest picture, and now and then the figures."""
        newest, now = self._live.scenery, time.monotonic()
        if newest.session is not self._scene.session:
            self._scene = Scene(self._server, newest, self._live.move_goal)
        self._scene.draw(newest)
        self._frames.append(now)
        while self._frames[0] <= now - SECOND:
            self._frames.popleft()
        if now - self._worded >= WORDS_EVERY:
            self._worded = now
            self._write(newest)

    def _write(self, newest: Any) -> None:
        live = self._live
        lines = [
            progress(newest, live.choices.run.seed, live.running),
            lateness(newest, live.realtime),
            f"{self.frames_per_second:.0f} frames/s. {goal(newest)}",
        ]
        if live.problem:
            lines.insert(0, f"⚠ {live.problem}")
        text = "\n\n".join(lines)
        if self._says.content != text:
            self._says.content = text
        self._run.label = "Pause" if live.running else "Run"
        self._curves.draw(newest)
        if live.choices is not self._choices or self._stale:
            self._choices, self._stale = live.choices, False
            self._controls.show(live.choices)

    def _order(self, order: Callable[[], Any]) -> None:
        order()  # of what comes of it the page tells when it is next drawn

    def _change(self, name: str, value: Any) -> None:
        def settled(_: Future[None]) -> None:
            self._stale = True  # refused or not: the widgets show what is in force

        self._live.change(name, value).add_done_callback(settled)
