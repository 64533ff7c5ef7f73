"""Sentences for mistakes of the user's: whose line they name."""

import sys
import warnings

import numpy
import pytest

import mpc.controller
import napsp.envs.check
from napsp.errors import describe_failure, is_ours, run_command


def test_a_file_is_ours_by_where_it_lies(tmp_path):
    for module in (napsp.envs.check, mpc.controller):
        assert is_ours(module.__file__)
    for name in ("napsp/tests/test_check.py", "planners/app/session.py", "napsp/napsp/errors.py"):
        assert not is_ours(str(tmp_path / name)), "a checkout of the user's may have folders of these names"
    assert not is_ours(numpy.__file__)


def test_the_line_of_the_user_is_named_in_a_folder_called_like_the_package(tmp_path, monkeypatch):
    folder = tmp_path / "napsp" / "tasks"
    folder.mkdir(parents=True)
    (folder / "mine_in_napsp.py").write_text("def cost():\n    raise RuntimeError('no')\n")
    monkeypatch.syspath_prepend(str(folder))
    import mine_in_napsp

    try:
        mine_in_napsp.cost()
    except RuntimeError as error:
        assert describe_failure(error) == "RuntimeError: no (mine_in_napsp.py, line 2)"
    del sys.modules["mine_in_napsp"]


def test_a_commands_own_warning_is_a_line_without_source_and_others_name_their_place(capsys):
    shown, said = warnings.formatwarning, warnings.showwarning

    def command():
        own = mpc.controller.__file__
        for text, file in (("plans are late", own), ("old", "theirs.py")):
            print(warnings.formatwarning(text, RuntimeWarning, file, 7, None), end="", file=sys.stderr)

    with pytest.raises(SystemExit) as ended:
        run_command(command)
    assert ended.value.code == 0 and (warnings.formatwarning, warnings.showwarning) == (shown, said)
    assert capsys.readouterr().err == "warning: plans are late\nwarning: theirs.py:7: RuntimeWarning: old\n"
