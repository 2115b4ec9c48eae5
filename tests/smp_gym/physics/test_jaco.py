"""The arm in the physics, checked against kinematics and against what was commanded."""

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from smp_gym import assets
from smp_gym.env import ManipulationEnv
from smp_gym.observation import CONTROL_PERIOD, GRIPPER_RATE
from smp_gym.physics.jaco import ARM, FINGER_CLOSED, HAND_LINKS, Jaco
from smp_gym.physics.workcell import SUBSTEPS
from smp_gym.physics.world import BulletWorld
from smp_gym.robot import kinematics
from smp_gym.sampling import sample_scene
from smp_gym.scene import TABLE
from smp_gym.tasks.placement.rules import GRASP_FINGER_ANGLES, START_CONFIGURATION

GREY = (0.5, 0.5, 0.5, 1.0)


@pytest.fixture
def arm():
    world = BulletWorld()
    world.add_body("table", [TABLE], color=GREY)
    arm = Jaco(world, assets.jaco_urdf(), START_CONFIGURATION)

    def step(action):
        arm.integrate(np.asarray(action, np.float64))
        arm.track()
        for _ in range(SUBSTEPS):
            world.step()

    arm.step = step
    arm.world = world
    yield arm
    world.close()


def test_it_stands_where_it_was_put(arm):
    np.testing.assert_allclose(arm.state().configuration, START_CONFIGURATION, atol=1e-12)
    assert arm.gripper_reference == 0.0
    arm.world.detect_contacts()
    assert arm.world.contacts() == set()


def test_end_effector_agrees_with_kinematics(arm):
    rng = np.random.default_rng(0)
    for _ in range(5):
        arm.step([*rng.uniform(-1, 1, 6), 0.0])
        state = arm.state()
        pose = kinematics.end_effector_pose(state.configuration)
        np.testing.assert_allclose(state.end_effector_position, pose[:3, 3], atol=1e-6)
        rotation = Rotation.from_quat(state.end_effector_quaternion).as_matrix()
        np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-6)


def test_something_carried_moves_with_the_hand(arm):
    offset = np.eye(4)
    offset[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    offset[:3, 3] = (0.1, 0.02, -0.03)
    expected = kinematics.end_effector_pose(np.array(START_CONFIGURATION)) @ offset
    position, quaternion = arm.carried(offset)
    np.testing.assert_allclose(position, expected[:3, 3], atol=1e-6)
    np.testing.assert_allclose(
        Rotation.from_quat(quaternion).as_matrix(), expected[:3, :3], atol=1e-6
    )


def test_the_reference_is_the_integral_of_the_actions(arm):
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (20, 7))
    actions[:, 6] = np.abs(actions[:, 6]) * 0.5
    for action in actions:
        arm.integrate(action)
    moved = actions[:, :6].sum(axis=0) * kinematics.JOINT_VELOCITY * CONTROL_PERIOD
    np.testing.assert_allclose(arm.reference, START_CONFIGURATION + moved, atol=1e-12)
    closed = actions[:, 6].sum() * GRIPPER_RATE * CONTROL_PERIOD
    assert arm.gripper_reference == pytest.approx(closed)


def test_the_reference_stops_at_the_limits(arm):
    for sign, limit in ((1, kinematics.JOINT_UPPER), (-1, kinematics.JOINT_LOWER)):
        for _ in range(500):
            arm.integrate(np.full(7, float(sign)))
        np.testing.assert_array_equal(arm.reference, limit)
        assert arm.gripper_reference == max(sign, 0)


def test_smooth_motion_at_the_velocity_limit_is_tracked_closely(arm):
    rng = np.random.default_rng(2)
    way = rng.choice([-1.0, 1.0], 6) * 0.4
    peak = 1.875  # of the minimum-jerk profile's velocity, per way and duration
    steps = int(np.ceil(peak * np.abs(way / kinematics.JOINT_VELOCITY).max() / CONTROL_PERIOD))
    s = np.linspace(0, 1, steps + 1)
    profile = (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * way
    for move in np.diff(profile, axis=0):
        action = move / (kinematics.JOINT_VELOCITY * CONTROL_PERIOD)
        assert np.abs(action).max() <= 1.0
        arm.step([*action, 0.0])
        error = np.abs(arm.state().configuration - arm.reference)
        assert error.max() < 5e-4
    expected = kinematics.end_effector_pose(START_CONFIGURATION + way)[:3, 3]
    assert np.linalg.norm(arm.state().end_effector_position - expected) < 2e-4


def test_the_arm_does_not_sag(arm):
    for _ in range(100):
        arm.step(np.zeros(7))
    np.testing.assert_allclose(arm.state().configuration, START_CONFIGURATION, atol=1e-4)


def test_fingers_close_and_open_together(arm):
    for _ in range(40):
        arm.step([0, 0, 0, 0, 0, 0, 1.0])
    angles = arm.state().finger_angles
    assert angles[0] == pytest.approx(angles[1], abs=0.02)
    assert angles[0] > 1.0
    assert arm.squeezes(arm.state())
    for _ in range(60):
        arm.step([0, 0, 0, 0, 0, 0, -1.0])
    np.testing.assert_allclose(arm.state().finger_angles, 0.0, atol=0.03)
    assert not arm.squeezes(arm.state())


def test_a_release_begins_when_the_command_falls_below_the_fingers():
    env = ManipulationEnv(difficulty="none")
    env.reset(seed=0)
    arm = env._cell.arm
    held_at = arm.state().finger_angles[:2].mean()
    while arm.gripper_reference * FINGER_CLOSED > held_at + 0.03:
        assert arm.squeezes(arm.state())
        env.step(np.array([0, 0, 0, 0, 0, 0, -0.2], np.float32))
    for _ in range(4):
        env.step(np.array([0, 0, 0, 0, 0, 0, -0.2], np.float32))
    assert not arm.squeezes(arm.state())
    env.close()


def test_the_settled_grasp_is_the_one_that_planners_know():
    env = ManipulationEnv(difficulty="none")
    env.reset(seed=0)
    state = env._cell.arm.state()
    np.testing.assert_allclose(state.finger_angles, GRASP_FINGER_ANGLES, atol=0.02)
    expected, _ = env._cell.arm.carried(env.task.object_in_hand)
    position, _ = env._cell.world.pose("object")
    assert np.linalg.norm(position - expected) < 2e-3
    env.close()


def test_friction_holds_the_object_at_nine_tenths_of_the_velocity_limit():
    env = ManipulationEnv(difficulty="none")
    scene = sample_scene("Placement", "none", 0)
    rng = np.random.default_rng(3)
    for _ in range(12):
        env.reset(options={"scene": scene})
        direction = rng.choice([-0.9, 0.9], 6)
        # Upwards in the shoulder, so that the table is out of the way.
        direction[1] = -0.9
        before = _object_in_hand(env)
        # Full speed at once, then a full stop.
        for step in range(30):
            velocity = direction if step < 20 else np.zeros(6)
            info = env.step(np.append(velocity, 0.0).astype(np.float32))[4]
            assert not info["collided"], info["collision"]
        assert np.linalg.norm(_object_in_hand(env) - before) < 1.5e-3
    env.close()


def _object_in_hand(env):
    state = env._cell.arm.state()
    position, _ = env._cell.world.pose("object")
    hand = Rotation.from_quat(state.end_effector_quaternion)
    return hand.inv().apply(position - state.end_effector_position)


# Without the rule at release, the object hangs on the hand here, which points up by 45 degrees.
HANGING = (-0.3, -0.46, 0.97, -0.85, -0.95, -0.73)


def test_opening_the_hand_never_keeps_hold_of_the_object():
    env = ManipulationEnv("Placement", "none")
    scene = sample_scene("Placement", "none", 0)
    rng = np.random.default_rng(5)
    # Upwards in the shoulder, away from the table.
    drawn = rng.uniform(-1, 1, (24, 6)) * (1, 0, 1, 1, 1, 1) - (0, 0.25, 0, 0, 0, 0)
    for number, velocity in enumerate([np.array(HANGING), *drawn]):
        env.reset(options={"scene": scene})
        for _ in range(19):
            env.step(np.append(velocity, 0.0).astype(np.float32))
        stop = number % 2 == 0
        for _ in range(4 if stop else 0):
            env.step(np.zeros(7, np.float32))
        begun = _object_in_hand(env)
        rate = rng.uniform(0.4, 1.0) if number else 0.8355463
        for step in range(80):
            moving = velocity * (not stop and step < 8)
            env.step(np.append(moving, -rate).astype(np.float32))
            if np.linalg.norm(_object_in_hand(env) - begun) > 0.04:
                break
        else:
            pytest.fail(f"still in the hand after {velocity}, opened at {rate}")
    env.close()


def test_no_friction_acts_between_object_and_hand_that_lets_go():
    env = ManipulationEnv("Placement", "none")
    scene = sample_scene("Placement", "none", 0)
    world = env._cell.world
    rng = np.random.default_rng(6)
    touched = 0
    for _ in range(12):
        env.reset(options={"scene": scene})
        arm = env._cell.arm
        velocity = rng.uniform(-0.5, 0.5, 6)
        velocity[1] = -abs(velocity[1])  # Upwards in the shoulder, away from the table.
        for step in range(30):
            env.step(np.append(velocity * (step < 20), 0.0).astype(np.float32))
        opening = np.array([0, 0, 0, 0, 0, 0, -rng.uniform(0.4, 1.0)])
        while arm.squeezes(arm.state()):
            env.step(opening.astype(np.float32))
        for _ in range(2):
            arm.integrate(opening)
            arm.track()
            arm.release(arm.state())
            for _ in range(SUBSTEPS):
                world.step()
                points = pybullet.getContactPoints(
                    world.body(ARM), world.body("object"), physicsClientId=world.client
                )
                touched += any(point[9] > 0.0 for point in points)
                assert all(point[10] == point[12] == 0.0 for point in points)
    assert touched > 10
    env.close()


def test_the_hand_has_friction_until_it_opens_and_when_it_closes_again(arm):
    body = arm.world.body(ARM)
    hand = [
        link
        for link in range(pybullet.getNumJoints(body, physicsClientId=arm.world.client))
        if arm.world.part(body, link) in HAND_LINKS
    ]

    def frictions():
        return {
            pybullet.getDynamicsInfo(body, link, physicsClientId=arm.world.client)[1]
            for link in hand
        }

    def close(rate):
        for _ in range(5):
            arm.integrate(np.array([0, 0, 0, 0, 0, 0, rate]))
            arm.release(arm.state())
            arm.track()
            for _ in range(SUBSTEPS):
                arm.world.step()

    assert len(hand) == 5
    assert frictions() == {1.0}
    close(-1.0)  # It is open already.
    assert frictions() == {1.0}
    close(1.0)
    assert frictions() == {1.0}
    close(-1.0)
    assert frictions() == {0.0}
    close(0.0)
    assert frictions() == {0.0}
    close(1.0)
    assert frictions() == {1.0}
    close(-1.0)
    arm.set_reference(START_CONFIGURATION, 0.0)
    assert frictions() == {1.0}


def test_fingers_close_as_far_as_the_pen():
    env = ManipulationEnv("DrawS", "none")
    env.reset(seed=0)
    world = env._cell.world
    body = world.body(ARM)
    links = {
        world.part(body, link): link
        for link in range(pybullet.getNumJoints(body, physicsClientId=world.client))
    }
    for _ in range(10):
        env.step(np.array([0.2, 0, 0, 0.5, 0, 0.5, 1.0], np.float32))
    for number in (1, 2):
        points = pybullet.getClosestPoints(
            body,
            body,
            0.05,
            links[f"j2s6s200_link_finger_tip_{number}"],
            links["pen"],
            physicsClientId=world.client,
        )
        assert abs(min(point[8] for point in points)) < 5e-4
    env.close()
