"""Orientations of a tool against scipy's rotations, finite turns and PyBullet."""

import math

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from smp_gym.assets import jaco_urdf
from smp_planner.library.smp import Cone, GoalRegion, Orientation, Robot, ToolViaPoint
from smp_planner.planning.tool_constraints import Reaching, ToolPath

RANDOM = Rotation.random(200, random_state=0)
WANTED = Rotation.from_euler("xyz", (0.4, -1.1, 2.0))
AXIS, DIRECTION = np.array([0.3, -2.0, 0.5]), np.array([1.0, 0.2, -3.0])


def angle_between(first, second):
    cosine = first @ second / np.linalg.norm(first, axis=-1) / np.linalg.norm(second)
    return np.arccos(cosine)


def test_angles_are_those_of_scipy():
    cone, fixed = Cone(AXIS, DIRECTION, 0.1), Orientation(WANTED.as_quat(), 0.1)
    found = cone.turned(RANDOM.as_matrix())[0]
    np.testing.assert_allclose(found, angle_between(RANDOM.apply(AXIS), DIRECTION), atol=1e-12)
    found = fixed.turned(RANDOM.as_matrix())[0]
    np.testing.assert_allclose(found, (RANDOM * WANTED.inv()).magnitude(), atol=1e-12)


@pytest.mark.parametrize(
    "orientation", [Cone(AXIS, DIRECTION, 0.1), Orientation(WANTED.as_quat(), 0.1)]
)
def test_a_turn_about_the_axis_makes_the_angle_larger_at_its_own_rate(orientation):
    step = 1e-6
    angle, axis = orientation.turned(RANDOM.as_matrix())
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0)
    for turn in np.eye(3):
        ahead, behind = (
            orientation.turned((Rotation.from_rotvec(s * turn) * RANDOM).as_matrix())[0]
            for s in (step, -step)
        )
        np.testing.assert_allclose((ahead - behind) / (2.0 * step), axis @ turn, atol=1e-6)
    assert angle.min() > 0.01
    # What does not matter is projected out, and nothing else.
    projector = orientation.bound(RANDOM[0].as_matrix())
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)
    np.testing.assert_allclose(projector @ axis[0], axis[0], atol=1e-12)
    left = 2 if isinstance(orientation, Cone) else 3
    assert np.linalg.matrix_rank(projector) == left


@pytest.mark.parametrize("turn", [0.0, math.pi])
def test_parallel_axes_and_equal_orientations_have_an_angle(turn):
    around = Rotation.from_rotvec(turn * np.array([1.0, 0.0, 0.0]))
    cone = Cone((0, 0, 1), (0, 0, 1), 0.1)
    fixed = Orientation(WANTED.as_quat(), 0.1)
    for orientation, rotation in ((cone, around), (fixed, around * WANTED)):
        angle, axis = orientation.turned(rotation.as_matrix()[None])
        np.testing.assert_allclose(angle, turn, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(axis), 1.0)


def test_lengths_of_axes_do_not_matter():
    for factor in (1e-200, 1e-3, 1e200):
        cone = Cone(factor * AXIS, DIRECTION, 0.1)
        np.testing.assert_allclose(cone.axis, AXIS / np.linalg.norm(AXIS))


def test_the_hand_is_turned_as_pybullet_has_it():
    robot = Robot.from_urdf(jaco_urdf(), "j2s6s200_end_effector")
    client = pybullet.connect(pybullet.DIRECT)
    arm = pybullet.loadURDF(str(jaco_urdf()), useFixedBase=True, physicsClientId=client)
    infos = [
        pybullet.getJointInfo(arm, i, physicsClientId=client)
        for i in range(pybullet.getNumJoints(arm, physicsClientId=client))
    ]
    number = {info[1].decode(): info[0] for info in infos}
    (tip,) = (info[0] for info in infos if info[12].decode() == "j2s6s200_end_effector")
    angles = np.random.default_rng(1).uniform(-3.0, 3.0, (20, 6))
    rotations, axes = robot.model.tool_rotations(angles)
    quaternions = robot.tool_quaternions(angles)
    for q, rotation, axis, quaternion in zip(angles, rotations, axes, quaternions, strict=True):
        for name, angle in zip(robot.joints, q, strict=True):
            pybullet.resetJointState(arm, number[name], angle, physicsClientId=client)
        state = pybullet.getLinkState(arm, tip, computeForwardKinematics=1, physicsClientId=client)
        there = Rotation.from_quat(state[5])
        assert (Rotation.from_matrix(rotation) * there.inv()).magnitude() < 1e-5
        assert (Rotation.from_quat(quaternion) * there.inv()).magnitude() < 1e-5
        for joint in range(6):
            change = np.zeros(6)
            change[joint] = 1e-6
            moved = robot.model.tool_rotations(q + change)[0]
            turn = Rotation.from_matrix(moved @ rotation.T).as_rotvec() / 1e-6
            np.testing.assert_allclose(axis[:, joint], turn, atol=1e-5)
    pybullet.disconnect(client)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Cone((0, 0, 0), (0, 0, 1), 0.1), r"Cone.axis must not be zero"),
        (lambda: Cone((0, 0, 1), (0, 0, 0), 0.1), r"Cone.direction must not be zero"),
        (lambda: Cone((0, 0, np.nan), (0, 0, 1), 0.1), r"Cone.axis must be finite"),
        (lambda: Cone((0, 1), (0, 0, 1), 0.1), r"Cone.axis must have shape \(3,\)"),
        (lambda: Cone((0, 0, 1), (0, 0, 1), -0.1), r"Cone.angle must be .* at least 0.0.* -0.1"),
        (lambda: Cone((0, 0, 1), (0, 0, 1), 90.0), r"Cone.angle must be .* at most 3.14.* 90"),
        (lambda: Cone((0, 0, 1), (0, 0, 1), "wide"), r"Cone.angle must be .* 'wide'"),
        (lambda: Orientation((0, 0, 0, 2), 0.1), r"Orientation.quaternion must have norm 1"),
        (lambda: Orientation((0, 0, 0, 0), 0.1), r"Orientation.quaternion must have norm 1"),
        (lambda: Orientation((0, 0, 1), 0.1), r"Orientation.quaternion must have shape \(4,\)"),
        (lambda: Orientation((0, 0, 0, 1), -1.0), r"Orientation.tolerance must be .* -1"),
        (lambda: Orientation((0, 0, 0, 1), 4.0), r"Orientation.tolerance must be .* at most 3.14"),
        (
            lambda: GoalRegion(np.zeros(3), np.zeros(3), np.ones(3), (0, 0, 0, 1)),
            r"GoalRegion.orientation must be a Cone, an Orientation or None, got \(0, 0, 0, 1\)",
        ),
        (
            lambda: ToolViaPoint(0.5, np.zeros(3), np.ones(3), 0.1, "down"),
            "ToolViaPoint.orientation must be .* 'down'",
        ),
        (lambda: ToolViaPoint(0.5, np.zeros(3), np.ones(3), 0.0), "tolerance must be .* above"),
    ],
)
def test_bad_orientations_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_tasks_of_the_environments_refuse_orientations():
    robot = Robot.from_urdf(jaco_urdf(), "j2s6s200_end_effector").model
    cone = Cone((0, 0, 1), (0, 0, 1), 0.1)
    goal = GoalRegion(np.zeros(3), np.zeros(3), np.ones(3), cone)
    with pytest.raises(ValueError, match=r"goals\[0\].orientation must be None here, got Cone"):
        Reaching((goal,), robot)
    via = ToolViaPoint(0.5, np.zeros(3), np.ones(3), 0.1, cone)
    with pytest.raises(ValueError, match=r"via_points\[0\].orientation must be None here"):
        ToolPath((via,), robot)
