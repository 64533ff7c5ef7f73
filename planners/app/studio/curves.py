"""Live curves of an episode: one point per control step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from planners.app.studio.opening import period_of
from planners.app.studio.trial import Lived, Scenery

if TYPE_CHECKING:
    import viser  # pyright: ignore[reportMissingImports] - an extra

BLUE, RED, GREY = "#2563eb", "#dc2626", "#9ca3af"
CHARTS = (
    ("cost of the plan, and d (red), in steps", (("cost", BLUE), ("d", RED))),
    ("effective samples", (("samples", BLUE),)),
    ("milliseconds: plan, late (red), control period", (("plan", BLUE), ("late", RED), ("period", GREY))),
)
HEIGHT = 130  # pixels of a chart


class Curves:
    """Charts in the present folder of the page."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._charts = [
            server.gui.add_uplot(
                data,
                ({"label": "step"}, *({"label": label, "stroke": color, "width": 2} for label, color in lines)),
                scales={"x": {"time": False}},
                legend={"show": False},
                title=title,
                height=HEIGHT,
            )
            for (title, lines), data in zip(CHARTS, columns([], 0.0), strict=True)
        ]
        self._drawn: Scenery | None = None

    def draw(self, newest: Scenery) -> None:
        """Show the figures of all control steps so far."""
        if newest is self._drawn:
            return
        self._drawn = newest
        found = columns(newest.lived, 1e3 * period_of(newest.session))
        for chart, data in zip(self._charts, found, strict=True):
            chart.data = data


def columns(lived: Sequence[Lived], period_ms: float) -> list[tuple[np.ndarray, ...]]:
    """What each chart shows: the number of each control step, from 1, and a column per line, all ``(T,)``.

    Before the first step there is one row of zeros, since a chart can not be empty; the cost of a plan that diverged is
    a gap.
    """

    def column(values: list[float]) -> np.ndarray:
        found = np.array(values or [0.0], float)
        return np.where(np.isfinite(found), found, np.nan)

    steps: Any = [one.step for one in lived]
    number = column([float(n) for n in range(1, len(lived) + 1)])
    return [
        (number, column([s.cost for s in steps]), column([s.steps_to_go for s in steps])),
        (number, column([s.effective_samples for s in steps])),
        (
            number,
            column([s.plan_ms for s in steps]),
            column([one.late_ms for one in lived]),
            np.full(len(number), period_ms),
        ),
    ]
