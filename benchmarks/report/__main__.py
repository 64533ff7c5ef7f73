"""All results as one page: ``python -m benchmarks.report``.

Tables that sort, figures, learning curves and videos in one HTML file without anything from the network. It shows rows
of ``results/`` through the same functions as ``docs/results.md``; what was not run says so.
"""

from __future__ import annotations

import html
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.cells import RESULTS
from benchmarks.command import read_options
from benchmarks.report.sections import Section, sections
from napsp.errors import UserError, run_command
from napsp.storage.files import write_atomically
from napsp.storage.revision import git_revision

HERE = Path(__file__).parent
VIDEO_BYTES = 4_000_000  # a third more as text: the page stays below 10 MB


@dataclass(frozen=True)
class ReportOptions:
    """Make one HTML page of all results in results/."""

    out: Path = RESULTS / "report.html"
    """The page."""
    videos: Path = Path("plans")
    """Folder in which videos of planning commands are looked for."""


def page(parts: list[Section], revision: str) -> str:
    """The whole document."""
    style, script = (HERE.joinpath(name).read_text() for name in ("page.css", "page.js"))
    contents = "".join(f'<li><a href="#{part.anchor}">{html.escape(part.title)}</a></li>' for part in parts)
    body = "".join(
        f'<section id="{part.anchor}"><h2>{html.escape(part.title)}</h2>{part.body}</section>' for part in parts
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>napsp: results</title>
<style>{style}</style>
</head>
<body>
<header><h1>napsp: results</h1>
<p>Planning with learned distances. Made from the rows in results/ by <code>python -m benchmarks.report</code>, revision
<code>{html.escape(revision)}</code>. A click on a column's heading sorts by it, by the mean where there is an interval.
What a column means is said while the pointer rests on its heading, and in the
<a href="#{parts[-1].anchor}">last section</a>.</p></header>
<nav aria-label="Contents"><details open><summary>Contents</summary><ol>{contents}</ol></details></nav>
<main>{body}</main>
<script>{script}</script>
</body>
</html>
"""


def main() -> int:
    """Write the page.

    Raises:
        UserError: there are no rows here, or the page has the name of a folder.
    """
    options = read_options(ReportOptions, "report")
    if not (RESULTS / "runs").is_dir():
        raise UserError("there is no results/runs here; start the command in a clone of the repository")
    if options.out.is_dir():
        raise UserError(f"{options.out} is a folder; give the name of a file")
    text = page(sections(options.videos, VIDEO_BYTES), git_revision())
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out, text.encode())
    print(f"report: {options.out} ({len(text.encode()) / 1e6:.1f} MB); open it in a browser")
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
