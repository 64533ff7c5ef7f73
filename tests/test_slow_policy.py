"""``policy.slow``: the slow copy of a policy is what a run evaluates and saves."""

import pytest
import torch
from tiny import tiny

import napsp.run
from napsp.execution import Execution
from napsp.run import Run
from napsp.storage.checkpoint import load_model


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize(("env", "method"), [("point_maze", "plus"), ("fetch_pick_place", "ours")])
def test_the_slow_policy_is_the_one_evaluated_and_saved(tmp_path, monkeypatch, env, method, slow):
    seen = []
    actor = napsp.run.GreedyPolicy
    monkeypatch.setattr("napsp.run.GreedyPolicy", lambda policy: seen.append(policy) or actor(policy))
    recipe = "manipulation" if method == "ours" else "paper"
    run = Run.open(tiny(env, method, recipe, **{"policy.slow": slow}), tmp_path, False, (), Execution())
    try:
        agent = run.learner.agent
        for network, value in ((agent.policy, 0.25), (agent.target_policy, 0.5)):
            torch.nn.init.constant_(list(network.parameters())[-1], value)
        run.finish_iteration(run.config.n_iterations - 1, {})
    finally:
        run.close()
    used = agent.target_policy if slow else agent.policy
    assert seen == [used]
    saved = load_model(tmp_path).policy.state_dict()
    for name, value in used.state_dict().items():
        torch.testing.assert_close(saved[name], value, rtol=0, atol=0)
