"""Other planning libraries on this package's tasks, as their users would set them up.

Every peer runs its own MPPI on the same MuJoCo model, with the same samples, control steps and noise scale,
and the mean straight-line distance along the plan as its cost. They differ in what they ask of their user:

* judo-rai simulates by itself: its Controller with its MJRolloutBackend, one thread and one copy of the model per
  sample. It sets actuator controls only, so it cannot express Fetch, whose mocap target moves. Our task class
  leaves out its parent's constructor, which downloads meshes and reads an XML file. The package asks for an older
  MuJoCo, but runs with a newer one: install it with ``--no-deps``.
* pytorch-mppi wants a function from states and controls to the next states: one ``mujoco.rollout`` call per control
  step of the whole batch.
* mbrl-lib wants a function from action sequences to values: one ``mujoco.rollout`` call per plan, or one per
  control step where a control depends on the simulated state. Its MPPI draws noise of deviation 0.88, whatever
  ``sigma`` says. It asks for older gymnasium and hydra, but its planners run with newer ones.

These functions are in :mod:`benchmarks.batch_simulator`.
"""

from __future__ import annotations

import copy
import importlib
from typing import Any, Protocol

import mujoco
import numpy as np
import torch

from benchmarks.batch_simulator import Problem, UnavailableError, make_simulator
from napsp.envs.dynamics import INTEGRATION_STATE

TEMPERATURE = 0.2  # of every peer's MPPI, in steps


class Peer(Protocol):
    """Another library's planner."""

    package: str
    """Its name in the package index."""
    install: str
    """Commands that install it."""

    def __init__(self, problem: Problem) -> None: ...

    @property
    def physics_steps(self) -> int:
        """Physics steps of the last plan, over all samples."""
        ...

    @property
    def actions(self) -> np.ndarray:
        """What the last plan simulated, ``(N, H, A)``."""
        ...

    def plan(self, state: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Plan from an environment's state and observation; the action or control to execute, ``(A,)``."""
        ...

    def close(self) -> None:
        """Stop the threads."""
        ...


class Judo:
    """judo-rai's Controller with its MPPI, its rollouts and one knot per control step, held."""

    package, install = "judo-rai", "pip install --no-deps judo-rai; pip install viser omegaconf"

    def __init__(self, problem: Problem) -> None:
        world, dynamics = problem.world, problem.world.dynamics
        if not dynamics.open_loop:
            raise UnavailableError("cannot express: its rollouts set actuator controls only, this task moves a mocap")
        control, mppi, tasks = (self._load(f"judo.{name}") for name in ("controller", "optimizers.mppi", "tasks.base"))
        self._state_message = self._load("judo.app.structs").MujocoState
        peer, substeps = self, dynamics.substeps

        class ReachGoal(tasks.Task):
            """The reward is minus the cost, read at the ends of control steps."""

            def __init__(self) -> None:
                self.config = tasks.TaskConfig()
                self.model = copy.deepcopy(world.model)
                self.data = mujoco.MjData(self.model)

            def reward(self, states: np.ndarray, sensors: Any, controls: Any, system_metadata: Any = None) -> Any:
                ends = states[:, substeps - 1 :: substeps]
                return -problem.cost(dynamics.observe(ends)[1], peer.goal).mean(-1)

        sizes = {"num_rollouts": problem.samples, "num_nodes": problem.horizon + 1}  # the last one is where it ends
        optimizer = mppi.MPPI(
            mppi.MPPIConfig(**sizes, sigma=problem.noise_scale, temperature=TEMPERATURE), world.model.nu
        )
        # Half a physics step less than the horizon: it rounds up, and must not do so by one too many.
        seconds = (problem.horizon * substeps - 0.5) * world.model.opt.timestep
        config = control.ControllerConfig(horizon=seconds, spline_order="zero", action_normalizer="min_max")
        self.goal = world.goal
        self._controller = control.Controller(config, ReachGoal(), optimizer)
        self._data, self._model = mujoco.MjData(world.model), world.model

    def _load(self, module: str) -> Any:
        return load(module, self.install)

    @property
    def physics_steps(self) -> int:
        """Physics steps of the last plan, over all samples."""
        return self._controller.states.shape[0] * self._controller.states.shape[1]

    @property
    def actions(self) -> np.ndarray:
        """What the last plan simulated, ``(N, H, A)``."""
        return self._controller.candidate_knots[:, :-1] / self._model.actuator_ctrlrange[:, 1]

    def plan(self, state: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Plan; the actuator control to execute."""
        data, controller = self._data, self._controller
        mujoco.mj_setState(self._model, data, state, INTEGRATION_STATE)
        self.goal = observation["desired_goal"]
        poses = data.xpos, data.xquat, data.mocap_pos, data.mocap_quat
        controller.update_states(self._state_message(data.time, data.qpos, data.qvel, *poses, {}))
        controller.update_action()
        return controller.action(controller.time)

    def close(self) -> None:
        """Stop the threads."""
        self._controller.rollout_backend._rollout_obj.close()


class PytorchMPPI:
    """pytorch-mppi in double precision, so that states pass without conversion."""

    package, install = "pytorch-mppi", "pip install pytorch-mppi"

    def __init__(self, problem: Problem) -> None:
        mppi, self._simulator = load("pytorch_mppi", self.install), make_simulator(problem, 1)
        n_actions = problem.world.action_space.shape[0]

        def advance(states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
            return torch.from_numpy(self._simulator.advance(states.numpy(), actions.numpy()[:, None])[:, 0])

        def cost(states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
            goals = self._simulator.achieved_goals(states.numpy())
            return torch.from_numpy(problem.cost(goals, self._goal) / problem.horizon)

        self._goal = problem.world.goal
        bound = torch.ones(n_actions, dtype=torch.float64)
        self._mppi = mppi.MPPI(
            advance,
            cost,
            self._simulator.size,
            problem.noise_scale**2 * torch.eye(n_actions, dtype=torch.float64),
            num_samples=problem.samples,
            horizon=problem.horizon,
            lambda_=TEMPERATURE,
            u_min=-bound,
            u_max=bound,
        )

    @property
    def physics_steps(self) -> int:
        """Physics steps of the last plan, over all samples."""
        return self._simulator.physics_steps

    @property
    def actions(self) -> np.ndarray:
        """What the last plan simulated, ``(N, H, A)``."""
        return self._mppi.perturbed_action.numpy()

    def plan(self, state: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Plan; the action to execute."""
        self._goal = observation["desired_goal"]
        return self._mppi.command(torch.from_numpy(self._simulator.start(state))).numpy()

    def close(self) -> None:
        """Stop the threads."""
        self._simulator.close()


class MbrlLib:
    """mbrl-lib's MPPIOptimizer without correlation between control steps."""

    package, install = "mbrl", "pip install --no-deps mbrl; pip install hydra-core termcolor"

    def __init__(self, problem: Problem) -> None:
        optimizers = load("mbrl.planning.trajectory_opt", self.install)
        self._problem, self._simulator = problem, make_simulator(problem, problem.horizon)
        bound = np.ones((problem.horizon, problem.world.action_space.shape[0]))
        self._optimizer = optimizers.MPPIOptimizer(
            num_iterations=1,
            population_size=problem.samples,
            gamma=1.0 / TEMPERATURE,
            sigma=problem.noise_scale,
            beta=1.0,
            lower_bound=(-bound).tolist(),
            upper_bound=bound.tolist(),
            device=torch.device("cpu"),
        )
        self.actions = np.empty(0)

    @property
    def physics_steps(self) -> int:
        """Physics steps of the last plan, over all samples."""
        return self._simulator.physics_steps

    def plan(self, state: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Plan; the action to execute."""

        def value(actions: torch.Tensor) -> torch.Tensor:
            self.actions = actions.numpy()
            goals = self._simulator.rollout(state, self.actions)
            return torch.from_numpy(-self._problem.cost(goals, observation["desired_goal"]).mean(-1)).float()

        return self._optimizer.optimize(value)[0].numpy()

    def close(self) -> None:
        """Stop the threads."""
        self._simulator.close()


PEERS: dict[str, type[Peer]] = {"judo": Judo, "pytorch-mppi": PytorchMPPI, "mbrl-lib": MbrlLib}


def load(module: str, install: str) -> Any:
    """Import a module of a peer.

    Raises:
        UnavailableError: it, or something that it needs, is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UnavailableError(f"not installed ({error}): {install}") from error
