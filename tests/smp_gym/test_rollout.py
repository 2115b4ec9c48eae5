"""The episode loop: what policies and recorders see, against a loop written out here."""

import gymnasium
import numpy as np
import pytest

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.control import reference_action
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import CONTROL_PERIOD, STATE_LAYOUT, decode, state_field
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_gym.rollout import (
    FieldRecorder,
    FrameRecorder,
    Waypoints,
    play,
    rollout,
)
from smp_gym.sampling import sample_scene


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("smp_gym/Placement-v0")
    yield made
    made.close()


class Counting:
    """Drives a joint, and remembers what it was called with."""

    def __init__(self, joint=0):
        self.action = np.zeros(7, np.float32)
        self.action[joint] = 1.0
        self.calls = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls.append((state, bool(episode_start[0]), deterministic))
        return self.action, 10 if state is None else state + 1


def test_an_episode_is_that_of_a_plain_loop(env):
    scene = sample_scene("Placement", "medium", 3)
    observation, info = env.reset(options={"scene": scene})
    policy = Counting(joint=1)
    observations, rewards, over = [observation], [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.action)
        observations.append(observation)
        rewards.append(reward)
        over = terminated or truncated
    assert info["collided"]
    moments = []
    played = rollout(env, policy, scene=scene, recorders=(moments.append,))
    assert played.steps == len(rewards)
    assert played.reward == sum(rewards)
    assert played.info == info
    assert played.success is False
    assert [moment.reward for moment in moments[1:]] == rewards
    for moment, expected in zip(moments, observations, strict=True):
        for key, vector in expected.items():
            np.testing.assert_array_equal(moment.observation[key], vector)
    assert played.first is moments[0].observation
    assert played.last is moments[-1].observation
    assert [moment.step for moment in moments] == list(range(played.steps + 1))
    assert moments[-1].terminated
    assert not any(moment.terminated or moment.truncated for moment in moments[:-1])


def test_a_policy_gets_back_its_state_and_is_told_where_an_episode_starts(env):
    policy = Counting()
    played = rollout(env, policy, seed=0, steps=3, deterministic=False)
    assert policy.calls == [(None, True, False), (10, False, False), (11, False, False)]
    assert (played.steps, played.state) == (3, 12)


def test_a_seed_draws_its_scene(env):
    rollout(env, Counting(), seed=4, steps=0)
    assert env.unwrapped.scene == sample_scene("Placement", "medium", 4)


def test_recorders_see_each_moment_once():
    env = gymnasium.make("smp_gym/DrawS-v0", render_mode="rgb_array", width=32, height=24)
    frames, reference = FrameRecorder(), FieldRecorder("reference")
    rollout(env, Counting(joint=5), seed=0, steps=2, recorders=(frames, reference))
    assert [frame.shape for frame in frames.frames] == [(24, 32, 3)] * 3
    moved = np.zeros((3, 6))
    moved[:, 5] = JOINT_VELOCITY[5] * CONTROL_PERIOD * np.arange(3)
    np.testing.assert_allclose(reference.values - reference.values[0], moved, atol=1e-6)
    env.close()
    blind = FrameRecorder()
    env = gymnasium.make("smp_gym/DrawS-v0")
    rollout(env, Counting(), seed=0, steps=1, recorders=(blind,))
    env.close()
    assert blind.frames == []


def test_fields_are_what_decoding_gives(env):
    observation, _ = env.reset(seed=1)
    decoded = decode(observation, "Placement")
    for field in STATE_LAYOUT:
        state = {
            **vars(decoded.robot),
            **{f"object_{name}": value for name, value in vars(decoded.object).items()},
        }
        if field.name in state:
            np.testing.assert_array_equal(state_field(observation, field.name), state[field.name])
    with pytest.raises(KeyError, match="colour"):
        state_field(observation, "colour")


def test_an_action_leads_the_reference_to_its_target_or_as_far_as_it_may(env):
    reference = np.zeros(6)
    near = reference_action(0.5 * CONTROL_PERIOD * JOINT_VELOCITY, reference, -1.0)
    np.testing.assert_allclose(near, [0.5] * 6 + [-1.0], rtol=1e-6)
    assert near.dtype == np.float32
    np.testing.assert_array_equal(reference_action(np.ones(6), reference, 0.0), [1] * 6 + [0])


@pytest.mark.parametrize("grasp", [None, 120])
def test_waypoints_pass_a_trajectory_within_the_limits_and_wait(grasp):
    trajectory = Demonstrations.load("Placement").configurations[0]
    waypoints = Waypoints.along(trajectory, grasp=grasp)
    passed = np.concatenate([trajectory[:1], waypoints.configurations])
    speed = np.abs(np.diff(passed, axis=0)) / CONTROL_PERIOD / JOINT_VELOCITY
    assert 0.85 < speed.max() < 0.91
    np.testing.assert_array_equal(waypoints.configurations[-1], trajectory[-1])
    still = (speed == 0.0).all(axis=1)
    if grasp is None:
        assert still.sum() == 59
        assert waypoints.gripper[still].tolist() == [-1.0] * 59
        assert set(waypoints.gripper[~still]) == {0.0}
    else:
        assert still.sum() == 30
        assert (np.diff(waypoints.gripper) >= 0.0).all()
        assert np.abs(waypoints.configurations[still][0] - trajectory[grasp]).max() < 0.02


def test_a_demonstration_is_played_as_far_as_it_goes(env):
    shipped = Demonstrations.load("Placement")
    half = shipped.configurations[0][:60]
    info = play(env, shipped.scenes[0], half)
    assert not info["is_success"]
    assert info["failure"] in ("dropped", "misplaced", "collision")
    info = play(env, shipped.scenes[0], shipped.configurations[0], duration=shipped.durations[0])
    assert info["is_success"]
