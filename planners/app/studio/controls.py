"""The options on the page: each is one of the planner's command line, with its value and its words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import viser  # pyright: ignore[reportMissingImports] - an extra

from mpc.cost import ActionOf, Where
from napsp.envs.cards import CARDS
from planners.app.config import COSTS
from planners.app.searches import SEARCHES
from planners.app.studio.choices import Choices, checkpoints

SHIPS = "the one that ships"


@dataclass(frozen=True)
class Range:
    """A slider's range; a value beyond it, from the command line, widens it."""

    least: float
    most: float
    step: float


RANGES = {
    "search.samples": Range(2, 256, 2),
    "search.refinements": Range(1, 8, 1),
    "search.noise_scale": Range(0.05, 2.0, 0.05),
    "search.noise_correlation": Range(0.0, 0.95, 0.05),
    "search.temperature": Range(0.01, 2.0, 0.01),
    "search.finest": Range(0.01, 1.0, 0.01),
    "search.elites": Range(1, 64, 1),
    "search.min_noise_scale": Range(0.0, 1.0, 0.05),
    "search.momentum": Range(0.0, 1.0, 0.05),
    "search.decay": Range(1.0, 3.0, 0.05),
    "search.kept": Range(0.0, 1.0, 0.05),
    "search.noise_exponent": Range(0.0, 5.0, 0.1),
    "horizon": Range(1, 40, 1),
    "distance.pessimism": Range(0.0, 5.0, 0.1),
}
WORDS = {
    "horizon": "horizon, steps",
    "where": "where d is read",
    "action_of": "action in d",
    "proposals": "policy's rollout joins",
    "smooth": "smooth plans",
    "distance.pessimism": "pessimism",
}
FIXED = ("env", "planner", "checkpoint", "seed", "cost", "where", "action_of", "horizon", "proposals", "smooth",
         "distance.pessimism")  # fmt: skip


class Controls:
    """Widgets for a choice's values, in the present folder of the page.

    Args:
        server: the page.
        choices: what to show.
        on_change: called with name and value when a user chooses another.
    """

    def __init__(self, server: viser.ViserServer, choices: Choices, on_change: Callable[[str, Any], Any]) -> None:
        self._gui, self._on_change = server.gui, on_change
        self._widgets: dict[str, Any] = {}
        self._values: dict[str, Any] = {}
        self._task, self._search = self._gui.add_folder("Task and planner"), self._gui.add_folder("Search")
        self._cost = self._gui.add_folder("Cost")
        self.show(choices)

    def show(self, choices: Choices) -> None:
        """Let the widgets have the values of a choice; another planner or task has other widgets."""
        values, before = choices.values, self._values
        self._values = values
        if any(values.get(name) != before.get(name) for name in ("planner", "env")) or values.keys() != before.keys():
            self._build(values)
        for name, widget in self._widgets.items():
            value = SHIPS if values[name] is None else values[name]
            if widget.value != value:
                widget.value = value

    def _build(self, values: dict[str, Any]) -> None:
        for widget in self._widgets.values():
            widget.remove()
        self._widgets = {}
        with self._task:
            self._choose("env", values, list(CARDS), "task")
            self._choose("planner", values, list(SEARCHES))
            self._choose("checkpoint", values, [SHIPS, *checkpoints(values["env"])])
            self._keep("seed", self._gui.add_number("seed", values["seed"], min=0, step=1))
        with self._search:
            for name in values:
                if name not in FIXED:
                    self._slide(name, values)
            self._slide("horizon", values)
            self._tick("smooth", values)
        with self._cost:
            self._choose("cost", values, list(COSTS))
            self._choose("where", values, list(get_args(Where)))
            self._choose("action_of", values, list(get_args(ActionOf)))
            self._slide("distance.pessimism", values)
            self._tick("proposals", values)

    def _choose(self, name: str, values: dict[str, Any], options: list[str], label: str = "") -> None:
        now = SHIPS if values[name] is None else values[name]
        options = options if now in options else [*options, now]
        self._keep(name, self._gui.add_dropdown(label or _words(name), options, initial_value=now))

    def _tick(self, name: str, values: dict[str, Any]) -> None:
        self._keep(name, self._gui.add_checkbox(_words(name), values[name]))

    def _slide(self, name: str, values: dict[str, Any]) -> None:
        value, usual = values[name], RANGES.get(name)
        if isinstance(value, str):  # an option of a search that is a word
            self._keep(name, self._gui.add_text(_words(name), value))
        elif usual is None:
            self._keep(name, self._gui.add_number(_words(name), value))
        else:
            least, most = min(usual.least, value), max(usual.most, value)
            kind = type(value)  # a slider of whole numbers gives whole numbers
            step = kind(usual.step)
            self._keep(name, self._gui.add_slider(_words(name), kind(least), kind(most), step, value))

    def _keep(self, name: str, widget: Any) -> None:
        self._widgets[name] = widget

        @widget.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # else it was set here
                value = event.target.value
                self._on_change(name, None if name == "checkpoint" and value == SHIPS else value)


def _words(name: str) -> str:
    return WORDS.get(name, name.removeprefix("search.").replace("_", " "))
