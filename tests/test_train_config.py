"""The options of training: defaults by task, old names, bad values, and what makes two runs the same question."""

import dataclasses

import pytest
from tiny import tiny

from napsp.config import TrainConfig, from_dict, preset, to_dict
from napsp.envs.cards import CARDS
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.renamed import TRAINING
from napsp.settings import changed, flat
from napsp.train import parse


def test_command_line_defaults_follow_the_task():
    config, options, execution = parse(["--env", "point_maze_long", "--seed", "7", "--method", "ddl"])
    assert config == preset("point_maze_long", "ddl", seed=7) and options.out is None and execution == Execution()
    assert parse([])[0] == preset("fetch_wall")
    assert parse(["--env=fetch_reach_wall"])[0].env == "fetch_wall"
    assert parse(["--episodes", "77"])[0].n_episodes == parse(["--n-episodes", "77"])[0].n_episodes == 77
    config = parse(["--env", "fetch_wall", "--counts.goal-cell", "0.5", "--distance.slow", "--hidden", "8", "9"])[0]
    assert config == preset("fetch_wall", changes={"counts.goal_cell": 0.5, "distance.slow": True}, hidden=(8, 9))


def test_ours_is_the_paper_on_every_task_and_a_recipe_is_named():
    for env in CARDS:
        config = preset(env)
        beyond = (config.distance.slow, config.temporal.first_arrival, config.policy.clipped_double_q)
        assert config.recipe == "paper" and not any(beyond) and config.her.other_goals_ratio == 0.0
        assert config.distance.target_polyak == 1.0 and config.explore.held_starts == 0.0
    for method, discount in (("ours", 0.9), ("sparse", 0.98)):
        config = parse(["--env", "fetch_pick_place", "--recipe", "manipulation", f"--method={method}"])[0]
        assert config == preset("fetch_pick_place", method, "manipulation") and config.policy.discount == discount
        assert config.explore.held_starts == 0.5 and config.distance.slow
    with pytest.raises(UserError, match="no recipe 'manipulation' for point_maze; choose one of: paper"):
        preset("point_maze", recipe="manipulation")


def test_old_flags_get_a_sentence_with_the_new_name(capsys):
    for old, new in (
        ("visit-bits", "counts.visit-bits"),
        ("first-arrival", "temporal.first-arrival"),
        ("reached-bits", "counts.pair-bits"),
    ):
        with pytest.raises(UserError, match=f"--{old} is now called --{new}"):
            parse(["--env", "point_maze", f"--{old}"])
    with pytest.raises(UserError, match=r"--no-cap-triangular is now called --triangular\.no-cap$"):
        parse(["--no-cap-triangular"])
    with pytest.raises(UserError, match=r"--epsilon is now called --explore\.epsilon, and is the share of"):
        parse(["--epsilon", "0.1"])
    with pytest.raises(UserError, match=r"--evaluate-every is now called --evaluate\.every"):
        parse(["--evaluate_every=5"])
    for new in TRAINING.values():
        assert new in flat(to_dict(preset("point_maze"))), f"{new} exists"


def test_bad_settings_name_the_fix():
    for changes, words in (
        ({"method": "magic"}, "choose one of: sparse, ddl, offpolicy_ddl, ours"),
        ({"distance.head": "mlq"}, "unknown head 'mlq'; did you mean mlp. choose one of: mlp, quasimetric"),
        ({"policy.agent": "td3"}, "unknown agent 'td3'; choose one of: sac, ddpg"),
        ({"policy.slow": True}, "SAC and qrl keep no slow policy"),
        ({"distance.loss": "cubic"}, "unknown loss 'cubic'; choose one of: squared"),
        ({"batch_size": 0}, "batch_size is 0; it must lie between 1"),
        ({"uncertainty.scale": 0.0}, "scale is 0.0"),
        ({"counts.visit_bits": 99}, "visit_bits is 99; it must lie between 1 and 62"),
        ({"seed": -1}, "seed is -1"),
        ({"policy.discount": 1.0}, "discount is 1.0"),
        ({"explore.epsilon": float("nan")}, "epsilon is nan"),
        ({"her.relabel_ratio": 0.8, "her.other_goals_ratio": 0.3}, "exceed 1 together"),
        ({"hidden": ()}, "at least one width"),
        ({"n_episodes": 4}, "must exceed the 4 warm-up episodes"),
        ({"counts.colour": 1}, "there is no option 'colour' in CountConfig"),
        ({"colour": 1}, "there is no option 'colour' in TrainConfig"),
    ):
        with pytest.raises(UserError, match=words):
            tiny(**changes)
    with pytest.raises(UserError, match="does not fit this version"):
        from_dict({**to_dict(tiny()), "colour": 1})


def numbers(config, prefix=""):
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from numbers(value, f"{field.name}.")
        elif "int" in str(field.type).replace("tuple[int, ...]", "") or "float" in str(field.type):
            yield prefix + field.name


def test_every_number_has_a_range():
    for name in numbers(TrainConfig()):
        for value in (-1, float("nan")):
            with pytest.raises(UserError, match=f"{name.rpartition('.')[2]} is {value}"):
                changed(TrainConfig(), {name: value})


def test_the_identity_is_the_difference_from_the_defaults():
    assert preset("fetch_wall").identity() == {"env": "fetch_wall", "method": "ours"}
    changes = {"counts.goal_cell": 0.5, "hidden": (8, 8)}
    assert preset("fetch_wall", seed=3, changes=changes).identity() == {
        "env": "fetch_wall", "method": "ours", "counts.goal_cell": 0.5, "hidden": [8, 8],
    }  # fmt: skip
    fixed = [tiny(**{"policy.entropy_weight": weight}).digest() for weight in (1, 1.0, 2)]
    assert fixed[0] == fixed[1] != fixed[2]
    assert tiny(seed=1).digest() == tiny(seed=2).digest() != tiny(**{"policy.discount": 0.9}).digest()
    assert from_dict(to_dict(tiny())) == tiny()
    for method, asks in (("ours", True), ("offpolicy_ddl", False), ("sparse", False)):
        finer = preset("fetch_wall", method, changes={"counts.goal_cell": 0.5})
        assert (finer.identity() != preset("fetch_wall", method).identity()) is asks, "eq. 4b alone asks for N(s, a, g)"
