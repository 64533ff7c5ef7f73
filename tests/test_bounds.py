"""Bounds of every number in the training configuration, and what is not a number."""

import pytest

from napsp.config import DEFAULT
from napsp.errors import UserError
from napsp.settings import changed

MANY, TINY = 10**9, 1e-12
BOUNDS = {
    "seed": (0, 2**31 - 1),
    **dict.fromkeys(("batch_size", "temporal.ddl_window"), (1, MANY)),
    **dict.fromkeys(("n_temporal_updates", "n_triangular_updates", "n_policy_updates"), (0, MANY)),
    **dict.fromkeys(("explore.hold", "evaluate.every", "evaluate.n_episodes"), (1, MANY)),
    **dict.fromkeys(("distance.learning_rate", "policy.learning_rate", "policy.polyak"), (TINY, 1)),
    **dict.fromkeys(("distance.target_polyak",), (TINY, 1)),
    **dict.fromkeys(("explore.epsilon", "explore.held_starts", "her.other_goals_ratio"), (0, 1)),
    "her.relabel_ratio": (0, 1),
    "distance.n_members": (1, 100),
    "uncertainty.scale": (TINY, MANY),
    "uncertainty.power": (TINY, 100),
    "triangular.weight": (0, MANY),
    "policy.discount": (0, 1 - 1e-6),
    "policy.entropy_weight": (TINY, MANY),
    "policy.min_entropy_weight": (TINY, MANY),
    "policy.action_noise": (0, 100),
    "policy.action_penalty": (0, MANY),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_numbers_lie_within_inclusive_bounds(name):
    low, high = BOUNDS[name]
    usual = {"her.relabel_ratio": 0.0, "n_episodes": MANY}
    for value in (low, high):
        changed(DEFAULT, {**usual, name: value})
    for value in (low - 1, high + 1, float("nan")):
        with pytest.raises(UserError, match=rf"{name.rpartition('.')[2]} is {value}"):
            changed(DEFAULT, {**usual, name: value})


@pytest.mark.parametrize(
    "name", ["triangular.mean", "distance.output", "distance.head", "distance.loss", "policy.agent"]
)
def test_words_are_among_those_that_mean_something(name):
    with pytest.raises(UserError, match=f"unknown {name.rpartition('.')[2]} 'neither'; choose one of: "):
        changed(DEFAULT, {name: "neither"})


def test_a_fixed_alpha_may_be_left_open():
    assert changed(DEFAULT, {"policy.entropy_weight": None}).policy.entropy_weight is None
