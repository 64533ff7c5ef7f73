"""Options that a run does not read: whoever sets one is told, and does not take the run for what it is not."""

from __future__ import annotations

import warnings

from napsp.config import OF_THE_GATE, TrainConfig, idle_options, preset
from napsp.settings import as_flags, differences

OF_PAIRS = ("temporal.", "n_temporal_updates")
OF_WAYPOINTS = ("triangular.", "n_triangular_updates", *OF_THE_GATE)
OF_METHODS = {
    "sparse": (*OF_PAIRS, *OF_WAYPOINTS, "distance.", "counts.", "uncertainty."),
    "ddl": OF_WAYPOINTS,
    "offpolicy_ddl": (*OF_WAYPOINTS, "temporal.ddl_window"),
    "ours": ("temporal.ddl_window",),
    "plus": (*OF_PAIRS, *OF_WAYPOINTS),
    "qrl": (*OF_PAIRS, *OF_WAYPOINTS),
}
OF_AGENTS = {
    "sac": ("policy.action_penalty", "policy.action_noise", "policy.clipped_double_q"),
    "ddpg": ("policy.entropy_weight", "policy.min_entropy_weight"),
}
"""What the *other* agent reads."""


def unread(config: TrainConfig) -> tuple[str, ...]:
    """Options, or beginnings of their names, that a configuration's method, agent and kind of network do not read."""
    output = () if config.distance.head == "mlp" else ("distance.output",)
    return (*idle_options(config.method), *OF_METHODS[config.method], *OF_AGENTS[config.policy.agent], *output)


def tell_of_unread(config: TrainConfig, stacklevel: int = 3) -> None:
    """Warn of options that differ from the task's own for the method, and that nobody reads."""
    usual = preset(config.env, config.method, config.recipe)
    idle = {name: value for name, value in differences(config, usual).items() if name.startswith(unread(config))}
    if idle:
        what = f"method {config.method} with the {config.policy.agent} agent"
        warnings.warn(f"{what} does not read {as_flags(idle)}", UserWarning, stacklevel=stacklevel)
