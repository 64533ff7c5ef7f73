"""The page on environments of others: its code runs, and says when a car is parked as the environment itself does."""

import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from tiny import TINY

from napsp.settings import as_flags

PAGE = (Path(__file__).parents[1] / "docs" / "other_environments.md").read_text()
CODE, COMMANDS = (re.search(rf"```{kind}\n(.*?)```", PAGE, re.S).group(1) for kind in ("python", "bash"))


@pytest.fixture
def parking(tmp_path, monkeypatch):
    (tmp_path / "parking.py").write_text(CODE)
    monkeypatch.syspath_prepend(tmp_path)
    import parking

    yield parking
    del sys.modules["parking"]
    gymnasium.registry.pop("parking-100-v0")


def test_a_car_is_parked_when_its_environment_says_so(parking):
    env = gymnasium.make("parking-100-v0", disable_env_checker=True)
    goals = [env.reset(seed=seed)[0]["desired_goal"] for seed in range(4)]
    rng, world = np.random.default_rng(0), env.unwrapped
    desired = np.repeat(goals, 200, axis=0)
    achieved = desired + rng.normal(size=desired.shape) * [0.02, 0.02, 0.1, 0.1, 0.1, 0.1]
    own = [world._is_success(a, d) for a, d in zip(achieved, desired, strict=True)]
    assert 0.1 < np.mean(own) < 0.9
    np.testing.assert_array_equal(parking.parked(achieved, desired), own)
    env.close()


@pytest.mark.slow
def test_the_commands_of_the_page_train_and_evaluate(tmp_path):
    (tmp_path / "parking.py").write_text(CODE)
    _, training, evaluation = (line.split() for line in COMMANDS.splitlines())
    short = as_flags({**TINY, "n_episodes": 8}).split()
    for words in ([*training[1:], *short], [*evaluation[1:], "--episodes", "1"]):
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert "policy on parking:parking-100-v0" in done.stdout
