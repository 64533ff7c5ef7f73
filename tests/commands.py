"""Commands as a user types them, without the seconds that a process of their own takes to import torch and MuJoCo."""

import runpy
import signal
import sys
import warnings

import pytest


def in_this_process(module, *arguments, capsys, monkeypatch):
    """Exit status and last words of ``python -m module``."""
    monkeypatch.setattr(sys, "argv", [module, *arguments])
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended, warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* found in sys.modules", RuntimeWarning)  # tests import what they run
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    return ended.value.code, capsys.readouterr().err


def heard():
    """Ctrl-C, also where these tests run in the background of a script, which ignores it and hands that on."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
