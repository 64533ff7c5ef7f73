"""The parts of Algorithm 1 as a configuration describes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from napsp.config import TrainConfig
from napsp.data.buffer import EpisodeBuffer
from napsp.data.episodes import Episodes, SparseReward
from napsp.distance.counts import CountModel
from napsp.distance.graph import ReplayGraph, explained
from napsp.distance.learned import LearnedDistance
from napsp.execution import Execution
from napsp.learner import Learner, scaling_of
from napsp.policy.agent import Agent
from napsp.policy.agents import AGENTS
from napsp.policy.descent import Descent
from napsp.policy.qrl import QRL


def build_learner(
    config: TrainConfig,
    sizes: tuple[int, int, int],
    warmup: Episodes,
    sparse_reward: SparseReward,
    rng: np.random.Generator,
    generator: torch.Generator,
    execution: Execution | None = None,
    used_actions: np.ndarray | None = None,
) -> Learner:
    """The learner before iteration 0; ``warmup`` episodes seed D, the counts and the input scaling.

    The networks draw their initial weights from torch's global generator.

    Args:
        config: all options.
        sizes: of observation, action and goal.
        warmup: random episodes.
        sparse_reward: the task's own.
        rng: draws hashes and samples.
        generator: draws the agent's noise.
        execution: device and so on.
        used_actions: which numbers of an action change anything, bool ``(A,)``; None is all.
    """
    execution = execution or Execution()
    length, size = config.episode_length, config.batch_size
    distance = LearnedDistance(sizes, config.hidden, length, size, config.distance, execution)
    agent: Agent
    obedient = config.jointly and explained(warmup) >= config.graph.control
    lasting = config.method == "plus" and not obedient and config.bootstrap.stay > 0
    if config.method == "plus":
        bootstrap = config.bootstrap if lasting else replace(config.bootstrap, stay=0.0)
        agent = Descent(sizes, config.hidden, config.policy, bootstrap, distance, config.distance.loss, execution)
    elif config.method == "qrl":
        agent = QRL(sizes, config.hidden, config.policy, config.qrl, distance, execution)
    else:
        agent = AGENTS[config.policy.agent](sizes, config.hidden, config.policy, config.lost_step, execution)
    scaling, buffer = scaling_of(warmup), EpisodeBuffer()
    for network in (*distance.networks().values(), *agent.networks().values()):
        network.scaling.set(scaling)  # type: ignore[operator, union-attr]
    # Eq. 4b alone asks for N(s, a, g); the others need not count it.
    counts = CountModel(sizes, config.counts, scaling, rng, used_actions, counts_goals=config.method == "ours")
    buffer.extend(warmup)
    counts.update(warmup)
    graph = ReplayGraph(config.graph, sparse_reward) if obedient and config.graph.every else None
    parts = (config, distance, counts, agent, buffer, sparse_reward, rng, generator)
    return Learner(*parts, len(warmup), graph, lasting, warmup)
