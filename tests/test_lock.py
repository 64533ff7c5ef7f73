"""Two trainings never write one folder; a killed one keeps nobody out."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from test_saving import few

from napsp.errors import UserError
from napsp.storage.lock import BusyError, exclusive, only_writer
from napsp.train import train

HOLDS = """
import sys, time, pathlib
from napsp.storage.lock import only_writer
with only_writer(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_training_of_a_folder_is_one_sentence_and_a_kill_leaves_it_free(tmp_path):
    folder = tmp_path / "run"
    holder = subprocess.Popen([sys.executable, "-c", HOLDS, str(folder)], stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "held\n"
    for restart in (False, True):
        with pytest.raises(UserError, match="another process trains in"):
            train(few(n_episodes=6), folder, restart=restart)
    holder.send_signal(signal.SIGKILL)
    holder.communicate()
    assert [path.name for path in folder.iterdir()] == [".lock"], "what a kill leaves"
    assert train(few(n_episodes=6), folder)[-1]["episodes"] == 6
    assert not (folder / ".lock").exists()


def test_a_thread_of_the_same_process_is_kept_out_as_well(tmp_path):
    found = []

    def second():
        try:
            with only_writer(tmp_path):
                found.append("in")
        except UserError:
            found.append("out")

    for _ in range(2):
        with only_writer(tmp_path):
            thread = threading.Thread(target=second)
            thread.start()
            thread.join()
    second()
    assert found == ["out", "out", "in"] and not list(tmp_path.iterdir())


def test_who_waits_gets_a_lock_of_its_own_when_the_file_went_with_the_last_one(tmp_path):
    order, path = [], tmp_path / "lock"

    def hold(name):
        with exclusive(path, wait=True):
            with pytest.raises(BusyError), exclusive(path, wait=False):
                pass
            order.append(name)

    threads = [threading.Thread(target=hold, args=(name,)) for name in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(order) == list(range(8)) and not path.exists()


def test_a_refused_setting_leaves_no_folder(tmp_path):
    with pytest.raises(UserError, match="no box to hold"):
        train(few(**{"explore.held_starts": 0.5}), tmp_path / "new")
    assert not (tmp_path / "new").exists() and os.listdir(tmp_path) == []
