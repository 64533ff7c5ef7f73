"""What a newcomer meets: options that may have been meant, units, columns, what to do next, nothing left behind."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tiny import tiny

import napsp.train as training
from napsp.columns import TRAINING
from napsp.envs.gap import goal_gap, world_gap
from napsp.errors import UserError
from napsp.storage import progress, trackers
from planners.app import options
from planners.app.columns import PLANNING, explained
from planners.app.episode import COLUMNS

ROOT = Path(__file__).parents[1]
PLAN = ("--env", "point_maze", "--samples", "8", "--horizon", "4", "--episodes", "1", "--threads", "1")


def asked_in(text):
    return {part for title in text for part in re.split(r", | \[", title.replace("]", ""))}


@pytest.mark.parametrize(
    ("parse", "arguments", "sentence"),
    [
        (training.parse, ["--epsiodes", "5"], "no option --epsiodes; did you mean --episodes"),
        (training.parse, ["--counts.visit-bit=9"], "no option --counts.visit-bit; did you mean --counts.visit-bits"),
        (training.parse, ["--threads", "many"], "--threads: invalid literal"),
        (training.parse, ["--method", "plas"], "unknown method 'plas'; did you mean plus"),
        (training.parse, ["--env", "fetch_wal"], "unknown environment 'fetch_wal'; did you mean fetch_wall"),
        (training.parse, ["--env", "FetchPus-v4"], "unknown environment 'FetchPus-v4'; did you mean FetchPush-v4"),
        (training.parse, ["fetch_wall"], "'fetch_wall' belongs to no option"),
        (lambda words: options.parse("mppi", words), ["--sampels", "5"], "did you mean --samples"),
        (lambda words: options.parse("mppi", words), ["--temprature", "5"], "did you mean --search.temperature"),
        (lambda words: options.parse("mppi", words), ["--where", "men"], "'men'.*terminal.*both"),
    ],
)
def test_what_is_not_known_is_answered_in_a_sentence_with_what_may_have_been_meant(parse, arguments, sentence):
    with pytest.raises(UserError, match=sentence) as error:
        parse(arguments)
    assert "\n" not in str(error.value) and "│" not in str(error.value)


def test_help_shows_options_in_groups(capsys):
    with pytest.raises(SystemExit):
        options.parse("mppi", ["--help"])
    said = capsys.readouterr().out
    assert re.search(r"run options.*--episodes INT", said, re.DOTALL) and "--run." not in said
    assert "{terminal,mean,both}" in said


def test_gaps_are_shown_in_units_of_the_task(worlds):
    claw, wall = worlds["claw"], worlds["fetch_wall"]
    angles = np.radians([0.0, 10.0, 90.0, 180.0])
    goals = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    between = np.linalg.norm(goals - goals[0], axis=-1)
    in_the_world = np.linalg.norm(claw.goal_positions(goals) - claw.goal_positions(goals[0]), axis=-1)
    for found, unit in (goal_gap(claw, between), world_gap(claw, in_the_world)):
        assert unit == "deg"
        np.testing.assert_allclose(found, np.degrees(angles), atol=1e-6)
    assert goal_gap(wall, np.array(0.05)) == (0.05, "m")
    assert world_gap(wall, np.array(0.05)) == (5.0, "cm")


def test_every_column_is_explained_and_the_glossary_says_the_same():
    known = asked_in({**TRAINING, **PLANNING})
    titles = {title.partition(" [")[0] for title, _ in progress.COLUMNS.values()}
    assert titles <= known, titles - known
    assert set(COLUMNS[2:]) <= known
    page = (ROOT / "docs/glossary.md").read_text()
    said = explained()
    for name, meaning in {**TRAINING, **PLANNING}.items():
        assert f"| {name} | {meaning} |" in page, "write docs/glossary.md again"
        assert meaning.replace("`", "") in said


def test_a_pipe_is_told_how_far_a_training_is(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "ELSEWHERE", 0.0)
    seen = progress.Progress(tmp_path, [], unit="deg")
    seen.tick(20, 400, 90.0)
    title, line = capsys.readouterr().out.splitlines()
    assert "gap [deg]" in title and "gap [m]" not in title
    assert line == "  episode 20/400, 1.5 min left"


def test_a_missing_tracker_is_said_before_a_folder_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(trackers, "find_spec", lambda name: None)
    for name in trackers.TRACKERS:
        with pytest.raises(UserError, match=rf"pip install 'napsp\[{name}\]'"):
            training.train(tiny(), tmp_path / "run", trackers=[name])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", trackers.TRACKERS)
def test_a_training_logs_to_a_tracker(name, tmp_path, monkeypatch):
    pytest.importorskip(name)
    monkeypatch.setenv("WANDB_MODE", "offline")
    rows = training.train(tiny(), tmp_path / "run", trackers=[name])
    files = [path for path in (tmp_path / "run" / name).rglob("*") if path.is_file()]
    assert rows and any(path.stat().st_size for path in files)


def test_a_finished_training_says_a_command_that_works_and_leaves_only_its_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = Path("my runs/first")
    training.train(tiny(), folder)
    done, following = training.what_next(tiny(), folder).splitlines()
    assert all((folder / name).is_file() for name in re.findall(r"[\w.]+\.(?:csv|png|safetensors)", done))
    words = shlex.split(following.removeprefix("next: "))
    assert words[:3] == ["python", "-m", "planners.mppi"]
    result = subprocess.run(
        [sys.executable, *words[1:], *PLAN[2:], "--no-video"], capture_output=True, text=True, timeout=240
    )
    assert result.returncode == 0 and result.stderr == "", result.stderr
    assert "\r" not in result.stdout and "\x1b" not in result.stdout  # a pipe has no use for them
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my runs", "plans"]
    assert not [path for path in tmp_path.rglob("*") if path.name.startswith(".") or path.suffix in (".lock", ".TXT")]
    assert not [path for path in tmp_path.rglob("*") if path.is_dir() and not any(path.iterdir())]


def test_a_sparse_policy_is_evaluated_next(tmp_path):
    config = tiny(method="sparse")
    training.train(config, tmp_path / "run")
    assert "next: python -m napsp.evaluate --env point_maze" in training.what_next(config, tmp_path / "run")
