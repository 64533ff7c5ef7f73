"""Options of training that once had another name: in older files, and on command lines, which get the new one."""

from __future__ import annotations

TRAINING: dict[str, str] = {
    "distance_learning_rate": "distance.learning_rate",
    "distance_output": "distance.output",
    "target_polyak": "distance.target_polyak",
    "slow_distance": "distance.slow",
    "first_arrival": "temporal.first_arrival",
    "ddl_window": "temporal.ddl_window",
    "uncertainty_scale": "uncertainty.scale",
    "uncertainty_power": "uncertainty.power",
    "visit_bits": "counts.visit_bits",
    "triangular_weight": "triangular.weight",
    "triangular_mean": "triangular.mean",
    "cap_triangular": "triangular.cap",
    "require_reached_waypoint": "triangular.require_reached_waypoint",
    "agent": "policy.agent",
    "relabel_ratio": "her.relabel_ratio",
    "other_goals_ratio": "her.other_goals_ratio",
    "discount": "policy.discount",
    "policy_learning_rate": "policy.learning_rate",
    "clip_values": "policy.clip_values",
    "polyak": "policy.polyak",
    "entropy_weight": "policy.entropy_weight",
    "min_entropy_weight": "policy.min_entropy_weight",
    "action_noise": "policy.action_noise",
    "clipped_double_q": "policy.clipped_double_q",
    "action_penalty": "policy.action_penalty",
    "epsilon": "explore.epsilon",
    "exploration_hold": "explore.hold",
    "held_starts": "explore.held_starts",
    "evaluate_every": "evaluate.every",
    "n_evaluation_episodes": "evaluate.n_episodes",
}
"""Old name, in files of format napsp-1, to dotted name."""

FLAGS = {
    **TRAINING,
    "epsilon": "explore.epsilon, and is the share of random steps: what 0.1 was is 0.28 with held actions",
    "min_entropy_weight": "policy.min-entropy-weight, and is in lost steps, see docs/paper.md",
    "reached_bits": "counts.pair-bits, for (s, a) alone; goals have --counts.goal-cell and --counts.n-lattices",
}
"""The same for command lines, with a word where the meaning has changed."""
