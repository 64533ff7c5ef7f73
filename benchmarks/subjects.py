"""Whose policy and distance a benchmark asks: a model there is, or one to train."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.cells import checkpoint_of, training_beside
from napsp.config import DEFAULT, TrainConfig
from napsp.storage.checkpoint import load_model


@dataclass(frozen=True)
class Subject:
    """A trained model.

    Attributes:
        env: the task.
        training: what it was, or is to be, trained with.
        seed: training seed.
        source: a model there is, or the configuration to train.
    """

    env: str
    training: dict[str, Any]
    seed: int
    source: Path | TrainConfig

    @classmethod
    def of(cls, config: TrainConfig) -> Subject:
        """The model of a configuration, which may not be trained yet."""
        return cls(config.env, config.identity(), config.seed, config)

    @classmethod
    def existing(cls, env: str, checkpoint: Path) -> Subject:
        """A model file or folder of a finished run, or the name of one that ships.

        Raises:
            UserError: it is no such model, of another task, or does not say how it was trained.
        """
        load_model(checkpoint, env)
        return cls(env, *training_beside(checkpoint, env), checkpoint)

    @property
    def n_episodes(self) -> int:
        """Training episodes."""
        return self.training.get("n_episodes", DEFAULT.n_episodes)

    def checkpoint(self) -> Path:
        """The model; trained when needed."""
        return self.source if isinstance(self.source, Path) else checkpoint_of(self.source)
