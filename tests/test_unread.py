"""An option that a run does not read is told of, and one of the wrong kind refused."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from tiny import tiny

from napsp.config import METHODS, from_dict, preset, to_dict
from napsp.errors import UserError
from napsp.settings import changed
from napsp.unread import tell_of_unread


@pytest.mark.parametrize(
    ("method", "changes", "named"),
    [
        ("ours", {"explore.explorers": 0.5, "graph.every": 5}, "--explore.explorers 0.5"),
        ("plus", {"policy.discount": 0.9}, "--policy.discount 0.9"),
        ("plus", {"temporal.first_arrival": True}, "--temporal.first-arrival"),
        ("qrl", {"bootstrap.bound": False}, "--bootstrap.no-bound"),
        ("sparse", {"distance.learning_rate": 0.01}, "--distance.learning-rate 0.01"),
        ("ddl", {"triangular.cap": False}, "--triangular.no-cap"),
        ("sparse", {"uncertainty.scale": 3.0}, "--uncertainty.scale 3.0"),
        ("ours", {"policy.action_noise": 0.5}, "--policy.action-noise 0.5"),
        ("ours", {"policy.agent": "ddpg", "policy.entropy_weight": 0.1}, "--policy.entropy-weight 0.1"),
        ("ours", {"distance.head": "quasimetric", "distance.output": "softplus"}, "--distance.output softplus"),
    ],
)
def test_what_nobody_reads_is_named(method, changes, named):
    with pytest.warns(UserWarning, match="does not read") as told:
        tell_of_unread(preset("point_maze", method, changes=changes))
    assert named in str(told[0].message)


@pytest.mark.parametrize("method", METHODS)
def test_what_a_task_and_its_recipe_set_is_fine(method):
    for env, recipe in (("point_maze", "paper"), ("fetch_pick_place", "manipulation"), ("claw", "paper")):
        tell_of_unread(preset(env, method, recipe, {"batch_size": 7, "policy.learning_rate": 0.01}))
    tell_of_unread(preset("fetch_pick_place", "ours", "manipulation", {"policy.action_noise": 0.5}))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("rescale", "no", "rescale is 'no'; it must be of kind bool"),
        ("distance.slow", "false", "slow is 'false'"),
        ("batch_size", 64.5, "batch_size is 64.5; it must be of kind int"),
        ("batch_size", True, "batch_size is True"),
        ("hidden", [8, "a"], "hidden is"),
        ("graph", None, "it must be of kind GraphConfig"),
        ("bootstrap.pessimism", "larg", "did you mean largest"),
    ],
)
def test_values_of_another_kind_are_refused(name, value, words):
    with pytest.raises(UserError, match=words):
        changed(tiny(), {name: value})
    stored = to_dict(tiny())
    head, _, rest = name.partition(".")
    stored[head] = {**stored[head], rest: value} if rest else value
    with pytest.raises(UserError, match=words):
        from_dict(stored)


def test_a_distance_that_is_planned_with_reads_its_uncertainty():
    for method in ("ours", "plus", "ddl"):
        tell_of_unread(preset("point_maze", method, changes={"uncertainty.scale": 3.0}))  # warnings are errors


def test_annotations_of_the_users_own_are_no_obstacle():
    changes = {"weights": [1.0], "pair": ["a", 2], "numbers": [np.int64(3)], "anything": "x", "sizes": {"a": 1}}
    assert changed(Odd(), changes) == Odd([1.0], ("a", 2), (3,), "x", {"a": 1})
    with pytest.raises(UserError, match="pair is"):
        changed(Odd(), {"pair": (1, 2, 3)})
    assert changed(Unresolved(), {"samples": 3}).samples == 3


@dataclass(frozen=True)
class Odd:
    weights: list[float] = field(default_factory=list)
    pair: tuple[str, int] = ("", 0)
    numbers: tuple[int, ...] = ()
    anything: Any = None
    sizes: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Unresolved:
    samples: "Sequence" = 2  # noqa: F821


def test_numbers_of_numpy_and_whole_floats_are_numbers():
    config = changed(tiny(), {"batch_size": 64.0, "n_policy_updates": np.int64(5), "hidden": [4, 3]})
    assert (config.batch_size, config.n_policy_updates, config.hidden) == (64, 5, (4, 3))
    assert all(type(number) is int for number in (config.batch_size, config.n_policy_updates))
