"""The learned things of Algorithm 1 and one method per line that trains them."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from napsp.buffer import EpisodeBuffer, Episodes, concatenate, sample_pairs, sample_relabelled, sample_triples
from napsp.config import TrainConfig
from napsp.counts import CountModel, uncertainty
from napsp.losses import Metrics, hypotenuse, temporal_label, temporal_loss, triangular_loss
from napsp.networks import DistanceNetwork, move_towards
from napsp.sac import SAC
from napsp.scaling import Scaling

SparseReward = Callable[[np.ndarray, np.ndarray], np.ndarray]


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
        self.distance = DistanceNetwork(sizes, config.hidden, config.horizon, config.distance_output)
        self.target_distance = copy.deepcopy(self.distance).requires_grad_(False)
        self.distance_optimizer = torch.optim.Adam(
            self.distance.parameters(), lr=config.distance_learning_rate, fused=True
        )
        self.agent = SAC(sizes, config)
        # Goals are scaled by achieved and desired ones together: random play stays near the start.
        goals = np.concatenate([warmup.achieved_goals.reshape(-1, sizes[2]), warmup.desired_goals])
        scaling = Scaling(warmup.observations, goals)
        networks = (self.distance, self.target_distance, self.agent.policy)
        for network in (*networks, self.agent.critic, self.agent.target_critic):
            network.scaling.set(scaling)
        self.counts = CountModel(sizes, config.visit_bits, config.reached_bits, scaling, rng)
        self.buffer = EpisodeBuffer()
        self.buffer.extend(warmup)
        self.counts.update(warmup)

    def train_temporal(self, recent: Episodes) -> Metrics:
        """Algorithm 1, lines 5-8: fit d to min[j - i, d_old + U] on pairs of D (eq. 4a).

        ``ddl`` fits d to j - i on its most recent episodes only, D_last included (on-policy).
        """
        config, losses, distances = self.config, [], []
        on_policy = config.method == "ddl"
        episodes = self.buffer.episodes()
        if on_policy:
            older = max(0, config.ddl_window - len(recent))
            episodes = concatenate([self.buffer.episodes(older), recent]) if older else recent
        for _ in range(config.n_temporal_updates):
            pairs = sample_pairs(episodes, config.batch_size, self.rng)
            inputs = _tensors(pairs.observations, pairs.actions, pairs.goals)
            labels = torch.from_numpy(pairs.steps_between)
            if not on_policy:
                visits = self.counts.visits(pairs.observations, pairs.actions)
                bonus = uncertainty(visits, config.uncertainty_scale, config.uncertainty_power)
                with torch.no_grad():
                    target_steps = self.target_distance.steps(*inputs)
                labels = temporal_label(labels, target_steps, torch.from_numpy(bonus.astype(np.float32)))
            loss = temporal_loss(self.distance, *inputs, labels)
            self._step(loss)
            losses.append(float(loss.detach()))
            distances.append(float(labels.mean()))
        return {"temporal_loss": _mean(losses), "mean_label": _mean(distances)}

    def update_target(self) -> None:
        """Algorithm 1, line 9: theta_old <- theta (or a Polyak step towards it)."""
        parameters = self.target_distance.parameters(), self.distance.parameters()
        move_towards(*parameters, self.config.target_polyak)

    def train_triangular(self, recent: Episodes) -> Metrics:
        """Algorithm 1, lines 10-17: raise or relax d(s_i, a_i, s_g) through waypoints (eq. 4b)."""
        config = self.config
        cap = float(config.horizon) if config.cap_triangular else None
        merged = relaxed = 0.0
        for _ in range(config.n_triangular_updates):
            triples = sample_triples(recent, self.buffer.episodes(), config.batch_size, self.rng)
            unconnected = self.counts.reached(triples.observations, triples.actions, triples.goals) == 0
            connected = self.counts.reached(triples.waypoints, triples.waypoint_actions, triples.goals) > 0
            passed = unconnected & (connected if config.require_reached_waypoint else True)  # line 13
            if not passed.any():
                continue  # line 16
            start = _tensors(triples.observations[passed], triples.actions[passed])
            waypoint = _tensors(triples.waypoints[passed], triples.waypoint_actions[passed])
            waypoint_goal, goal = _tensors(triples.waypoint_goals[passed], triples.goals[passed])
            with torch.no_grad():
                first_leg = self.target_distance.steps(*start, waypoint_goal)
                second_leg = self.target_distance.steps(*waypoint, goal)
            labels = hypotenuse(first_leg, second_leg, cap)  # line 14
            n_sampled = config.batch_size if config.triangular_mean == "sampled" else None
            loss, info = triangular_loss(self.distance, *start, goal, labels, n_sampled)  # line 17
            self._step(config.triangular_weight * loss)
            merged, relaxed = merged + info["merged"], relaxed + info["relaxed"]
        sampled = max(1, config.n_triangular_updates * config.batch_size)
        return {"merging_rate": merged / sampled, "relaxation_rate": relaxed / sampled}

    def train_policy(self) -> Metrics:
        """Algorithm 1, lines 18-21: HER future relabelling, reward -d / T, SAC."""
        config, episodes = self.config, self.buffer.episodes()
        info: list[Metrics] = []
        distances = []
        for _ in range(config.n_policy_updates):
            batch = sample_relabelled(episodes, config.batch_size, config.relabel_ratio, self._sparse_reward, self.rng)
            observations, actions, goals = _tensors(batch.observations, batch.actions, batch.goals)
            if config.learns_distance:
                with torch.no_grad():  # recomputed at every use: stored rewards would be stale
                    steps = self.distance.steps(observations, actions, goals)
                rewards = -steps / config.horizon
                distances.append(float(steps.mean()))
            else:
                rewards = torch.from_numpy(batch.rewards)
            next_observations = torch.from_numpy(batch.next_observations)
            info.append(self.agent.update(observations, actions, next_observations, goals, rewards, self.generator))
        metrics = {name: _mean([entry[name] for entry in info]) for name in info[0]} if info else {}
        return {**metrics, "mean_distance": _mean(distances), "entropy_weight": self.agent.entropy_weight}

    def _step(self, loss: Tensor) -> None:
        self.distance_optimizer.zero_grad()
        loss.backward()
        self.distance_optimizer.step()


def _tensors(*arrays: np.ndarray) -> list[Tensor]:
    return [torch.from_numpy(array) for array in arrays]


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
