"""What a plan is and what it costs: batched rollouts, costs, the receding-horizon loop."""

import napsp.envs  # noqa: F401 - before mujoco, which a wrong MUJOCO_GL would stop
