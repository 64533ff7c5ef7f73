"""What plans are compared with: one ``mujoco.rollout`` call that plans nothing."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from napsp.envs.dynamics import INTEGRATION_STATE, Dynamics

# What a bare rollout holds constant; without it MuJoCo would move mocap bodies to the origin.
HELD = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT


class RawRollout:
    """One ``mujoco.rollout`` call over the same model, samples and steps, with constant controls."""

    def __init__(self, dynamics: Dynamics, n_threads: int, state: np.ndarray, n_samples: int, horizon: int) -> None:
        self._model = dynamics.model
        self._datas = [mujoco.MjData(self._model) for _ in range(n_threads)]
        self._n_samples, self._n_steps = n_samples, horizon * dynamics.substeps
        data = self._datas[0]
        mujoco.mj_setState(self._model, data, state, INTEGRATION_STATE)
        mujoco.mj_forward(self._model, data)
        self._start = self._read(data, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._controls = self._read(data, HELD)
        self._warmstart = data.qacc_warmstart.copy()
        self._rollout = Rollout(nthread=n_threads)

    def _read(self, data: mujoco.MjData, spec: int) -> np.ndarray:
        values = np.empty(mujoco.mj_stateSize(self._model, spec))
        mujoco.mj_getState(self._model, data, values, spec)
        return values

    def __call__(self) -> None:
        """Simulate."""
        start = np.tile(self._start, (self._n_samples, 1))
        controls = self._controls[None, None]
        self._rollout.rollout(
            self._model,
            self._datas,
            start,
            controls,
            control_spec=HELD,
            nstep=self._n_steps,
            initial_warmstart=self._warmstart,
        )

    def close(self) -> None:
        """Stop the worker threads."""
        self._rollout.close()
