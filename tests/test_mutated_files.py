"""Damaged, forged and foreign files are one sentence: no other error, hang or memory. ``NAPSP_MUTATIONS=10000``."""

import json
import os
import resource
import signal
import tracemalloc
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mutations import mutated
from test_saving import few

from benchmarks import cells
from napsp.envs.goal_task import make_goal_task
from napsp.errors import UserError
from napsp.run import new_learner
from napsp.storage.checkpoint import load_model
from napsp.storage.progress import read_rows
from napsp.storage.resume import read_training, restore_training, stored_episodes, stored_tables, warmup_episodes
from napsp.storage.segments import FOLDER
from napsp.storage.shipped import MODEL_FILE
from napsp.storage.state import STATE_FILE
from napsp.train import train
from planners.app.folder import OWNER, SUMMARY, claim

N, SEED = (int(os.environ.get(name, usual)) for name, usual in (("NAPSP_MUTATIONS", "200"), ("NAPSP_SEED", "0")))
TRACED = 5  # in every fifth trial Python's own memory is traced, which takes longer than reading
FLOOR = 2**21  # bytes that reading the sound file takes as well: networks, parsed text
ROOM = 2**29  # bytes of address space that all of it may take beyond what the process has


class Subjects:
    """A small finished run, result rows and an output folder; and what reads each of their files."""

    def __init__(self, place):
        self.run, self.rows, self.plans = place / "run", place / "rows.csv", place / "plans"
        train(few(), self.run)
        self.config = few()
        self.envs = [make_goal_task(self.config.env, None) for _ in range(2)]
        self.learner = new_learner(self.config, self.envs)
        cells.RUNS, cells.ROWS = place / "runs", place / "published"
        key = {"env": "point_maze", "seed": 0, "training": cells.as_text(self.config.identity()), "success": 0.5}
        cells.replace_results(self.rows, ("env",), [key, {**key, "env": "claw"}])
        cells.publish(self.run)
        self.described = {"env": "point_maze", "planner": "mppi", "cost": "sparse", "seed": 0, "differences": {"a": 2},
                          "config": {"distance": {"ensemble": []}}, "run": {"checkpoint": None}}  # fmt: skip
        claim(self.plans, self.described)
        (self.plans / SUMMARY).write_text(json.dumps(self.described))
        segments = sorted((self.run / FOLDER).iterdir())
        self.readers = {
            self.run / MODEL_FILE: (lambda: load_model(self.run, "point_maze"), 6),
            self.run / STATE_FILE: (self.resume, 5),
            segments[0]: (lambda: stored_tables(self.run), 2),
            segments[-1]: (lambda: stored_episodes(self.run), 2),
            self.run / "training.json": (lambda: cells.training_beside(self.run, "point_maze"), 2),
            self.run / "metrics.csv": (lambda: read_rows(self.run / "metrics.csv", 16), 2),
            self.rows: (self.read_rows, 2),
            next(cells.ROWS.iterdir()): (lambda: cells.learning_curves("point_maze"), 2),
            self.plans / OWNER: (lambda: claim(self.plans, self.described), 1),
            self.plans / SUMMARY: (self.inherit, 1),
        }

    def resume(self):
        stored = read_training(self.run / STATE_FILE, self.config)
        warmup_episodes(self.run, stored, self.config)
        restore_training(self.run, self.learner, stored)

    def read_rows(self):
        for row in cells.read_results(self.rows):
            if "training" in row:
                cells.training_of(row)

    def inherit(self):
        (self.plans / OWNER).unlink(missing_ok=True)
        claim(self.plans, self.described)


@pytest.fixture
def subjects(tmp_path, monkeypatch):
    for name in ("RUNS", "ROWS"):
        monkeypatch.setattr(cells, name, getattr(cells, name))  # put back afterwards
    found = Subjects(tmp_path)
    yield found
    for env in found.envs:
        env.close()


@contextmanager
def bounded():
    """Endless reading and large memory become errors."""

    def hangs(signum, frame):
        raise TimeoutError("reading hangs")

    before, limit = signal.signal(signal.SIGALRM, hangs), resource.getrlimit(resource.RLIMIT_AS)
    statm = Path("/proc/self/statm")
    if statm.is_file():
        taken = int(statm.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, limit[1]))
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, limit)


def outcome(reader, size, traced):
    """Whether a file of so many bytes was read, refused, or else what went wrong."""
    if traced:
        tracemalloc.start()
    result = "read"
    signal.alarm(30)
    try:
        reader()
    except UserError as error:
        result = "refused" if "\n" not in str(error).strip() else f"{error} is more than a line"
    except Exception as error:
        result = f"{type(error).__name__}: {error}"
    signal.alarm(0)
    peak = tracemalloc.get_traced_memory()[1]  # 0 where it is not
    tracemalloc.stop()
    return result if peak <= max(2 * size, FLOOR) else f"{peak} bytes for a file of {size}"


@pytest.mark.skipif(os.name != "posix", reason="alarms and limits of the system")
def test_every_damaged_file_is_read_or_refused_in_a_sentence(subjects, tmp_path):
    rng, found, faults, readers = np.random.default_rng(SEED), Counter(), Counter(), subjects.readers
    kept, owner = {path: path.read_bytes() for path in readers}, subjects.plans / OWNER
    drawn = [path for path, (_, weight) in readers.items() for _ in range(weight)]
    for reader, _ in readers.values():
        reader()  # sound ones are read, and what is made once is made
    with bounded():
        for trial in range(N):
            path = drawn[rng.integers(len(drawn))]
            owner.write_bytes(kept[owner])
            path.write_bytes(kept[path])
            data, kind = mutated(path, kept[path], rng)
            path.write_bytes(data)
            result = outcome(readers[path][0], len(data), trial % TRACED == 0)
            path.write_bytes(kept[path])
            name = path.name.partition("-")[0]
            if result in ("read", "refused"):
                found[name, result] += 1
            else:
                faults[name, kind, result] += 1
                print(name, kind, result, flush=True)
    print(dict(sorted(found.items())))
    assert not faults
    assert sum(n for (_, result), n in found.items() if result == "refused") > N / 2, "most of them cannot be read"
    assert {path.name for path in tmp_path.iterdir()} <= {"run", "runs", "rows.csv", "plans", "published"}, "outside"
