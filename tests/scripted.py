"""A hand-written pick and place: the proof that the tasks can be solved in their 50 steps."""

import numpy as np

SPEED = 0.033  # metres per control step at full action
HELD = 0.028  # both finger positions are below this when they hold the 5 cm box
ABOVE = 0.07  # grip over box while moving to it
OVER_THE_WALL = 0.60  # box height that clears a wall with its top at 0.55


class PickAndPlace:
    """Actions ``(4,)`` from observation dictionaries: grasp, lift, carry, lower.

    With ``lift=False`` the box is carried 4 cm above the table until it is below its goal.
    """

    def __init__(self, lift=True):
        self.lift = lift
        self.closing = 0

    def __call__(self, observation):
        values, goal = observation["observation"], observation["desired_goal"][:3]
        grip, box, fingers = values[:3], values[3:6], values[9:11]
        offset = box - grip
        centred = np.abs(offset[:2]).max() < 0.012
        if not self.closing and not (centred and abs(offset[2]) < 0.012):
            return self._action(offset + (0.0 if centred else [0, 0, ABOVE]), fingers=1.0)
        self.closing += 1
        if self.closing == 1 or (self.closing <= 3 and fingers.max() > HELD):
            return self._action(offset, fingers=-1.0)
        move = goal - box
        if np.abs(move[:2]).max() > 0.03:
            move[2] = (max(OVER_THE_WALL, goal[2]) if self.lift else 0.47) - box[2]
            if self.lift and move[2] > 0.04:
                move[:2] = 0.0  # first up
        return self._action(move, fingers=-1.0)

    def _action(self, move, fingers):
        return np.append(np.clip(move / SPEED, -1, 1), fingers).astype(np.float32)


def play(world, seed, lift=True, steps=50):
    """Run one episode; return actions ``(T, 4)``, box positions ``(T, 3)`` and success ``(T,)``."""
    observation, _ = world.reset(seed=seed)
    policy = PickAndPlace(lift)
    actions, boxes, reached = [], [], []
    for _ in range(steps):
        actions.append(policy(observation))
        observation, _, _, _, info = world.step(actions[-1])
        boxes.append(observation["observation"][3:6])
        reached.append(info["is_success"])
    return np.array(actions), np.array(boxes), np.array(reached)
