"""The parts of the page: tables, learning curves, further figures, pictures and videos, the glossary."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import readme
from benchmarks.cells import RESULTS
from benchmarks.curves import Line, current_runs, draw, expected_lines
from benchmarks.readme import Table
from benchmarks.report.markup import Markup, data_uri, figure
from benchmarks.report.origins import ORIGINS, Origin
from benchmarks.tables_columns import columns_table
from napsp.envs.cards import suite

CAPTIONS = {
    "figure5": "Maximum reward, merging and relaxation rates on pick and place (python -m benchmarks.curves)",
    "smoothing_frontier": "Steps to the goal over action rate, smoothed and filtered (python -m benchmarks.smoothing)",
}
"""Of figures that belong to no table; others are called as their files are."""
FEW = 4  # revisions that are named at once


@dataclass(frozen=True)
class Section:
    """A part of the page: what the list of contents calls it, and its HTML below the heading."""

    title: str
    body: str

    @property
    def anchor(self) -> str:
        """Its address within the page."""
        return re.sub(r"\W+", "-", self.title.lower()).strip("-")


def table_section(table: Table, markup: Markup) -> Section | None:
    """A table with its words, figures and origin; None if it has no rows."""
    lines = table()
    if not lines:
        return None
    title = lines[0].removeprefix("### ").partition(" (`")[0]
    origin = ORIGINS.get(table)
    return Section(title, markup(lines[1:]) + (made_by(origin) if origin else ""))


def made_by(origin: Origin) -> str:
    """Command, rows, revisions and seeds."""
    commands = " and ".join(f"<code>{html.escape(part)}</code>" for part in origin.command.split("; ") if part)
    found = origin.found()
    revisions = found.revisions
    named = ", ".join(f"<code>{html.escape(revision)}</code>" for revision in revisions)
    if len(revisions) > FEW:
        named = f"<details><summary>{len(revisions)} revisions</summary>{named}</details>"
    else:
        named = f"{'revision' if len(revisions) == 1 else 'revisions'} {named}" if named else "revision not recorded"
    kinds = {"training seeds": found.training_seeds, "episode seeds": found.episode_seeds}
    seeds = [f"{kind} {numbers}" for kind, numbers in kinds.items() if numbers]
    parts = [f"Made by {commands}", f"rows in <code>{html.escape(origin.files)}</code>", *seeds, named]
    return f'<div class="made">{" · ".join(parts)}</div>'


def curves_section() -> Section:
    """Success and nearness over training episodes, a figure per task."""
    words = "Interquartile means over training seeds and their 95 % bootstrap intervals; every method has one colour."
    figures = []
    for env in (*suite("paper"), *suite("harder")):
        runs = current_runs(env)
        missing = [line.name for line in expected_lines(env) if line not in runs]
        caption = f"{env}" + (f"; not run: {', '.join(missing)}" if missing else "")
        figures.append(figure(task_curves(env, runs), ".svg", caption))
    return Section("Learning curves", f'<p>{words}</p><div class="pair">{"".join(figures)}</div>')


def task_curves(env: str, runs: Mapping[Line, list[dict[str, Any]]]) -> bytes:
    """The two panels of a task as SVG."""
    import matplotlib
    from matplotlib.figure import Figure

    picture = Figure(figsize=(6.4, 3.2), layout="constrained")
    for axis, column in zip(picture.subplots(1, 2), ("success_rate", "max_reward"), strict=True):
        draw(axis, env, runs, column)
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": env}):
        picture.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()


def figures_section(markup: Markup) -> Section | None:
    """Figures of results/ that no table shows."""
    rest = sorted(set(RESULTS.glob("*.png")) - markup.shown)
    if not rest:
        return None
    named = [(path, CAPTIONS.get(path.stem, path.stem.replace("_", " "))) for path in rest]
    return Section("Further figures", "".join(figure(path.read_bytes(), path.suffix, name) for path, name in named))


def readme_pictures() -> dict[Path, str]:
    """Pictures of planned episodes and their captions, as the README has them."""
    found = re.findall(r"!\[[^]]*\]\((docs/images/[^)]+)\)\n\n\*([^*]+)\*\n", readme.README.read_text())
    return {Path(path): " ".join(caption.replace("`", "").split()) for path, caption in found}


def pictures_section(videos: Path, budget: int) -> Section:
    """Planned episodes: the README's pictures, and the videos of planning commands as long as bytes are left."""
    parts, left = [], budget
    for path, caption in readme_pictures().items():
        parts.append(figure(path.read_bytes(), path.suffix, caption))
        left -= path.stat().st_size
    found = sorted(videos.rglob("*.mp4"))
    for path in found:
        name = html.escape(str(path))
        if path.stat().st_size > left:
            parts.append(f"<p>{name} is left out: the page would be too large.</p>")
            continue
        left -= path.stat().st_size
        video = f'<video controls preload="metadata" src="{data_uri(path.read_bytes(), path.suffix)}"></video>'
        parts.append(f"<figure>{video}<figcaption>{name}</figcaption></figure>")
    if not found:
        parts.append(f"<p>No videos in {html.escape(str(videos))}/: planning commands leave them there.</p>")
    return Section("Planned episodes", "".join(parts))


def sections(videos: Path, video_bytes: int) -> list[Section]:
    """All parts in order."""
    markup = Markup()
    tables = [table for page in (readme.README, readme.PAGE) for table in readme.TABLES[page]]
    found = [section for table in tables if (section := table_section(table, markup))]
    found.insert(1, curves_section())
    found.append(pictures_section(videos, video_bytes))
    if (rest := figures_section(markup)) is not None:
        found.append(rest)
    glossary = table_section(columns_table, markup)
    return [*found, glossary] if glossary else found
