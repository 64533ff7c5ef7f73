"""Lines 5-22 of Algorithm 1, one method each, on parts that are handed in.

The parts may be networks, as :mod:`napsp.parts` builds them, or tables: the tests run these very methods with a tabular
distance and exact counts against Floyd-Warshall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from napsp.config import TrainConfig
from napsp.data.buffer import EpisodeBuffer, sample_pairs, sample_triples
from napsp.data.episodes import Episodes, SparseReward, concatenate
from napsp.distance.graph import ReplayGraph
from napsp.distance.labels import hypotenuse, temporal_label
from napsp.policy.agent import Agent, PolicyBatch
from napsp.policy.descent import DescentBatch
from napsp.policy.her import sample_relabelled
from napsp.scaling import Scaling

Metrics = dict[str, float]


class Distance(Protocol):
    """d_theta and d_theta_old; see :class:`napsp.distance.learned.LearnedDistance`, which :mod:`napsp.run` can save."""

    def rows(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> Tensor:
        """What the other methods read, ``(B, ...)``, for (s, a, g) ``(B, O)``, ``(B, A)``, ``(B, G)``."""
        ...

    def steps(self, rows: Tensor) -> Tensor:
        """The distance that rewards the policy ``(B,)``, in steps."""
        ...

    def target_steps(self, rows: Tensor) -> Tensor:
        """d_theta_old ``(B,)``, in steps."""
        ...

    def fit(self, rows: Tensor, labels: Tensor, n_sampled: int, weight: float = 1.0) -> tuple[Tensor, Tensor]:
        """Move d_theta towards labels ``(B,)``: loss ``()``, and the steps ``(B,)`` it said before."""
        ...

    def update_target(self) -> None:
        """theta_old <- theta."""
        ...

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same distances."""
        ...


class Counts(Protocol):
    """N(s, a) and N(s, a, g); see :class:`napsp.distance.counts.CountModel`, which :mod:`napsp.run` can save."""

    def update(self, episodes: Episodes) -> None:
        """Count these episodes."""
        ...

    def recount(self, episodes: Episodes, scaling: Scaling) -> None:
        """Count all episodes again under another scaling."""
        ...

    def visits(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """N(s, a), ``(B,)``."""
        ...

    def reached(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """N(s, a, g), ``(B,)``."""
        ...


@dataclass
class Learner:
    """What Algorithm 1 keeps from iteration to iteration, and what it does with it.

    Attributes:
        config: amounts of work and options of the labels.
        distance: d_theta and d_theta_old.
        counts: N(s, a) and N(s, a, g).
        agent: the policy and what trains it.
        buffer: D.
        sparse_reward: the task's own, 0 where reached and -1 elsewhere.
        rng: draws all samples.
        generator: draws the agent's noise.
        scaled_at: episodes in D when the input scaling was estimated.
        graph: shortest paths over D, for method plus; None where cells of achieved goals do not tell states apart.
        lasting: whether only arrivals that last bound a label of method plus.
        warmup: the first episodes of D, which are kept whatever D forgets.
    """

    config: TrainConfig
    distance: Distance
    counts: Counts
    agent: Agent
    buffer: EpisodeBuffer
    sparse_reward: SparseReward
    rng: np.random.Generator
    generator: torch.Generator
    scaled_at: int = 0
    graph: ReplayGraph | None = None
    lasting: bool = False
    warmup: Episodes | None = None

    # Within a phase of Algorithm 1 everything that labels depend on is frozen (d_old and the counts for d, d for
    # the policy), so a phase draws all its samples and computes their labels at once.

    def train_temporal(self, recent: Episodes) -> Metrics:
        """Algorithm 1, lines 5-8: fit d to min[j - i, d_old + U] on pairs of D (eq. 4a).

        With ``temporal.first_arrival`` the steps to the first state at the goal stand for j - i.
        ``ddl`` fits d to j - i on its most recent episodes only, D_last included (on-policy).
        """
        config, size = self.config, self.config.batch_size
        if not config.n_temporal_updates:
            return {}
        arrival = self.sparse_reward if config.temporal.first_arrival else None
        regressed = self._regressed(recent)
        if not regressed.n_steps:  # all of them blew up at once
            return {}
        pairs = sample_pairs(regressed, config.n_temporal_updates * size, self.rng, arrival)
        rows = self.distance.rows(pairs.observations, pairs.actions, pairs.goals)
        labels = torch.from_numpy(pairs.steps_between).to(rows.device)
        if config.method != "ddl":
            bonus = config.uncertainty(self.counts.visits(pairs.observations, pairs.actions))  # eq. 2
            bonus = torch.from_numpy(bonus.astype(np.float32)).to(rows.device)
            labels = temporal_label(labels, self.distance.target_steps(rows), bonus)
        batches = zip(rows.split(size), labels.split(size), strict=True)
        losses = [self.distance.fit(*batch, n_sampled=size)[0] for batch in batches]
        return {"temporal_loss": float(torch.stack(losses).mean()), "mean_label": float(labels.mean())}

    def _regressed(self, recent: Episodes) -> Episodes:
        """The episodes that the regression on j - i sees: D, or for ddl what the policy of late has done."""
        if self.config.method != "ddl":
            return self.buffer.episodes()
        older = max(0, self.config.temporal.ddl_window - len(recent))
        return concatenate([self.buffer.episodes(older), recent]) if older else recent

    def update_target(self) -> None:
        """Algorithm 1, line 9: theta_old <- theta (or a Polyak step towards it)."""
        self.distance.update_target()

    def train_triangular(self, recent: Episodes) -> Metrics:
        """Algorithm 1, lines 10-17: raise or relax d(s_i, a_i, s_g) through waypoints (eq. 4b).

        A label that raises the distance merges, one that lowers it relaxes; the rates are
        shares of all sampled tuples (figure 5). An action after which nothing is reached any more is T from any goal
        that it did not reach, whatever the waypoint; the paper's tasks have none.
        """
        config, counts, distance = self.config, self.counts, self.distance
        if not recent.n_steps:
            return {}
        n_batches, size = config.n_triangular_updates, config.batch_size
        triples = sample_triples(recent, self.buffer.episodes(), n_batches * size, self.rng)  # 11, 12
        unconnected = counts.reached(triples.observations, triples.actions, triples.goals) == 0
        connected = counts.reached(triples.waypoints, triples.waypoint_actions, triples.goals) > 0
        passed = unconnected & (connected if config.triangular.require_reached_waypoint else True)  # 13
        passed |= unconnected & triples.lost
        start = triples.observations[passed], triples.actions[passed]
        waypoint = triples.waypoints[passed], triples.waypoint_actions[passed]
        first_leg = distance.target_steps(distance.rows(*start, triples.waypoint_goals[passed]))
        second_leg = distance.target_steps(distance.rows(*waypoint, triples.goals[passed]))
        cap = float(config.episode_length) if config.triangular.cap else None
        labels = hypotenuse(first_leg, second_leg, cap)  # 14
        if triples.lost.any():
            labels[torch.from_numpy(triples.lost[passed])] = float(config.episode_length)
        rows = distance.rows(*start, triples.goals[passed])
        n_passed = passed.reshape(n_batches, size).sum(1).tolist()
        merged = 0.0
        for part, targets in zip(rows.split(n_passed), labels.split(n_passed), strict=True):
            if len(part):  # 15, 16: nothing to do for the others
                divisor = size if config.triangular.mean == "sampled" else len(part)
                _, before = distance.fit(part, targets, divisor, config.triangular.weight)  # 17
                merged += float((targets > before).sum())
        n_sampled = max(1, n_batches * size)
        return {"merging_rate": merged / n_sampled, "relaxation_rate": (len(labels) - merged) / n_sampled}

    def train_policy(self) -> Metrics:
        """Algorithm 1, lines 18-21: HER future relabelling, reward -d / T, SAC or DDPG.

        Where nothing is reached any more, d is T: no pair of an episode could tell the network so.
        """
        config = self.config
        if not config.n_policy_updates or not self.buffer.episodes().n_steps:
            return {}
        n_sampled = config.n_policy_updates * config.batch_size
        drawn = sample_relabelled(self.buffer.episodes(), n_sampled, config.her, self.sparse_reward, self.rng)
        rewards, ended, metrics = torch.from_numpy(drawn.rewards), torch.from_numpy(drawn.ended), {}
        if config.learns_distance:  # with today's d: stored rewards would be stale
            steps = self.distance.steps(self.distance.rows(drawn.observations, drawn.actions, drawn.goals))
            rewards, metrics = -steps / config.episode_length, {"mean_distance": float(steps.mean())}
            rewards = torch.where(ended.to(rewards.device) == 1, -1.0, rewards)
        raw = (drawn.observations, drawn.actions, drawn.next_observations, drawn.goals)
        transitions = PolicyBatch(*map(torch.from_numpy, raw), rewards, ended)
        return {**metrics, **self.agent.train(transitions, config.batch_size, self.generator)}

    def search_graph(self, iteration: int) -> Metrics:
        """Now and then, search all shortest paths over D anew; beyond the paper."""
        graph = self.graph
        if graph is None:
            return {}
        if iteration % self.config.graph.every == 0:
            self.buffer.forget(self.config.replay_capacity)
            graph.build(self.buffer.episodes(), self.config.seed)
        return {"n_cells": float(graph.n_cells), "connected": graph.connected}

    def train_jointly(self) -> Metrics:
        """Distance and policy in one; beyond the paper. What is known of each transition goes into its label."""
        config = self.config
        if not config.n_policy_updates or not self.buffer.episodes().n_steps:
            return {}
        n_sampled = config.n_policy_updates * config.batch_size
        drawn = sample_relabelled(self.buffer.episodes(), n_sampled, config.her, self.sparse_reward, self.rng)
        known = np.full(n_sampled, np.nan, np.float32)
        if self.graph is not None and config.method == "plus":  # qrl has it for the sake of its explorers
            known = 1.0 + self.graph.steps(drawn.next_achieved, drawn.goals)
        observed = drawn.steps_between if config.bootstrap.bound else np.full_like(drawn.steps_between, np.inf)
        if self.lasting and not self.buffer.episodes().arriving_ends:  # where they end, no arrival has to last
            followed = np.isfinite(drawn.after).all(1)
            stayed = np.zeros(n_sampled, bool)
            stayed[followed] = self.sparse_reward(drawn.after[followed], drawn.goals[followed]) == 0
            observed = np.where(stayed, observed, np.float32(np.inf))
        raw = (drawn.observations, drawn.actions, drawn.next_observations, drawn.goals)
        seen = (drawn.rewards == 0, observed, known, drawn.next_achieved, drawn.ended)
        batch = DescentBatch(*map(torch.from_numpy, (*raw, *seen)))
        shares = {"known": float(np.isfinite(known).mean())} if config.method == "plus" else {}
        return self.agent.train(batch, config.batch_size, self.generator) | shares

    def extend_buffer(self, recent: Episodes) -> None:
        """Algorithm 1, line 22: D <- D + D_last, of which the last ``replay_capacity`` episodes stay.

        Where there is a graph, the others stay until it is built anew: it stands for all of D.
        With ``rescale`` the input scaling is estimated anew whenever D has doubled: random
        play says nothing about the spread of what only a skilled policy does, such as the
        height of a lifted box. The networks keep their functions, and D is counted again.
        """
        self.buffer.extend(recent)
        if self.graph is None:
            self.buffer.forget(self.config.replay_capacity)
        if self.config.rescale and self.buffer.n_seen >= 2 * self.scaled_at:
            self.scaled_at = self.buffer.n_seen
            scaling = scaling_of(self.buffer.episodes())
            self.distance.rescale(scaling)
            self.agent.rescale(scaling)
            self.counts.recount(self.buffer.episodes(), scaling)


def scaling_of(episodes: Episodes) -> Scaling:
    """Scaling of all inputs; achieved and desired goals together, as random play stays near the start."""
    goals = np.concatenate([episodes.states(episodes.achieved_goals), episodes.desired_goals])
    return Scaling.estimate(episodes.states(episodes.observations), goals)
