"""Searches with settings by name, and the plans and the randomness they are handed."""

import numpy as np

from planners.cem import CEM, CEMConfig
from planners.icem import ICEM, ICEMConfig
from planners.mppi import MPPI, MPPIConfig
from planners.predictive_sampling import PredictiveSampling, PredictiveSamplingConfig
from planners.smooth import Held, HeldConfig

SAMPLING = [MPPI, CEM, ICEM, PredictiveSampling]
ONE_LATER = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])  # K = H = 3
CONFIGS = {
    MPPI: MPPIConfig,
    CEM: CEMConfig,
    ICEM: ICEMConfig,
    PredictiveSampling: PredictiveSamplingConfig,
    Held: HeldConfig,
}


def search(kind, n_knots, n_controls, **settings):
    """The one place that knows how a search is built."""
    return kind(n_knots, n_controls, CONFIGS[kind](**settings))


def rng(seed=0):
    return np.random.default_rng(seed)


def plans(*values, shape=(1, 1)):
    """One plan per value, constant over knots and controls, ``(N, *shape)``."""
    return np.array(values, float)[:, None, None] * np.ones(shape)
