"""What the smoothing layer did so far: counts, and milliseconds of its parts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class SmoothingStatistics:
    """What happened so far; lists have one number per call, times are milliseconds."""

    n_calls: int = 0
    n_accepted: int = 0
    n_kept: int = 0
    """Sampled plans that were the layer's last plan, moved on in time, and that it left as they were."""
    n_solver_failures: int = 0
    n_risen: int = 0
    """Accepted plans with a true objective above the one before: zero unless a tolerance is given."""
    before: list[float] = field(default_factory=list)
    after: list[float] = field(default_factory=list)
    linearise_ms: list[float] = field(default_factory=list)
    solve_ms: list[float] = field(default_factory=list)
    verify_ms: list[float] = field(default_factory=list)
    build_ms: float = 0.0

    def summary(self) -> dict[str, float]:
        """Shares and medians, for ``summary.json``."""
        parts = {name: getattr(self, name) for name in ("linearise_ms", "solve_ms", "verify_ms")}
        before, after = np.array(self.before), np.array(self.after)
        finite = np.isfinite(before) & np.isfinite(after)
        return {
            "calls": self.n_calls,
            "accepted": self.n_accepted,
            "accepted_share": self.n_accepted / max(self.n_calls, 1),
            "kept_share": self.n_kept / max(self.n_calls, 1),
            "risen": self.n_risen,
            "solver_failures": self.n_solver_failures,
            "mean_cost_drop": float((before - after)[finite].mean()) if finite.any() else 0.0,
            "build_ms": self.build_ms,
            **{name: float(np.median(values)) if values else 0.0 for name, values in parts.items()},
        }

    def record(self, before: float, after: float, accepted: bool, kept: bool, milliseconds: dict[str, float]) -> None:
        """Take in one call: true costs of the sampled plan and of the answer, and what each part took."""
        self.n_accepted += accepted
        self.n_kept += kept and not accepted
        self.n_risen += after > before
        self.before.append(before)
        self.after.append(after)
        for name, value in milliseconds.items():
            getattr(self, f"{name}_ms").append(value)
