"""The control mode `end_effector`: where the hand goes, and what it may not ask of the joints."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from scipy.spatial.transform import Rotation

from smp_gym.control import ANGULAR_SPEED, LINEAR_SPEED, joint_action
from smp_gym.env import ManipulationEnv
from smp_gym.observation import CONTROL_PERIOD, CONTROLS, GRIPPER_RATE, decode
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, JOINT_VELOCITY
from smp_gym.sampling import sample_scene
from smp_gym.scene import TASKS
from smp_gym.tasks.placement.rules import START_CONFIGURATION

START = np.array(START_CONFIGURATION)


def follow(action, steps, q=START):
    """Return the configurations that a constant action leads through."""
    path = [np.array(q)]
    for _ in range(steps):
        moved = joint_action(action, path[-1])
        path.append(np.clip(path[-1] + moved[:6] * JOINT_VELOCITY * CONTROL_PERIOD, -7, 7))
    return np.array(path)


def unit(axis, sign, length=1.0):
    action = np.zeros(7)
    action[axis] = sign * length
    return action


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("axis", range(3))
def test_the_hand_moves_straight_and_keeps_its_orientation(axis, sign):
    steps = 8
    poses = kinematics.end_effector_pose(follow(unit(axis, sign), steps))
    way = poses[-1, :3, 3] - poses[0, :3, 3]
    expected = np.zeros(3)
    expected[axis] = sign * steps * LINEAR_SPEED * CONTROL_PERIOD
    np.testing.assert_allclose(way, expected, atol=2e-3)
    turn = Rotation.from_matrix(poses[-1, :3, :3] @ poses[0, :3, :3].T)
    assert turn.magnitude() < 0.01


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("axis", range(3))
def test_the_hand_turns_on_the_spot(axis, sign):
    steps = 6
    poses = kinematics.end_effector_pose(follow(unit(3 + axis, sign, 0.5), steps))
    turn = Rotation.from_matrix(poses[-1, :3, :3] @ poses[0, :3, :3].T).as_rotvec()
    expected = np.zeros(3)
    expected[axis] = sign * steps * 0.5 * ANGULAR_SPEED * CONTROL_PERIOD
    np.testing.assert_allclose(turn, expected, atol=0.01)
    np.testing.assert_allclose(poses[-1, :3, 3], poses[0, :3, 3], atol=2e-3)


def test_small_motions_follow_the_jacobian():
    """Independent of the solver: the joint velocities, by finite differences, give the motion."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = START + rng.uniform(-0.3, 0.3, 6)
        action = np.append(0.05 * rng.uniform(-1, 1, 6), 0.0)
        dq = joint_action(action, q)[:6] * JOINT_VELOCITY
        before, after = kinematics.end_effector_pose(np.stack([q, q + 1e-6 * dq]))
        linear = (after - before)[:3, 3] / 1e-6
        angular = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / 1e-6
        np.testing.assert_allclose(linear, action[:3] * LINEAR_SPEED, atol=1e-3)
        np.testing.assert_allclose(angular, action[3:6] * ANGULAR_SPEED, atol=4e-3)


def test_limits_of_joints_and_of_their_velocities_hold_everywhere():
    """Also stretched out, folded up, with joints at their limits, and near singularities."""
    rng = np.random.default_rng(1)
    configurations = rng.uniform(JOINT_LOWER, JOINT_UPPER, (300, 6))
    at_limit = rng.random((300, 6)) < 0.2
    configurations = np.where(at_limit, JOINT_UPPER, configurations)
    at_limit = rng.random((300, 6)) < 0.2
    configurations = np.where(at_limit, JOINT_LOWER, configurations)
    configurations[0] = [0.0, np.pi, np.pi, 0.0, np.pi, 0.0]
    for q in configurations:
        action = rng.choice([-1.0, 1.0], 7)
        moved = joint_action(action, q)
        assert np.isfinite(moved).all()
        assert np.abs(moved).max() <= 1.0
        after = q + moved[:6] * JOINT_VELOCITY * CONTROL_PERIOD
        assert (after >= JOINT_LOWER - 1e-12).all()
        assert (after <= JOINT_UPPER + 1e-12).all()
        assert moved[6] == action[6]


def test_out_of_reach_the_arm_stretches_and_comes_to_rest():
    path = follow(unit(0, 1.0), 200)
    late = np.abs(np.diff(path[-20:], axis=0)) / CONTROL_PERIOD
    assert late.max() < 0.2
    reach = np.linalg.norm(kinematics.end_effector_pose(path[-1])[:3, 3])
    assert reach > np.linalg.norm(kinematics.end_effector_pose(START)[:3, 3]) + 0.1


def test_nothing_moves_without_an_action():
    np.testing.assert_array_equal(joint_action(np.zeros(7), START), np.zeros(7))


def test_the_environment_moves_the_hand_along_the_base_frame():
    env = ManipulationEnv(difficulty="none", control="end_effector")
    observation, _ = env.reset(seed=0)
    first = decode(observation, "Placement").robot
    up = np.array([0, 0, 1, 0, 0, 0, -0.1], np.float32)
    for _ in range(10):
        observation, _, terminated, _, info = env.step(up)
    last = decode(observation, "Placement").robot
    assert not terminated
    assert not info["collided"]
    moved = last.end_effector_position - first.end_effector_position
    # The arm follows its reference in the course of a step.
    np.testing.assert_allclose(moved, (0, 0, 10 * LINEAR_SPEED * CONTROL_PERIOD), atol=4e-3)
    opened = first.gripper_reference - last.gripper_reference
    assert opened == pytest.approx(10 * 0.1 * GRIPPER_RATE * CONTROL_PERIOD, abs=1e-6)
    env.close()


def test_joint_velocities_are_the_default():
    env = gymnasium.make("smp_gym/Placement-v0")
    assert env.unwrapped.control == "joint_velocity"
    env.reset(seed=0)
    before = env.unwrapped._cell.arm.reference
    action = np.array([0.1, 0.2, 0.3, -0.4, 0.5, -0.6, 0.0], np.float32)
    env.step(action)
    moved = env.unwrapped._cell.arm.reference - before
    np.testing.assert_allclose(moved, action[:6] * JOINT_VELOCITY * CONTROL_PERIOD, atol=1e-12)
    env.close()


def test_a_state_can_be_restored_in_either_mode():
    scene = sample_scene("Placement", "easy", 3)
    moves = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 7))
    envs = [ManipulationEnv(control=mode) for mode in ("end_effector", "joint_velocity")]
    envs[0].reset(options={"scene": scene})
    for action in moves:
        observation = envs[0].step(action)[0]
    state = envs[0].save_state()
    for env in envs:
        restored, _ = env.restore_state(state)
        # The last entry says which mode it is.
        np.testing.assert_array_equal(restored["observation"][:-1], observation["observation"][:-1])
        env.close()


@pytest.mark.parametrize("task", TASKS)
def test_the_observation_says_which_mode_it_is(task):
    for control in CONTROLS:
        env = ManipulationEnv(task=task, difficulty="none", control=control)
        observations = [env.reset(seed=0)[0], env.step(np.zeros(7, np.float32))[0]]
        env.close()
        for observation in observations:
            assert env.observation_space.contains(observation)
            for given in (observation, spaces.flatten(env.observation_space, observation)):
                assert decode(given, task).control == control


def test_an_unknown_mode_is_refused():
    with pytest.raises(ValueError, match="joint_velocity, end_effector; got 'torque'"):
        ManipulationEnv(control="torque")
