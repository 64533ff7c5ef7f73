"""Every table and figure of the project, each from one command."""

import napsp.envs  # noqa: F401 - before mujoco, which a wrong MUJOCO_GL would stop
