"""Problems for the tests of batches, without the physics: scenes of Placement and held boxes."""

import numpy as np

from smp_gym.robot.kinematics import box_spheres, concatenate, finger_spheres
from smp_gym.scene import BIN_HEIGHT, Obstacle, fixtures
from smp_planner.planning.problem import arm_problem
from smp_planner.planning.tool_goals import GoalRegion

HELD = np.eye(4)
HELD[0, 3] = 0.022

ROUND = (
    Obstacle(shape="sphere", position=(0.35, 0.25, 0.35), size=(0.06, 0.06, 0.06)),
    Obstacle(
        shape="cylinder",
        position=(0.4, -0.1, 0.3),
        quaternion=(0.6, 0.0, 0.0, 0.8),
        size=(0.04, 0.04, 0.12),
    ),
)


def problem_of(scene, seed=0, extra=(), half_extents=(0.025, 0.025, 0.03)):
    """Return the problem of a scene, for a box of any size held in the hand."""
    spheres = concatenate(finger_spheres((0.9, 0.9, 0.3, 0.3)), box_spheres(half_extents, HELD))
    goals = []
    for goal in scene.goals:
        x, y, z = goal.position
        center, half = np.array((x, y, z + BIN_HEIGHT + 0.055)), np.array((0.02, 0.02, 0.015))
        goals.append(GoalRegion(HELD[:3, 3], center - half, center + half))
    return arm_problem(
        np.array(scene.start),
        (*scene.obstacles, *extra, *fixtures(scene)),
        spheres,
        tuple(goals),
        seed,
        movable=scene.obstacles,
    )
