"""The page of all results: complete, on its own, and it sorts in a real browser."""

import itertools
import re
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from browsers import opened_browser, troubles

from benchmarks import readme, units
from benchmarks.report import __main__ as report
from benchmarks.report.markup import Markup, sort_key
from benchmarks.report.origins import ORIGINS, ranges
from benchmarks.report.sections import pictures_section, readme_pictures
from benchmarks.tables_columns import COLUMNS
from benchmarks.tables_glance import glance_rows, glance_table, planned_rows, planned_table, sparse_runs
from benchmarks.tables_summary import TASKS, plus_runs, summary_rows, summary_table
from napsp.envs.cards import suite
from napsp.errors import UserError
from planners.app import command

ROOT = Path(__file__).parents[1]
LOADS = {"src", "srcset", "poster", "data"}  # attributes that make a browser fetch something
SINGLE = {"meta", "link", "img", "br", "hr"}


class Reader(HTMLParser):
    """What a page has: cells row by row, what it would fetch, anchors; tags that were left open."""

    def __init__(self, text):
        super().__init__()
        self.open, self.fetched, self.anchors, self.links, self.rows, self.titles = [], [], set(), set(), [], {}
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.fetched += [found[name] for name in LOADS & found.keys()]
        self.fetched += [found["href"]] if tag == "link" else []
        self.anchors |= {found["id"]} if "id" in found else set()
        self.links |= {found["href"]} if tag == "a" else set()
        self.last = found
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in SINGLE:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += text
            if "button" in self.open:
                self.titles[text] = self.last.get("title")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The page as the command makes it from some of the rows, and the tables of the same rows."""
    place = tmp_path_factory.mktemp("clone")
    kept = ["README.md", "docs/images/*", "results/*.*", "napsp/checkpoints/*/training.json"]
    for pattern in [*kept, *(f"results/runs/{env}-*" for env in ("fetch_wall", "claw", "point_maze_long"))]:
        for path in ROOT.glob(pattern):
            copy = place / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        command.run(["report"])
        tables = [table() for page in (readme.README, readme.PAGE) for table in readme.TABLES[page]]
    return place / "results" / "report.html", tables


@pytest.mark.slow
def test_the_page_is_whole_on_its_own_and_has_every_table(made):
    text = made[0].read_text()
    found = Reader(text)
    assert not found.open, "tags that nothing closes"
    assert found.fetched and all(address.startswith("data:") for address in found.fetched)
    assert not re.search(r"url\(|@import|fetch\(|XMLHttpRequest|https?://(?!www\.w3\.org)", text)
    assert {link.removeprefix("#") for link in found.links} <= found.anchors
    assert 1e6 < len(text.encode()) < 10e6 and "No videos in plans/" in text

    rows = {tuple(cell.strip() for cell in row) for row in found.rows}
    for table in made[1]:
        lines = [line for line in table if line.startswith("| ")]
        cells = [tuple(cell.strip(" `") for cell in line.strip("| ").split(" | ")) for line in lines]
        assert cells and all(any(row[: len(cell)] == cell for row in rows) for cell in cells), table[0]
    assert not {name for name, title in found.titles.items() if not title} - {"column", "meaning"}
    assert text.count('<div class="made">') == len(ORIGINS)


@pytest.mark.slow
def test_every_table_says_where_its_rows_come_from():
    shown = {table for page in (readme.README, readme.PAGE) for table in readme.TABLES[page]}
    assert shown == ORIGINS.keys()
    found = {table.__name__: origin.found() for table, origin in ORIGINS.items()}
    assert all(one.revisions for one in found.values())
    assert found["versus_table"].training_seeds == "0 to 2" and found["versus_table"].episode_seeds == "90000 to 90049"
    assert found["learning_table"].training_seeds == "0 to 9" and not found["learning_table"].episode_seeds
    assert ranges({5, 1, 2, 3}) == "1 to 3, 5" and ranges(set()) == ""


def test_what_ships_is_a_line_for_each_task_and_says_what_was_not_run(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = {
        line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ")[1:] for line in glance_table() if "|" in line
    }
    rows = {row["planner"]: row for row in planned_rows() if row["env"] == "fetch_wall" and '"plus"' in row["training"]}
    assert found["fetch_wall"][5].startswith(f"{float(rows['policy']['success_rate']):.2f} ")
    assert found["fetch_wall"][1] == "1.00 [1.00, 1.00]" and len(sparse_runs("fetch_wall")) >= 3
    monkeypatch.chdir(tmp_path)
    lines = [line.strip("| ").split(" | ") for line in glance_table() if line.startswith("| ")][1:]
    assert lines == [[env, *["not run"] * 8] for env in suite("paper")] and not glance_rows()
    assert [line for line in planned_table() if line.startswith("| claw")] == [
        f"| claw | {method}, not run |  |  |  |  |  |" for method in ("ours", "plus")
    ]


def test_plus_has_a_line_for_each_task_made_of_runs_distances_and_plans(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = {
        cells[0]: cells[1:] for cells in (line.strip("| ").split(" | ") for line in summary_table() if "|" in line)
    }
    curves = [run["curve"] for run in plus_runs("point_maze_long")]
    last = [[row["success_rate"] for row in curve][-5:] for curve in curves]
    assert found["point_maze_long"][0] == str(len(curves)) and all(len(rates) == 5 for rates in last)
    assert found["point_maze_long"][2] == f"{min(sum(rates) / 5 for rates in last):.2f}"
    assert found["fetch_wall"][3:5] == ["100 (5 of 5)", "150 (10 of 10)"]
    assert found["fetch_pick_place"][7:9] == ["1.00, 1.00, 1.00"] * 2  # of iCEM, not of MPPI, which has rows as well
    budget, took, period = map(int, re.match(r"(\d+) plans, (\d+) of (\d+) ms", found["fetch_wall"][9]).groups())
    assert budget == 8 and took < period == 40
    monkeypatch.chdir(tmp_path)
    lines = [line.strip("|").split("|") for line in summary_table() if line.startswith("| ")][1:]
    assert [[cell.strip() for cell in line] for line in lines] == [[env, "not run", *[""] * 9] for env in TASKS]
    assert not summary_rows()


@pytest.mark.slow
def test_every_column_is_explained_and_no_other(made):
    heads = [line for table in made[1] for line in _heads(table)]
    assert {name for line in heads for name in line.strip("| ").split(" | ")} == COLUMNS.keys()


def _heads(lines):
    return [before for before, after in itertools.pairwise(lines) if after.startswith("|---")]


def test_cells_are_sorted_by_their_mean_and_what_was_not_run_has_no_key():
    assert [sort_key(cell) for cell in ("0.98 [0.90, 1.00]", "+0.02 [-0.05, +0.10]", "-0.01", "20.0 / 19.9")] == [
        "0.98", "+0.02", "-0.01", "20.0",
    ]  # fmt: skip
    assert [sort_key(cell) for cell in ("not run", "-", "", "never (2 of 10)")] == ["", "", "", "Infinity"]
    assert sort_key("9b3f91572257") == "9b3f91572257" and sort_key("2.13.0+cpu") == "2.13.0+cpu"


def test_methods_have_the_colour_of_the_figures_and_markup_is_escaped():
    html = Markup()(["| method | cost |", "|---|---|", "| plus, x < 1 | not run |"])
    assert '<i class="dot" style="background:#9467bd"></i>plus, x &lt; 1</td>' in html
    assert '<td class="missing" data-key="">not run</td>' in html and f'title="{COLUMNS["cost"]}"' in html


def test_videos_are_shown_as_long_as_there_is_room(tmp_path):
    assert "No videos in" in pictures_section(tmp_path, 1000).body
    for name, size in (("a", 300), ("b", 2000)):
        (tmp_path / f"{name}.mp4").write_bytes(bytes(size))
    body = pictures_section(tmp_path, 10**6).body
    assert body.count("<video") == 2 and "No videos" not in body
    pictures = readme_pictures()
    assert len(pictures) == 3 and all("seed 0" in caption and "step" in caption for caption in pictures.values())
    body = pictures_section(tmp_path, sum(path.stat().st_size for path in pictures) + 500).body
    assert body.count("<video") == 1 and body.count("<img") == 3 and "b.mp4 is left out" in body


def test_the_claw_is_measured_in_degrees():
    assert units.unit("claw") == "°" and units.unit("fetch_wall") == units.unit("my_module:Env") == "m"
    assert units.in_unit("claw", "max_reward", -(2**0.5)) == pytest.approx(-90.0)
    assert units.in_unit("claw", "success_rate", 0.5) == 0.5 and units.in_unit("fetch_wall", "max_reward", -0.5) == -0.5


def test_without_rows_it_says_where_to_start_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["report"])
    with pytest.raises(UserError, match="start the command in a clone"):
        report.main()


@pytest.mark.slow
def test_a_click_sorts_in_a_browser(made):
    with opened_browser() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 844})
        wrong = troubles(page)
        page.goto(made[0].as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, "a telephone's page is not wider than it"
        table = page.locator("#the-paper-s-comparison table")
        head = table.get_by_role("columnheader").nth(4)
        assert head.inner_text().startswith("success")
        before = keys(table)
        for order, sign in (("ascending", 1), ("descending", -1)):
            head.get_by_role("button").dispatch_event("click")
            assert head.get_attribute("aria-sort") == order
            after = keys(table)
            measured = [float(key) for key in after if key]
            assert measured == sorted(measured, key=lambda value, sign=sign: sign * value) and len(set(measured)) > 5
            assert "" in after and not any(after[len(measured) :]), "what was not run stands last"
            assert sorted(after) == sorted(before)
        head.get_by_role("button").dispatch_event("click")
        assert head.get_attribute("aria-sort") is None and keys(table) == before
        name = table.get_by_role("columnheader").nth(1)
        name.get_by_role("button").dispatch_event("click")
        assert name.get_attribute("aria-sort") == "ascending"
        assert page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth)")
        assert not wrong


def keys(table):
    return table.evaluate("table => [...table.tBodies[0].rows].map(row => row.cells[4].dataset.key)")
