"""Learners of the policy by name: a new one is a file and a line."""

from __future__ import annotations

from napsp.policy.ddpg import DDPG
from napsp.policy.sac import SAC

AGENTS: dict[str, type[SAC] | type[DDPG]] = {"sac": SAC, "ddpg": DDPG}
