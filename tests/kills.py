"""Kill real trainings at random moments: ``python tests/kills.py 25 ours plus``, kills for each method.

Processes are forked from this one, which has imported everything: a training begins at once, and dies of SIGKILL
wherever it is, in the middle of writing a file as well. A run is begun anew whenever the last one has come to its end,
and has to equal one that nobody killed: rows, weights, optimisers, replay, counts, random states, and its model.
"""

import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
import torch
from tiny import content, tiny

from napsp.storage.files import read_tensors
from napsp.storage.progress import read_rows
from napsp.storage.record import RECORD_FILE
from napsp.storage.shipped import MODEL_FILE
from napsp.storage.state import STATE_FILE
from napsp.train import train

WORK = {"n_temporal_updates": 1, "n_triangular_updates": 1, "n_policy_updates": 1, "evaluate.n_episodes": 1}
PLUS = {"episodes_per_iteration": 4, "graph.every": 2, "graph.occupancy": 5, "evaluate.every": 4}
ALREADY = os.WEXITED | os.WNOHANG | os.WNOWAIT  # asks whether a process has ended, and leaves it to be waited for
CLOCK = ("seconds", "steps_per_second", "minutes_left")


def config_of(method):
    changes = {**WORK, "evaluate.every": 2, "n_episodes": 24} | (PLUS if method == "plus" else {})
    return tiny(method=method, **changes)


def begin(config, folder):
    """Train in a process of its own; its id."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            with open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), 1)
            train(config, folder)
            status = 0
        finally:
            os._exit(status)
    return child


def outcome(folder):
    """All that a finished run leaves, the clock apart."""
    rows = [{k: v for k, v in row.items() if k not in CLOCK} for row in read_rows(folder / "metrics.csv", np.inf)]
    model, header = read_tensors(folder / MODEL_FILE, "model")
    networks = {f"model.{name}": tensor.numpy() for name, tensor in model.items()}
    return {"rows": str(rows), "header": str(header)} | networks | content(folder)


def differences(one, other):
    """Names of what is not the same to the bit."""
    if one.keys() != other.keys():
        return sorted(one.keys() ^ other.keys())
    return [name for name in one if _bytes(one[name]) != _bytes(other[name])]


def _bytes(value):
    return value if isinstance(value, str) else (value.shape, value.dtype, value.tobytes())


def campaign(method, n_kills, seed=0):
    """Kill and resume; returns (kills, resumes from a state, finished runs, what differed)."""
    config, rng, place = config_of(method), np.random.default_rng(seed), Path(tempfile.mkdtemp())
    began = time.monotonic()
    assert os.waitpid(begin(config, place / "whole"), 0)[1] == 0
    length, expected = time.monotonic() - began, outcome(place / "whole")
    kills, resumes, finished, wrong, folder = 0, 0, 0, [], place / "killed"
    while kills < n_kills or folder.exists():
        resumes += (folder / STATE_FILE).is_file()
        child, status = begin(config, folder), None
        if kills < n_kills:
            end = time.monotonic() + rng.uniform(0.1, 0.9) * length
            while time.monotonic() < end and os.waitid(os.P_PID, child, ALREADY) is None:
                time.sleep(0.002)
            os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
        kills += os.WIFSIGNALED(status)
        if not os.WIFSIGNALED(status) and status:
            wrong.append(f"a training ended with {status}")
            break
        if (folder / RECORD_FILE).is_file():
            finished += 1
            wrong += differences(outcome(folder), expected)
            shutil.rmtree(folder)
    shutil.rmtree(place)
    return kills, resumes, finished, wrong


if __name__ == "__main__":
    torch.set_num_threads(1)
    failed = False
    for name in sys.argv[2:]:
        kills, resumes, finished, wrong = campaign(name, int(sys.argv[1]))
        print(f"{name}: {kills} kills, {resumes} resumes from a state, {finished} runs finished, differences: {wrong}",
              flush=True)  # fmt: skip
        failed |= bool(wrong)
    sys.exit(failed)
