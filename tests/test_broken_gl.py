"""A MUJOCO_GL that does not work stops nothing that needs no picture."""

import os
import subprocess
import sys
import warnings

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


@pytest.mark.parametrize(("module", "words"), [
    ("mujoco.glfw", "no video: mujoco was imported when nothing said how to draw without a display; set MUJOCO_GL="),
    ("mujoco.osmesa", "no video: no off-screen OpenGL here (no context); install libosmesa6 or libegl1"),
])  # fmt: skip
def test_a_notebook_that_imported_mujoco_first_is_told_what_helps(tmp_path, monkeypatch, module, words):
    import mujoco

    from napsp import envs
    from planners.app.video import Video

    def renderer(*_):
        warnings.warn("X11: The DISPLAY environment variable is missing", stacklevel=2)
        raise RuntimeError("no context")

    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(mujoco, "GLContext", type("GLContext", (), {"__module__": module}), raising=False)
    monkeypatch.setattr(mujoco, "Renderer", renderer)
    env = envs.make("point_maze")
    assert Video(tmp_path / "video.mp4", env.unwrapped).close().startswith(words)
    env.close()
