"""The structure holds: files import in no circle, layers one way, a new task is a card and a file."""

import ast
import graphlib
import re
import statistics
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from napsp import envs
from napsp.config import preset
from napsp.envs.cards import CARDS, Card, Planning

ROOT = Path(__file__).parents[1]
LAYERS = ("napsp", "mpc", "planners", "benchmarks")
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for layer in LAYERS
    for path in (ROOT / layer).rglob("*.py")
}


def imports_of(path):
    """Modules that a file imports, in functions as well; not at a command's own start, nor for type checkers alone."""
    found, tree = set(), ast.parse(path.read_text())
    apart = re.compile("__main__|TYPE_CHECKING")
    tree.body = [node for node in tree.body if not (isinstance(node, ast.If) and apart.search(ast.unparse(node.test)))]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


GRAPH = {name: {other for other in imports_of(path) if other in FILES} - {name} for name, path in FILES.items()}


def test_no_two_files_import_each_other_however_indirectly():
    # A package's __init__ is named by every import from it; what counts is what it imports itself.
    graphlib.TopologicalSorter(GRAPH).prepare()  # raises CycleError


def test_imports_run_one_way():
    """napsp.envs -> napsp -> mpc -> planners -> benchmarks; casadi for the smoothing layer, no torch for tasks."""
    for name, path in FILES.items():
        parts, imported = name.split("."), {other.split(".")[0] for other in imports_of(path)}
        above = LAYERS[LAYERS.index(parts[0]) + 1 :]
        assert not imported & set(above), f"{path} imports {imported & set(above)}"
        assert "casadi" not in imported or "smoothing" in parts, f"{path} imports casadi"
        if parts[:2] == ["napsp", "envs"]:
            ours = {other for other in GRAPH[name] if other.startswith("napsp.")}
            assert all(other.startswith(("napsp.envs", "napsp.errors", "napsp.opengl")) for other in ours), (
                f"{path} imports {ours}"
            )
            assert "torch" not in imported, f"{path} imports torch"


def test_files_are_short():
    lengths = {name: len(path.read_text().splitlines()) for name, path in FILES.items()}
    assert not {name: n for name, n in lengths.items() if n > 300}
    assert statistics.median(lengths.values()) <= 110


@pytest.fixture
def corridor(monkeypatch):
    """A new task: one card, and a class with its physics in a file (here the maze's, half as large)."""
    card = Card("napsp/Corridor-v0", "napsp.envs.point_maze:PointMazeEnv", 25, {"scale": 0.5}, aliases=("hall",),
                n_effector=2, training={"explore.epsilon": 0.5}, planning=Planning(horizon=3))  # fmt: skip
    monkeypatch.setitem(CARDS, "corridor", card)
    monkeypatch.setattr(envs, "NAMES", {**envs.NAMES, "hall": "corridor", card.gym_id: "corridor"})
    envs.register_all()
    yield card
    gymnasium.registry.pop(card.gym_id)


def test_a_new_task_is_one_card_and_one_file(corridor):
    env = envs.make("hall")
    assert envs.canonical_name("napsp/Corridor-v0") == "corridor" and envs.episode_length("corridor") == 25
    observation, _ = env.reset(seed=0)
    for _ in range(25):
        observation, *_, truncated, _ = env.step(np.zeros(2, np.float32))
    assert truncated and observation["observation"].shape == (4,)
    config = preset("corridor")
    assert config.explore.epsilon == 0.5 and config.episode_length == 25
