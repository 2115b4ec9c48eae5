"""What the tests of the planner share."""

import numpy as np
import pytest

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import SphereSet, box_spheres, concatenate, finger_spheres
from smp_gym.sampling import sample_scene
from smp_gym.scene import BIN_HEIGHT, Obstacle, fixtures
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.problem import arm_problem
from smp_planner.planning.tool_goals import GoalRegion


@pytest.fixture(scope="session")
def pointer():
    """Return a function that makes a robot of one joint about z, with a sphere at its end."""

    def make(length=1.0, radius=0.1, limit=3.0, velocity=1.0):
        return RobotModel(
            base=np.eye(4),
            joint_origins=np.eye(4)[None],
            end_effector=np.eye(4),
            lower=np.array([-limit]),
            upper=np.array([limit]),
            velocity=np.array([velocity]),
            spheres=SphereSet(np.array([1]), np.array([[length, 0.0, 0.0]]), np.array([radius])),
            collision_pairs=np.empty((0, 2), np.int64),
        )

    return make


@pytest.fixture(scope="session")
def planar():
    """Two links of a metre in the plane, with a ball in the middle and at the end of each."""
    origins = np.stack([np.eye(4), np.eye(4)])
    origins[1, 0, 3] = 1.0
    center = np.array([[0.5, 0, 0], [1.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]])
    return RobotModel(
        base=np.eye(4),
        joint_origins=origins,
        end_effector=np.eye(4),
        lower=np.full(2, -3.0),
        upper=np.full(2, 3.0),
        velocity=np.array([1.0, 2.0]),
        spheres=SphereSet(np.array([1, 1, 2, 2]), center, np.full(4, 0.05)),
        collision_pairs=np.empty((0, 2), np.int64),
    )


@pytest.fixture(scope="session")
def postures():
    """The last configurations (7,6) rad of the demonstrations of Placement."""
    return np.array([path[-1] for path in Demonstrations.load("Placement").configurations])


@pytest.fixture(scope="session")
def held():
    """The pose (4,4) in which `placement` holds its object."""
    pose = np.eye(4)
    pose[0, 3] = 0.022
    return pose


@pytest.fixture(scope="session")
def region(held):
    """Return a function that makes a goal for the held object's centre."""

    def make(center, half=(0.02, 0.02, 0.015)):
        return GoalRegion(held[:3, 3], np.subtract(center, half), np.add(center, half))

    return make


@pytest.fixture(scope="session")
def placement(held, region):
    """Return a function that poses the problem of a scene of Placement."""
    hand = finger_spheres((0.9, 0.9, 0.3, 0.3))
    spheres = concatenate(hand, box_spheres((0.025, 0.025, 0.03), held))

    def make(scene, seed=0, extra=(), goals=None):
        x, y, z = scene.goals[0].position
        above = (region((x, y, z + BIN_HEIGHT + 0.055)),)
        obstacles = (*scene.obstacles, *extra, *fixtures(scene))
        return arm_problem(np.array(scene.start), obstacles, spheres, goals or above, seed)

    return make


def _column(x, y, height, radius):
    """A cylinder that stands on the table."""
    size = (radius, radius, height / 2)
    return Obstacle(shape="cylinder", position=(x, y, height / 2), size=size)


@pytest.fixture(scope="session")
def columns():
    """Two columns and a ball above them, across the demonstrated movement of Placement.

    Sizes were tried until they stopped all but one in a hundred draws of the primitive or fewer
    (400 draws for each of the bins of seeds 0 to 2) and the baselines still found free ones.
    """
    ball = Obstacle(shape="sphere", position=(0.6, 0.0, 0.53), size=(0.05,) * 3)
    return _column(0.55, -0.1, 0.44, 0.08), _column(0.56, 0.08, 0.36, 0.07), ball


@pytest.fixture(scope="session")
def blocked(columns):
    """Return a function that draws a bin of Placement and sets the columns before it."""

    def make(seed):
        empty = sample_scene("Placement", "none", seed)
        return empty.model_copy(update={"obstacles": columns})

    return make


@pytest.fixture(scope="session")
def crowded(blocked):
    """A scene of Placement, with bodies beside and behind the arm besides the columns."""
    scene = blocked(3)
    pillar = Obstacle(shape="box", position=(0.2, -0.45, 0.25), size=(0.03, 0.03, 0.25))
    beam = Obstacle(shape="box", position=(0.1, 0.5, 0.6), size=(0.2, 0.03, 0.03))
    ball = Obstacle(shape="sphere", position=(-0.35, 0.1, 0.6), size=(0.08,) * 3)
    return scene.model_copy(update={"obstacles": (*scene.obstacles, pillar, beam, ball)})


@pytest.fixture(scope="session")
def checker(placement, crowded):
    """The free space of that scene."""
    problem = placement(crowded)
    return EdgeChecker(problem.robot, problem.obstacles, 0.005)
