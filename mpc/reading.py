"""Where a plan reads the distance, in words that a command line can check before torch is imported."""

from __future__ import annotations

from typing import Literal

Where = Literal["terminal", "mean", "both"]
ActionOf = Literal["policy", "plan"]
