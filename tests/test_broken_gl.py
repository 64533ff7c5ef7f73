"""A MUJOCO_GL that does not work stops nothing that needs no picture."""

import os
import subprocess
import sys

import pytest

SMALL = ["--samples", "6", "--horizon", "2", "--threads", "1"]
PLAN = ["planners.mppi", "--env", "point_maze", "--cost", "euclidean", "--episodes", "1", *SMALL]


def run(folder, *command):
    environment = {**os.environ, "MUJOCO_GL": "nonsense", "OMP_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, "-m", *command], cwd=folder, capture_output=True, text=True, env=environment)


@pytest.mark.parametrize("command", [[*PLAN, "--out", "plans"], ["napsp.evaluate", "--episodes", "1"]])
def test_commands_run_without_pictures_and_say_so(tmp_path, command):
    done = run(tmp_path, *command)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert done.stderr.startswith("MUJOCO_GL=nonsense does not work here (") and done.stderr.count("\n") == 1
    if command[0] == "planners.mppi":
        assert "no video: no off-screen OpenGL here" in done.stdout and (tmp_path / "plans/summary.json").is_file()


def test_a_display_that_works_is_left_alone(monkeypatch):
    from napsp.opengl import import_mujoco

    monkeypatch.setenv("MUJOCO_GL", "nonsense")  # mujoco is imported already, with what worked
    import_mujoco()
    assert os.environ["MUJOCO_GL"] == "nonsense"
