"""The exported distance: exact values, gradients and Hessians, in numpy and in CasADi."""

import copy

import casadi
import numpy as np
import pytest
import torch
from torch.func import jacrev, vmap

from mpc.smoothing.distance import SmoothDistance
from napsp.config import preset
from napsp.distance.network import DistanceConfig, DistanceNetwork
from napsp.policy.actors import GaussianPolicy
from napsp.storage.checkpoint import Model, load_model
from napsp.storage.shipped import shipped_model

SHIPPED = ("point_maze", "fetch_reach", "fetch_wall", "claw", "fetch_pick_place", "fetch_pick_place_wall")


def shipped(env):
    return load_model(shipped_model(env), env)


def random_model(output="softplus", sizes=(3, 2, 2), **options):
    torch.manual_seed(1)
    distance = DistanceNetwork(sizes, (16, 16), 50, DistanceConfig(output=output, **options))
    policy = GaussianPolicy(sizes, (16, 16))
    for network in (distance, policy):
        network.scaling.observation_mean += 0.3
        network.scaling.goal_scale *= 2.0
        network.requires_grad_(False)
    return Model(distance, policy, preset("point_maze"), {})


def torch_distance(model, action_of):
    """The same function of x in torch, float64."""
    distance, policy = copy.deepcopy(model.distance).double(), copy.deepcopy(model.policy).double()
    n_s, n_g = len(distance.scaling.observation_mean), len(distance.scaling.goal_mean)

    def function(x):
        s, g = x[None, :n_s], x[None, -n_g:]
        return distance(s, x[None, n_s:-n_g] if action_of == "plan" else policy.mode(s, g), g)[0]

    return function


def random_inputs(model, action_of, n, rng, spread=2.0):
    scaling, n_actions = model.distance.scaling.numbers(), model.policy.n_actions
    s = scaling.observation_mean + scaling.observation_scale * spread * rng.normal(size=(n, 1)) * rng.normal(
        size=(n, len(scaling.observation_mean))
    )
    g = scaling.goal_mean + scaling.goal_scale * spread * rng.normal(size=(n, len(scaling.goal_mean)))
    actions = [rng.uniform(-1, 1, (n, n_actions))] if action_of == "plan" else []
    return np.concatenate([s, *actions, g], axis=1)


def relative_error(found, expected):
    """Largest error of any row, relative to that row's largest number."""
    rows = np.abs(expected).reshape(len(expected), -1).max(1)
    return (np.abs(found - expected).reshape(len(expected), -1).max(1) / rows).max()


@pytest.mark.parametrize("env", SHIPPED)
@pytest.mark.parametrize("action_of", ["policy", "plan"])
def test_export_equals_torch_on_shipped_checkpoints(env, action_of):
    model = shipped(env)
    rows = random_inputs(model, action_of, 1000, np.random.default_rng(0))
    function, inputs = torch_distance(model, action_of), torch.from_numpy(rows)
    smooth = SmoothDistance(model, action_of)
    value, gradient, hessian = smooth.evaluate(rows)
    assert relative_error(value, vmap(function)(inputs).numpy()) < 1e-10
    assert relative_error(gradient, vmap(jacrev(function))(inputs).numpy()) < 1e-10
    assert relative_error(hessian[:30], vmap(jacrev(jacrev(function)))(inputs[:30]).numpy()) < 1e-10
    np.testing.assert_allclose(smooth.values(rows), value, rtol=1e-12)
    # The CasADi function computes the same, derivatives included.
    x = casadi.MX.sym("x", smooth.n_inputs)
    exported = casadi.Function("all", [x], [smooth.function()(x), *casadi.hessian(smooth.function()(x), x)[::-1]])
    found = [[np.array(part) for part in exported(row)] for row in rows[:30]]
    for k, expected in enumerate((value[:30], gradient[:30], hessian[:30])):
        assert relative_error(np.stack([row[k] for row in found]).reshape(expected.shape), expected) < 1e-10
    # Within [0, T] it is the distance the planner's cost uses, in float32 there.
    n_s, n_g = smooth.n_observation, smooth.n_goal
    parts = [torch.from_numpy(part).float() for part in (rows[:, :n_s], rows[:, n_s:-n_g], rows[:, -n_g:])]
    action = parts[1] if action_of == "plan" else model.policy.mode(parts[0], parts[2])
    steps = model.distance.steps(parts[0], action, parts[2]).numpy()
    np.testing.assert_allclose(np.clip(value, 0.0, smooth.episode_length), steps, rtol=1e-3, atol=2e-3)


@pytest.mark.parametrize("action_of", ["policy", "plan"])
@pytest.mark.parametrize("output", ["softplus", "linear"])
def test_export_of_several_networks_in_steps_is_their_mean(output, action_of):
    model = random_model(output, n_members=3, unit="step")
    smooth = SmoothDistance(model, action_of)
    rows = random_inputs(random_model(), action_of, 30, np.random.default_rng(0))
    function, inputs = torch_distance(model, action_of), torch.from_numpy(rows)
    value, gradient, hessian = smooth.evaluate(rows)
    assert relative_error(value, vmap(function)(inputs).numpy()) < 1e-10
    assert relative_error(gradient, vmap(jacrev(function))(inputs).numpy()) < 1e-10
    assert relative_error(hessian, vmap(jacrev(jacrev(function)))(inputs).numpy()) < 1e-10
    np.testing.assert_allclose(smooth.values(rows), value, rtol=1e-12)
    x = casadi.MX.sym("x", smooth.n_inputs)
    exported = casadi.Function("all", [x], [smooth.function()(x), *casadi.hessian(smooth.function()(x), x)[::-1]])
    for k, expected in enumerate((value, gradient, hessian)):
        found = np.stack([np.array(exported(row)[k]) for row in rows]).reshape(expected.shape)
        assert relative_error(found, expected) < 1e-10


@pytest.mark.parametrize("output", ["softplus", "linear"])
@pytest.mark.parametrize("action_of", ["policy", "plan"])
def test_export_against_finite_differences(output, action_of):
    model = random_model(output)
    smooth = SmoothDistance(model, action_of)
    rows = random_inputs(model, action_of, 20, np.random.default_rng(1), spread=1.0)
    _, gradient, hessian = smooth.evaluate(rows)
    step = 1e-5
    for k in range(smooth.n_inputs):
        shift = step * np.eye(smooth.n_inputs)[k]
        up, down = smooth.evaluate(rows + shift), smooth.evaluate(rows - shift)
        np.testing.assert_allclose(gradient[:, k], (up[0] - down[0]) / (2 * step), atol=1e-6)
        np.testing.assert_allclose(hessian[:, k], (up[1] - down[1]) / (2 * step), atol=1e-6)


def test_beyond_the_networks_input_limit_d_is_flat():
    model = random_model()
    smooth = SmoothDistance(model, "policy")
    rows = np.full((1, smooth.n_inputs), 1e3)
    value, gradient, hessian = smooth.evaluate(rows)
    assert value == smooth.evaluate(rows + 1.0)[0]
    np.testing.assert_array_equal(gradient, 0.0)
    np.testing.assert_array_equal(hessian, 0.0)


@pytest.mark.parametrize("options", [{"head": "quasimetric"}, {"layer_norm": True, "n_members": 2}])
def test_a_distance_of_another_kind_is_refused_in_words(options):
    with pytest.raises(ValueError, match="more than plain networks"):
        SmoothDistance(random_model(**options), "policy")
