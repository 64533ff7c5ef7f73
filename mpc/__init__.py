"""What a plan is and what it costs: batched rollouts, costs, the receding-horizon loop."""

from napsp.opengl import import_mujoco

import_mujoco()  # before anything else does, if a MUJOCO_GL was chosen: a wrong one would stop it
