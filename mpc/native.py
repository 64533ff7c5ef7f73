"""Whole horizons of many samples in one ``mujoco.rollout`` call, where that equals stepping."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from napsp.envs.state import may_sleep

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_AUTORESET_OFF = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def hands_over(model: mujoco.MjModel, data: mujoco.MjData, n_steps: int) -> bool:
    """Whether ``mujoco.rollout`` over ``n_steps`` physics steps starts from all that the next ``mj_step`` reads.

    It takes the full physics state, the warm start and controls, and sets everything else to what a reset does. What
    it can not do is say that a simulation blew up: its clock does, but not in what may be the first step after zero.
    """
    bodies = np.flatnonzero(model.body_mocapid >= 0)
    mocap = model.body_mocapid[bodies]
    return not (
        may_sleep(model)
        or model.nuserdata
        or model.opt.disableflags & _AUTORESET_OFF
        or data.time + (n_steps - 1.5) * model.opt.timestep < 0.0
        or data.xfrc_applied.any()
        or data.qfrc_applied.any()
        or (data.eq_active != model.eq_active0).any()
        or (data.mocap_pos[mocap] != model.body_pos[bodies]).any()
        or (data.mocap_quat[mocap] != model.body_quat[bodies]).any()
    )


class NativeRollout:
    """A pool of MuJoCo's own threads."""

    def __init__(self, n_threads: int) -> None:
        self._pool = Rollout(nthread=n_threads)

    def run(
        self,
        model: mujoco.MjModel,
        datas: Sequence[mujoco.MjData],
        controls: np.ndarray,
        substeps: int,
        features: np.ndarray,
    ) -> np.ndarray:
        """Simulate controls ``(N, H, U)`` from the state of the first of ``datas``; write qpos and qvel ``(N, H, F)``.

        Returns:
            Samples that MuJoCo warned of, bool ``(N,)``: it left them as they were then, so step them otherwise.
        """
        data = datas[0]
        start = np.empty(mujoco.mj_stateSize(model, FULL))
        mujoco.mj_getState(model, data, start, FULL)
        held = np.repeat(controls, substeps, axis=1)
        states, _ = self._pool.rollout(model, datas, start, held, initial_warmstart=data.qacc_warmstart.copy())
        ends = np.asarray(states)[:, substeps - 1 :: substeps]
        features[:] = ends[..., 1 : 1 + model.nq + model.nv]
        period = model.opt.timestep
        return np.abs(ends[:, -1, 0] - start[0] - held.shape[1] * period) > 0.5 * period

    def close(self) -> None:
        """Stop the threads."""
        self._pool.close()
