"""What other libraries do with the environments: vectorise, describe, picture and train."""

import json
from functools import cache

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

import smp_gym

IDS = [entry.id for entry in smp_gym.ENVIRONMENTS]
SEEDS = [11, 12]
STEPS = 12
IN_PROCESSES = ["smp_gym/Placement-v0", "smp_gym/PushLiftBoxDense-v0"]
"""Of different tasks, states and rewards: what crosses a process border has no more kinds.

In this process, Gymnasium vectorises the sparse id of each task, stable-baselines3 the dense one.
"""


def moves(env_id):
    """Return (STEPS, 2, 7) actions, the gripper opening, and different ones for the two."""
    rng = np.random.default_rng(len(env_id))
    actions = rng.uniform(-1.0, 1.0, (STEPS, 2, 7)).astype(np.float32)
    actions[..., 6] = -1.0
    return actions


@cache
def alone(env_id, which):
    """Return the observations and rewards of one of the two environments, played by itself."""
    env = gymnasium.make(env_id, difficulty="hard")
    observations, rewards = [env.reset(seed=SEEDS[which])[0]], []
    for action in moves(env_id)[:, which]:
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            break
    env.close()
    return observations, rewards


def assert_as_alone(env_id, batches, rewards):
    """Check batched observations, up to the end of each episode, and their rewards."""
    for which in range(2):
        expected, earned = alone(env_id, which)
        # A vector environment may show the next episode in place of an episode's last observation.
        for step, observation in enumerate(expected[:-1]):
            for key, vector in observation.items():
                np.testing.assert_array_equal(batches[step][key][which], vector)
        # stable-baselines3 hands rewards over as float32.
        got = [reward[which] for reward in rewards[: len(earned)]]
        np.testing.assert_array_equal(np.float32(got), np.float32(earned))


@pytest.mark.parametrize(
    ("env_id", "mode"), [(i, "sync") for i in IDS[::2]] + [(i, "async") for i in IN_PROCESSES]
)
def test_gymnasium_vectorises(env_id, mode):
    env = gymnasium.make_vec(env_id, num_envs=2, vectorization_mode=mode, difficulty="hard")
    assert env.metadata["autoreset_mode"] in AutoresetMode
    observation, info = env.reset(seed=SEEDS)
    batches, rewards = [{k: v.copy() for k, v in observation.items()}], []
    assert info["seed"].tolist() == SEEDS
    for actions in moves(env_id):
        observation, reward, *_ = env.step(actions)
        assert env.observation_space.contains(observation)
        batches.append({k: v.copy() for k, v in observation.items()})
        rewards.append(reward)
    env.close()
    assert_as_alone(env_id, batches, rewards)


@pytest.mark.parametrize(
    ("env_id", "kind"),
    [(i, DummyVecEnv) for i in IDS[1::2]] + [(i, SubprocVecEnv) for i in IN_PROCESSES],
)
def test_stable_baselines3_vectorises(env_id, kind):
    # The module's name lets a new process, too, find the id.
    name = f"smp_gym:{env_id}"
    env = make_vec_env(name, 2, env_kwargs={"difficulty": "hard"}, vec_env_cls=kind)
    # The second environment is seeded with the next number.
    env.seed(SEEDS[0])
    batches, rewards = [env.reset()], []
    for actions in moves(env_id):
        observation, reward, _, _ = env.step(actions)
        batches.append({key: vector.copy() for key, vector in observation.items()})
        rewards.append(reward)
    env.close()
    assert_as_alone(env_id, batches, rewards)


@pytest.mark.parametrize("env_id", IDS)
def test_specifications_go_to_json_and_back(env_id):
    made = gymnasium.make(
        env_id, difficulty="hard", render_mode="rgb_array", camera={"distance": 2.0}, width=64
    )
    text = made.spec.to_json()
    assert json.loads(text)["id"] == env_id
    again = gymnasium.make(EnvSpec.from_json(text))
    assert again.unwrapped.difficulty == "hard"
    assert again.reset(seed=0)[1]["difficulty"] == "hard"
    assert again.render().shape[1] == 64
    made.close()
    again.close()


@pytest.mark.parametrize("env_id", IDS)
def test_hindsight_experience_replay_trains(env_id):
    env = gymnasium.make(env_id, difficulty="none", max_episode_steps=40)
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": env.unwrapped.reward == "dense"},
        policy_kwargs={"net_arch": [16]},
        learning_starts=50,
        buffer_size=1000,
        train_freq=10,
        gradient_steps=2,
        batch_size=32,
        seed=0,
    )
    before = [p.detach().clone() for p in model.actor.parameters()]
    model.learn(100)
    assert model.num_timesteps == 100
    moved = [not p.equal(b) for p, b in zip(model.actor.parameters(), before, strict=True)]
    assert any(moved)
    assert all(bool(p.isfinite().all()) for p in model.policy.parameters())
    env.close()


# Pictures


def picture(**arguments):
    env = gymnasium.make(IDS[0], render_mode="rgb_array", difficulty="none", **arguments)
    env.reset(seed=0)
    image = env.render()
    env.close()
    return image


@pytest.mark.parametrize(("width", "height"), [(64, 48), (50, 90), (333, 77)])
def test_pictures_have_the_size_that_is_asked_for(width, height):
    image = picture(width=width, height=height)
    assert image.shape == (height, width, 3)
    assert image.std() > 5.0


def yellow(image):
    """Return how many pixels show the object."""
    red, green, blue = (image[..., i].astype(int) for i in range(3))
    return int(((red > 120) & (green > 90) & (2 * blue < green)).sum())


def test_the_camera_can_be_moved():
    size = {"width": 160, "height": 120}
    there = {"target": (0.42, -0.4, 0.26)}
    far = picture(camera={**there, "distance": 1.6}, **size)
    near = picture(camera={**there, "distance": 0.8}, **size)
    away = picture(camera={"target": (-3.0, 0.0, 0.2), "yaw": 90.0, "distance": 0.5}, **size)
    assert yellow(near) > 2 * yellow(far) > 0
    assert yellow(away) == 0
    wide = picture(camera={**there, "distance": 0.8, "field_of_view": 90.0}, **size)
    assert yellow(wide) < yellow(near)


def test_the_size_of_pictures_does_not_change_the_episode():
    observations = []
    for arguments in ({}, {"render_mode": "rgb_array", "width": 32, "height": 32}):
        env = gymnasium.make(IDS[0], **arguments)
        env.reset(seed=4)
        for action in moves(IDS[0])[:5, 0]:
            observation = env.step(action)[0]
            if arguments:
                env.render()
        observations.append(observation["observation"])
        env.close()
    np.testing.assert_array_equal(*observations)
