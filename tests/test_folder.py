"""An output folder belongs to one configuration: other options never replace what it holds."""

import json

import pytest

from napsp.errors import UserError
from planners.app.cli import run
from planners.app.folder import OWNER, claim

PLAN = ["--env", "point_maze", "--cost", "euclidean", "--episodes", "1", "--samples", "4", "--horizon", "2"]


def plan(folder, *options):
    return run("mppi", [*PLAN, "--no-video", "--threads", "1", "--out", str(folder), *options])


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def described(**changes):
    own = {"env": "point_maze", "planner": "mppi", "cost": "sparse", "seed": 90_000, "differences": {"horizon": 2}}
    return {**own, "config": {"distance": {"ensemble": []}}, "run": {"checkpoint": None}, **changes}


def test_other_options_are_refused_and_leave_everything_as_it_was(tmp_path):
    assert plan(tmp_path) == 0
    before = content(tmp_path)
    for options, named in ((["--horizon", "3"], "horizon"), (["--seed", "1"], "seed"), (["--cost", "sparse"], "cost")):
        with pytest.raises(UserError, match=rf"holds plans of other options \({named}.*\); choose another --out"):
            plan(tmp_path, *options)
    assert content(tmp_path) == before


def test_the_same_options_replace_their_results_and_say_so(tmp_path, capsys):
    plan(tmp_path)
    assert "replacing" not in capsys.readouterr().out
    (tmp_path / "video.mp4").write_bytes(b"of the first run")
    plan(tmp_path, "--episodes", "2")
    assert "replacing the results of the same options" in " ".join(capsys.readouterr().out.split())
    assert json.loads((tmp_path / "summary.json").read_text())["episodes"] == 2
    assert not (tmp_path / "video.mp4").exists(), "it would look like this run's"


def test_how_long_a_goal_has_to_be_held_is_an_option_of_the_results(tmp_path):
    plan(tmp_path)
    with pytest.raises(UserError, match=r"other options \(hold\)"):
        plan(tmp_path, "--hold", "0")
    for name in (OWNER, "summary.json"):  # as folders of before
        found = json.loads((tmp_path / name).read_text())
        del (found if name == OWNER else found["run"])["hold"]
        (tmp_path / name).write_text(json.dumps(found))
    with pytest.raises(UserError, match=r"other options \(hold\)"):
        plan(tmp_path)  # all episodes had their whole length
    (tmp_path / OWNER).unlink()
    assert plan(tmp_path, "--hold", "0") == 0 and json.loads((tmp_path / OWNER).read_text())["hold"] == 0


def test_results_stay_until_there_is_a_first_one_to_take_their_place(tmp_path, monkeypatch):
    plan(tmp_path)
    (tmp_path / "video.mp4").write_bytes(b"of the first run")
    before = content(tmp_path)
    monkeypatch.setattr("planners.app.session.Session.run_episode", interrupted)
    with pytest.raises(KeyboardInterrupt):
        plan(tmp_path)
    assert content(tmp_path) == before


def interrupted(*args, **kwargs):
    raise KeyboardInterrupt


def test_a_folder_of_before_belongs_to_what_its_summary_says(tmp_path):
    plan(tmp_path)
    (tmp_path / OWNER).unlink()
    with pytest.raises(UserError, match=r"other options \(horizon\)"):
        plan(tmp_path, "--horizon", "3")
    assert plan(tmp_path) == 0
    (tmp_path / OWNER).unlink()
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(UserError, match="plans of an older version"):
        plan(tmp_path)


def test_files_of_unknown_origin_are_not_replaced(tmp_path):
    (tmp_path / "video.mp4").write_bytes(b"the user's own")
    with pytest.raises(UserError, match=r"holds video\.mp4 of options that are not known"):
        plan(tmp_path)
    assert content(tmp_path) == {"video.mp4": b"the user's own"}


def test_of_two_that_begin_at_once_one_gets_the_folder(tmp_path):
    assert claim(tmp_path, described()) is None
    with pytest.raises(UserError, match=r"other options \(horizon, where\)"):  # before the first has left any result
        claim(tmp_path, described(differences={"horizon": 3, "where": "both"}))
    with pytest.raises(UserError, match=r"other options \(checkpoint\)"):
        claim(tmp_path, described(run={"checkpoint": "runs/a"}))
    assert claim(tmp_path, described(config={})) is None, "the same again; summaries of before lack parts"
    (tmp_path / OWNER).write_text("{")
    with pytest.raises(UserError, match="damaged"):
        claim(tmp_path, described())
