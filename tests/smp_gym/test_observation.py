import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import smp_gym  # noqa: F401
from smp_gym.observation import (
    MAX_EPISODE_STEPS,
    Encoder,
    ObjectState,
    RobotState,
    decode,
    observation_space,
    state_places,
)
from smp_gym.sampling import sample_scene
from smp_gym.scene import TASKS, Goal, ManipulatedObject, Obstacle, Scene

SPACE = observation_space("Placement")


def draw_scene(rng):
    def obstacle(shape):
        a, b = rng.uniform(0.03, 0.06, 2)
        size = {"box": (a, b, a), "cylinder": (a, a, b), "sphere": (a, a, a)}[shape]
        turn = rng.normal(size=4)
        return Obstacle(
            shape=shape,
            position=tuple(rng.uniform(-0.8, 0.8, 3)),
            quaternion=tuple(turn / np.linalg.norm(turn)),
            size=size,
            velocity=tuple(rng.uniform(-1, 1, 3)),
        )

    return Scene(
        task="Placement",
        start=tuple(rng.uniform(-3, 3, 6)),
        manipulated=ManipulatedObject(size=tuple(rng.uniform(0.02, 0.04, 3))),
        goals=(Goal(position=tuple(rng.uniform(0.1, 0.5, 3))),),
        obstacles=tuple(obstacle(s) for s in rng.permutation(["box", "cylinder", "sphere"] * 2)),
    )


def draw(seed, elapsed=0):
    rng = np.random.default_rng(seed)
    scene = draw_scene(rng)
    robot = RobotState(
        configuration=rng.uniform(-3, 3, 6),
        reference=rng.uniform(-3, 3, 6),
        joint_velocity=rng.uniform(-1, 1, 6),
        finger_angles=rng.uniform(0, 1.5, 4),
        gripper_reference=float(rng.uniform()),
        finger_velocity=rng.uniform(-1, 1, 4),
        end_effector_position=rng.uniform(-0.9, 0.9, 3),
        end_effector_quaternion=np.array([0.0, 0.6, 0.0, 0.8]),
    )
    manipulated = ObjectState(
        position=rng.uniform(-0.9, 0.9, 3),
        quaternion=np.array([0.6, 0.0, 0.0, 0.8]),
        linear_velocity=rng.uniform(-1, 1, 3),
        angular_velocity=rng.uniform(-1, 1, 3),
        size=np.asarray(scene.manipulated.size),
    )
    achieved = {
        "object_position": manipulated.position,
        "collided": seed % 2,
        "released": 0.0,
        "at_rest": 1.0,
        "supported": 0.0,
    }
    return scene, robot, manipulated, Encoder(scene).encode(robot, manipulated, achieved, elapsed)


def close(a, b):
    np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_an_observation_says_all_that_it_was_made_from(seed):
    scene, robot, manipulated, observation = draw(seed, elapsed=37 * seed)
    assert SPACE.contains(observation)
    for given in (observation, spaces.flatten(SPACE, observation)):
        decoded = decode(given, "Placement")
        assert decoded.elapsed_steps == 37 * seed
        assert decoded.collided == bool(seed % 2)
        for name, value in vars(robot).items():
            close(getattr(decoded.robot, name), value)
        for name, value in vars(manipulated).items():
            close(getattr(decoded.object, name), value)
        close(decoded.scene.goals[0].position, scene.goals[0].position)
        assert len(decoded.scene.obstacles) == len(scene.obstacles)
        for found, true in zip(decoded.scene.obstacles, scene.obstacles, strict=True):
            assert found.shape == true.shape
            for name in ("position", "quaternion", "size", "velocity"):
                close(getattr(found, name), getattr(true, name))


@pytest.mark.parametrize("elapsed", [0, 1, 199, MAX_EPISODE_STEPS])
def test_the_step_count_survives_float32(elapsed):
    assert decode(draw(0, elapsed)[3], "Placement").elapsed_steps == elapsed


def test_values_beyond_the_bounds_are_clipped_into_them():
    scene, robot, manipulated, _ = draw(0)
    flying = ObjectState(**{**vars(manipulated), "linear_velocity": np.full(3, 1e6)})
    achieved = {
        "object_position": (9, 9, 9),
        "collided": 0,
        "released": 0,
        "at_rest": 0,
        "supported": 0,
    }
    assert SPACE.contains(Encoder(scene).encode(robot, flying, achieved, 0))


def changed(key, index, value):
    observation = {k: v.copy() for k, v in draw(0)[3].items()}
    observation[key][index] = value
    return observation


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        (changed("observation", 3, np.nan), "observation"),
        (changed("obstacles", 0, 4.0), "obstacles"),
        (changed("desired_goal", 5, -3.0), "normalised"),
        (changed("desired_goal", 4, 0.0), "demand what Placement demands"),
        (changed("observation", slice(31, 34), 0.5), "quaternion of norm 1"),
        (changed("observation", -2, 0.001), "whole number of steps"),
        (changed("observation", -1, 0.5), "index as control"),
        (changed("observation", state_places("supports").start, 0.5), "supports where"),
        (changed("obstacles", 1, 0.5), "one shape"),
        (changed("obstacles", slice(1, 4), 1.0), "one shape"),
        (changed("obstacles", slice(0, 4), 0.0), "not present"),
        ({"pixels": np.zeros(3)}, "achieved_goal"),
        ({**draw(0)[3], "obstacles": np.zeros(5)}, "shape"),
        (np.zeros(12), "flat vector"),
        ("hello", "flat vector"),
        (None, "flat vector"),
    ],
)
def test_what_is_no_observation_of_ours_is_refused(bad, named):
    with pytest.raises(ValueError, match=named):
        decode(bad, "Placement")


@pytest.mark.parametrize("task", TASKS)
def test_normalised_observations_are_refused(task):
    env = DummyVecEnv([lambda: gymnasium.make(f"smp_gym/{task}-v0", difficulty="easy")])
    scene = sample_scene(task, "easy", 0)
    for keys in (None, ["observation"], ["achieved_goal", "desired_goal"], ["obstacles"]):
        normalised = VecNormalize(env, norm_obs_keys=keys)
        normalised.set_options({"scene": scene})
        batch = normalised.reset()
        for _ in range(4):
            with pytest.raises(ValueError, match="normalised"):
                decode({key: vector[0] for key, vector in batch.items()}, task)
            batch, *_ = normalised.step(np.full((1, 7), 0.1))
        original = normalised.get_original_obs()
        assert decode({key: vector[0] for key, vector in original.items()}, task).scene
    env.close()


def test_an_unknown_task_lists_what_exists():
    with pytest.raises(ValueError, match="Placement"):
        observation_space("Juggling")
