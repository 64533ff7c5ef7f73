"""The command napsp finds its way to the others."""

import os
import subprocess
import sys

import pytest
from commands import heard

from napsp.errors import UserError
from planners.app import command


def test_help_names_every_word_and_search(capsys):
    for arguments in ([], ["--help"]):
        assert command.run(arguments) == 0
        said = capsys.readouterr().out
        assert all(f"napsp {word}" in said for word in command.WORDS) and "predictive_sampling" in said


def test_the_list_has_every_model_once_beside_its_task(capsys):
    assert command.run(["list"]) == 0
    said = capsys.readouterr().out
    from napsp.storage.shipped import SHIPPED

    models = [path.parent.name for path in SHIPPED.glob("*/model.safetensors")]
    words = said.replace(",", " ").split()
    assert models and all(words.count(name) >= 1 for name in models)
    (wall,) = [line for line in said.splitlines() if line.startswith("fetch_pick_place_wall ")]
    (plain,) = [line for line in said.splitlines() if line.startswith("fetch_pick_place ")]
    assert "fetch_pick_place_wall_4000" in wall and "fetch_pick_place_wall" not in plain
    assert "fetch_pick_place_plus" in plain


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["trian"], "did you mean train"), (["plan", "mpi"], "did you mean mppi"), (["xyzzy"], "choose one of: plan")],
)
def test_a_word_it_does_not_know_is_answered_with_one_it_does(arguments, message):
    with pytest.raises(UserError, match=message):
        command.run(arguments)


@pytest.mark.parametrize("asked", ["command.run([])", "options.parse('mppi', ['--samples', '8'])"])
def test_help_and_options_come_without_torch(asked):
    script = f"import sys; from planners.app import command, options; {asked}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True).returncode == 0


def test_it_does_what_the_modules_do(tmp_path):
    """In processes of their own, as a user has them."""
    call = [sys.executable, "-c", "from planners.app.command import main; main()"]
    plan = ["plan", "cem", "--env", "fetch_reach", "--episodes", "1", "--no-video", "--out", str(tmp_path / "plans")]
    done = subprocess.run([*call, *plan], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "plans" / "summary.json").is_file()
    judged = subprocess.run(
        [*call, "evaluate", "--env", "fetch_reach", "--episodes", "1"], capture_output=True, text=True
    )
    assert judged.returncode == 0 and judged.stdout.startswith("policy on fetch_reach: success 1.00")
    wrong = subprocess.run([*call, "train", "--env", "nope"], capture_output=True, text=True)
    assert wrong.returncode == 2 and wrong.stderr.startswith("error: unknown environment 'nope'")


def test_a_reader_that_has_enough_ends_a_command_without_a_word():
    script = (
        "from napsp.errors import run_command; run_command(lambda: [print('line', flush=True) for _ in range(10**5)])"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as command:
        assert command.stdout.readline() == "line\n"
        command.stdout.close()
        assert command.stderr.read() == ""
    assert command.returncode == 141


def test_help_of_a_plan_names_the_command_that_was_typed(capsys):
    with pytest.raises(SystemExit):
        command.run(["plan", "icem", "--help"])
    assert "napsp plan icem" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["mytool", "benchmarks"])
def test_ctrl_c_in_a_program_that_imports_the_package_is_its_own_affair(name, tmp_path):
    tool = tmp_path / name
    tool.mkdir()
    (tool / "__init__.py").write_text("import napsp\n")
    (tool / "__main__.py").write_text(
        "import atexit, os, signal, time\natexit.register(print, 'robot stopped')\n"
        "os.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"
    )
    found = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, "-m", name], env=found, capture_output=True, text=True, preexec_fn=heard, cwd=tmp_path
    )
    assert done.stdout == "robot stopped\n" and "KeyboardInterrupt" in done.stderr


@pytest.mark.parametrize("words", [["-m", "napsp.train"], ["-m", "planners.icem"], ["-um", "napsp.train"]])
def test_ctrl_c_while_modules_are_imported_is_a_line(words, tmp_path):
    (tmp_path / "tyro.py").write_text("import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n")
    found = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, *words, "--help"], env=found, capture_output=True, text=True,
        preexec_fn=heard,
    )  # fmt: skip
    assert done.returncode == 130 and done.stderr == "interrupted\n", done.stderr
