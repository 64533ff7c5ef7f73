"""Leaving out parts of method plus: each removal is one, rows become the table."""

import json

import pytest
from tiny import TINY

from benchmarks import ablation, cells, tables_plus
from benchmarks.ablation import REMOVALS, TASKS, WHOLE, removals, without
from napsp.errors import UserError


def test_every_removal_asks_something_else_and_every_part_is_left_out_somewhere():
    for env in TASKS:
        identities = [without(env, part, 0).digest() for part in removals(env)]
        assert len(set(identities)) == len(identities)
    assert {part for env in TASKS for part in removals(env)} == set(REMOVALS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--env", "claw"], "give one of them with --env"), (["--parts", "brains"], "choose from: nothing"),
     (["--env", "fetch_pick_place", "--parts", "explorers"], "no part of plus on fetch_pick_place")],
)  # fmt: skip
def test_what_cannot_be_left_out_is_said(arguments, message, monkeypatch):
    monkeypatch.setattr("sys.argv", ["ablation", *arguments])
    with pytest.raises(UserError, match=message):
        ablation.main()


WHOLE_PRESET = ablation.preset


def tiny(env, method, recipe, changes=None, *, seed):
    return WHOLE_PRESET(env, method, recipe, {**TINY, **(changes or {})}, seed=seed)


def test_runs_become_rows_of_the_table(tmp_path, monkeypatch):
    monkeypatch.setattr(cells, "RUNS", tmp_path / "runs")
    monkeypatch.setattr(cells, "ROWS", tmp_path / "rows")
    monkeypatch.setattr(tables_plus, "RESULTS", tmp_path)
    monkeypatch.setattr(ablation, "preset", tiny)
    chosen = ["--env", "fetch_wall", "--parts", WHOLE, "third layer", "--seeds", "1"]
    monkeypatch.setattr("sys.argv", ["ablation", *chosen])
    assert ablation.main() == 0
    runs = [json.loads(path.read_text()) for path in (tmp_path / "rows").glob("*.json")]
    (run,) = [run for run in runs if tuple(run["config"]["hidden"]) == TINY["hidden"]]
    last = [point["success_rate"] for point in run["curve"][-5:]]
    lines = tables_plus.ablation_table()
    (row,) = [line for line in lines if line.startswith(f"| fetch_wall | {WHOLE} |")]
    assert row.startswith(f"| fetch_wall | {WHOLE} | 1 | {sum(last) / len(last):.2f} |")
    assert [line for line in lines if line.startswith("| fetch_wall | third layer | 1 |")]
    assert [line for line in lines if line.startswith("| fetch_wall | relative errors | not run |")]


@pytest.mark.parametrize("name", ["fetch_pick_and_place", "napsp/FetchPickPlace-v0"])
def test_parts_are_those_of_the_task_by_whatever_name(name, monkeypatch):
    asked = []
    monkeypatch.setattr(ablation, "published", lambda config: asked.append(config) or True)
    monkeypatch.setattr("sys.argv", ["ablation", "--env", name, "--seeds", "1"])
    assert ablation.main() == 0
    assert [config.env for config in asked] == ["fetch_pick_place"] * len(removals("fetch_pick_place"))
