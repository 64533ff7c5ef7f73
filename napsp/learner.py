"""The learned things of Algorithm 1 and one method per line that trains them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from napsp.backprop import Adam
from napsp.config import TrainConfig
from napsp.data.buffer import EpisodeBuffer, sample_pairs, sample_triples
from napsp.data.episodes import Episodes, SparseReward, concatenate
from napsp.distance.counts import CountModel, uncertainty
from napsp.distance.labels import hypotenuse, temporal_label
from napsp.distance.regression import DistanceRegression
from napsp.networks import rescale
from napsp.policy.agent import Agent, PolicyBatch
from napsp.policy.ddpg import DDPG
from napsp.policy.her import sample_relabelled
from napsp.policy.sac import SAC
from napsp.scaling import Scaling

AGENTS: dict[str, type[SAC] | type[DDPG]] = {"sac": SAC, "ddpg": DDPG}
Metrics = dict[str, float]


class Learner:
    """d_theta, d_theta_old, the counts, the policy's learner and D."""

    def __init__(
        self,
        config: TrainConfig,
        sizes: tuple[int, int, int],
        warmup: Episodes,
        sparse_reward: SparseReward,
        rng: np.random.Generator,
        generator: torch.Generator,
    ) -> None:
        """Build everything; ``warmup`` episodes seed D, the counts and the input scaling.

        The networks draw their initial weights from torch's global generator.
        """
        self.config, self.rng, self.generator = config, rng, generator
        self._sparse_reward = sparse_reward
        self.regression = DistanceRegression(sizes, config)
        self.agent: Agent = AGENTS[config.agent](sizes, config)
        scaling = _scaling(warmup)
        for network in self.networks().values():
            network.scaling.set(scaling)  # type: ignore[operator, union-attr]
        self.counts = CountModel(sizes, config.visit_bits, config.reached_bits, scaling, rng)
        self.buffer = EpisodeBuffer()
        self.buffer.extend(warmup)
        self.counts.update(warmup)
        self.scaled_at = len(warmup)

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        regression = self.regression
        distances = {"distance": regression.distance, "target_distance": regression.target_distance}
        return {**distances, **self.agent.networks()}

    def optimizers(self) -> dict[str, Adam]:
        """All optimisers by name."""
        return {"distance_optimizer": self.regression.optimizer, **self.agent.optimizers}

    def extend_buffer(self, recent: Episodes) -> None:
        """Algorithm 1, line 22: D <- D + D_last.

        With ``rescale`` the input scaling is estimated anew whenever D has doubled: random
        play says nothing about the spread of what only a skilled policy does, such as the
        height of a lifted box. The networks keep their functions, and D is counted again.
        """
        self.buffer.extend(recent)
        if self.config.rescale and len(self.buffer) >= 2 * self.scaled_at:
            self.scaled_at = len(self.buffer)
            scaling = _scaling(self.buffer.episodes())
            for network in self.networks().values():
                rescale(network, scaling)
            self.counts.recount(self.buffer.episodes(), scaling)

    # Within a phase of Algorithm 1 everything that labels depend on is frozen (d_old and the counts for d, d for
    # the policy), so a phase draws all its samples and computes their labels at once.

    def train_temporal(self, recent: Episodes) -> Metrics:
        """Algorithm 1, lines 5-8: fit d to min[j - i, d_old + U] on pairs of D (eq. 4a).

        With ``first_arrival`` the steps to the first state at the goal stand for j - i.
        ``ddl`` fits d to j - i on its most recent episodes only, D_last included (on-policy).
        """
        config, episodes, size = self.config, self.buffer.episodes(), self.config.batch_size
        if not config.n_temporal_updates:
            return {}
        if config.method == "ddl":
            older = max(0, config.ddl_window - len(recent))
            episodes = concatenate([self.buffer.episodes(older), recent]) if older else recent
        arrival = self._sparse_reward if config.first_arrival else None
        pairs = sample_pairs(episodes, config.n_temporal_updates * size, self.rng, arrival)
        inputs = self.regression.inputs(pairs.observations, pairs.actions, pairs.goals)
        labels = torch.from_numpy(pairs.steps_between)
        if config.method != "ddl":
            visits = self.counts.visits(pairs.observations, pairs.actions)
            bonus = uncertainty(visits, config.uncertainty_scale, config.uncertainty_power)
            bonus = torch.from_numpy(bonus.astype(np.float32))
            labels = temporal_label(labels, self.regression.target_steps(inputs), bonus)
        batches = zip(inputs.split(size), labels.split(size), strict=True)
        losses = [self.regression.fit(*batch, n_sampled=size)[0] for batch in batches]
        return {"temporal_loss": _mean(losses), "mean_label": float(labels.mean())}

    def update_target(self) -> None:
        """Algorithm 1, line 9: theta_old <- theta (or a Polyak step towards it)."""
        self.regression.update_target()

    def train_triangular(self, recent: Episodes) -> Metrics:
        """Algorithm 1, lines 10-17: raise or relax d(s_i, a_i, s_g) through waypoints (eq. 4b).

        A label that raises the distance merges, one that lowers it relaxes; the rates are
        shares of all sampled tuples (figure 5).
        """
        config, counts, regression = self.config, self.counts, self.regression
        n_sampled = config.n_triangular_updates * config.batch_size
        triples = sample_triples(recent, self.buffer.episodes(), n_sampled, self.rng)
        unconnected = counts.reached(triples.observations, triples.actions, triples.goals) == 0
        connected = counts.reached(triples.waypoints, triples.waypoint_actions, triples.goals) > 0
        passed = unconnected & (connected if config.require_reached_waypoint else True)  # line 13
        start = triples.observations[passed], triples.actions[passed]
        waypoint = triples.waypoints[passed], triples.waypoint_actions[passed]
        first_leg = regression.target_steps(regression.inputs(*start, triples.waypoint_goals[passed]))
        second_leg = regression.target_steps(regression.inputs(*waypoint, triples.goals[passed]))
        cap = float(config.horizon) if config.cap_triangular else None
        inputs, labels = (
            regression.inputs(*start, triples.goals[passed]),
            hypotenuse(first_leg, second_leg, cap),
        )  # line 14
        merged = 0.0
        sizes = passed.reshape(config.n_triangular_updates, config.batch_size).sum(1).tolist()
        for rows, targets in zip(inputs.split(sizes), labels.split(sizes), strict=True):
            if not len(rows):
                continue  # line 16
            divisor = config.batch_size if config.triangular_mean == "sampled" else len(rows)
            _, predictions = regression.fit(rows, targets, divisor, config.triangular_weight)  # line 17
            merged += float((targets > predictions).sum())
        n_sampled = max(1, n_sampled)
        return {"merging_rate": merged / n_sampled, "relaxation_rate": (len(labels) - merged) / n_sampled}

    def train_policy(self) -> Metrics:
        """Algorithm 1, lines 18-21: HER future relabelling, reward -d / T, SAC or DDPG."""
        config, episodes = self.config, self.buffer.episodes()
        if not config.n_policy_updates:
            return {}
        n_sampled = config.n_policy_updates * config.batch_size
        drawn = sample_relabelled(
            episodes, n_sampled, config.relabel_ratio, config.other_goals_ratio, self._sparse_reward, self.rng
        )
        mean_distance = float("nan")
        rewards = torch.from_numpy(drawn.rewards)
        if config.learns_distance:  # with today's d: stored rewards would be stale
            steps = self.regression.steps(self.regression.inputs(drawn.observations, drawn.actions, drawn.goals))
            rewards, mean_distance = -steps / config.horizon, float(steps.mean())
        scaling = self.regression.distance.scaling
        tensors = [torch.from_numpy(rows) for rows in (drawn.observations, drawn.next_observations, drawn.goals)]
        observations, goals = scaling(tensors[0], tensors[2])
        next_observations = scaling(tensors[1], tensors[2])[0]
        actions = torch.from_numpy(drawn.actions)
        batches = PolicyBatch(observations, actions, next_observations, goals, rewards).split(config.batch_size)
        rows = [self.agent.update(batch, self.generator) for batch in batches]
        return {"mean_distance": mean_distance, **{name: _mean([row[name] for row in rows]) for name in rows[0]}}


def _scaling(episodes: Episodes) -> Scaling:
    """Scaling of all inputs; achieved and desired goals together, as random play stays near the start."""
    achieved = episodes.achieved_goals
    goals = np.concatenate([achieved.reshape(-1, achieved.shape[-1]), episodes.desired_goals])
    return Scaling.estimate(episodes.observations, goals)


def _mean(values: list[Tensor]) -> float:
    return float(torch.stack(values).mean())
