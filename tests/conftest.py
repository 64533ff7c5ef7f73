import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from planners.app.gl import choose_gl

choose_gl()  # before mujoco is imported anywhere

import pytest
import torch

torch.set_num_threads(1)

from napsp import envs
from napsp.envs.joint_types import mend_joint_types

mend_joint_types()  # also for stock robots that tests make themselves

TASKS = (
    "point_maze",
    "point_maze_long",
    "fetch_reach",
    "fetch_wall",
    "fetch_wall_high",
    "fetch_pick_place",
    "fetch_pick_place_wall",
    "claw",
)


@pytest.fixture(scope="session")
def worlds():
    """One unwrapped environment per task, shared by all tests that reset before use."""
    made = {name: envs.make(name).unwrapped for name in TASKS}
    yield made
    for world in made.values():
        world.close()


def pytest_collection_modifyitems(items):
    """Long tests first: of several workers none then begins one when the others are done."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
