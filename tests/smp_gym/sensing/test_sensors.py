"""Sensing with errors of rows: their statistics, their replay, and what is refused."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import smp_gym  # noqa: F401
from smp_gym.observation import SENSINGS, decode
from smp_gym.scene import Obstacle, Scene
from smp_gym.sensing.sensors import DEFAULT_NOISE, LOOK_SHARE, SIZE_ERROR, NoisySensor

PLACEMENT = "smp_gym/Placement-v0"
TURN = (0.0, 0.0, 0.6, 0.8)


def scene(seed):
    sizes = {"box": (0.03, 0.05, 0.04), "cylinder": (0.04, 0.04, 0.06), "sphere": (0.05,) * 3}
    obstacles = tuple(
        Obstacle(shape=shape, position=(0.5, 0.1 * i, 0.3), quaternion=TURN, size=size)
        for i, (shape, size) in enumerate(sizes.items())
    )
    return Scene(
        task="Placement",
        seed=seed,
        start=(0.0,) * 6,
        goals=({"position": (0.4, 0.4, 0.02)},),
        obstacles=obstacles,
    )


LOOKS = (0, 1, 7, 199, 200, 411)


@pytest.fixture(scope="module")
def errors():
    """Errors of positions (scene, look, obstacle, axis) and factors of sizes, of 400 scenes."""
    sensor, shifts, factors = NoisySensor(0.03), [], []
    for seed in range(400):
        true = scene(seed).obstacles
        sensor.begin(scene(seed))
        looks = [sensor.perceive(true, None, step) for step in LOOKS]
        places = np.array([[o.position for o in look] for look in looks])
        sizes = np.array([[o.size for o in look] for look in looks])
        shifts.append(places - [o.position for o in true])
        factors.append(sizes / [o.size for o in true])
    return np.array(shifts), np.array(factors)


def test_errors_of_each_look_have_the_stated_distribution(errors):
    shifts, factors = errors
    # 3600 normal numbers each: the deviation is known to 1.2 %, the mean to 0.5 mm.
    np.testing.assert_allclose(shifts.std(axis=(0, 2, 3)) / 0.03, 1.0, atol=0.05)
    assert np.abs(shifts.mean(axis=(0, 1))).max() < 0.004
    np.testing.assert_allclose(factors, factors[..., :1].repeat(3, axis=-1))
    one = factors[..., 0]
    assert np.abs(one - 1.0).max() <= SIZE_ERROR
    # Of a uniform number in an interval 2 a wide, the deviation is a / sqrt(3).
    assert abs(one.std() / (SIZE_ERROR / np.sqrt(3)) - 1.0) < 0.1
    # Errors of different obstacles and axes have nothing to do with each other.
    correlation = np.corrcoef(shifts[:, 0].reshape(400, 9).T)
    assert np.abs(correlation - np.eye(9)).max() < 0.2


def test_errors_of_two_looks_have_one_part_in_common(errors):
    shifts, factors = errors
    looks = shifts.swapaxes(0, 1).reshape(len(LOOKS), -1)
    expected = np.where(np.eye(len(LOOKS), dtype=bool), 1.0, 1.0 - LOOK_SHARE)
    # 3600 pairs: a correlation of a half is known to 0.0125.
    np.testing.assert_allclose(np.corrcoef(looks), expected, atol=0.06)
    mean = looks.mean(axis=0)
    left = 0.03 * np.sqrt(1.0 - LOOK_SHARE + LOOK_SHARE / len(LOOKS))
    assert abs(mean.std() / left - 1.0) < 0.05
    np.testing.assert_array_equal(factors, factors[:, :1].repeat(len(LOOKS), axis=1))


def test_a_look_depends_on_scene_and_step_alone():
    true, sensor = scene(3).obstacles, NoisySensor(0.03)
    sensor.begin(scene(3))
    forwards = {step: sensor.perceive(true, None, step) for step in LOOKS}
    sensor.begin(scene(4))
    assert sensor.perceive(true, None, 0) != forwards[0]
    sensor.begin(scene(3))
    for step in reversed(LOOKS):
        assert sensor.perceive(true, None, step) == forwards[step]
    # Elsewhere and in motion, obstacles are perceived with the same errors.
    moved = tuple(
        o.model_copy(
            update={"position": tuple(np.add(o.position, (0.1, 0, -0.1))), "velocity": (0.1, 0, 0)}
        )
        for o in true
    )
    for there, here in zip(sensor.perceive(moved, None, 7), forwards[7], strict=True):
        np.testing.assert_allclose(
            np.subtract(there.position, here.position), (0.1, 0.0, -0.1), atol=1e-12
        )
        assert (there.size, there.quaternion) == (here.size, here.quaternion)
        assert there.velocity == (0.1, 0.0, 0.0)


def test_the_truth_stays_in_the_physics_and_every_replay_perceives_the_same():
    noisy = gymnasium.make(PLACEMENT, difficulty="easy", sensing="noise", noise=0.03)
    exact = gymnasium.make(PLACEMENT, difficulty="easy")
    seen, _ = noisy.reset(seed=3)
    true, _ = exact.reset(seed=3)
    assert noisy.unwrapped.scene == exact.unwrapped.scene
    for key in ("observation", "achieved_goal", "desired_goal"):
        np.testing.assert_array_equal(seen[key], true[key])
    cell = noisy.unwrapped._cell
    perceived = decode(seen, "Placement").scene.obstacles
    for name, obstacle, row in zip(
        cell.world.obstacles, exact.unwrapped.scene.obstacles, perceived, strict=True
    ):
        np.testing.assert_allclose(cell.world.pose(name)[0], obstacle.position, atol=1e-12)
        assert 0.0 < np.linalg.norm(np.subtract(row.position, obstacle.position)) < 0.15
    still = np.zeros(7, np.float32)
    looks = [noisy.step(still)[0]["obstacles"] for _ in range(3)]
    assert not np.array_equal(looks[0], looks[1])
    noisy.reset(seed=4)
    again, _ = noisy.reset(options={"scene": exact.unwrapped.scene})
    np.testing.assert_array_equal(again["obstacles"], seen["obstacles"])
    for look in looks:
        np.testing.assert_array_equal(noisy.step(still)[0]["obstacles"], look)
    noisy.close()
    exact.close()


@pytest.mark.parametrize("sensing", SENSINGS)
def test_both_libraries_check_the_environment(sensing, recwarn):
    env = gymnasium.make(PLACEMENT, difficulty="easy", sensing=sensing)
    check_env(env.unwrapped, skip_render_check=True)
    sb3_check_env(env.unwrapped, warn=True)
    env.close()
    assert not [str(w.message) for w in recwarn if "gymnasium" in str(w.filename)]


@pytest.mark.parametrize("sensing", ["noise", "depth"])
def test_a_saved_state_is_restored_bit_for_bit(sensing):
    env = gymnasium.make(PLACEMENT, difficulty="easy", sensing=sensing).unwrapped
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.3, 0.3, (12, 7)).astype(np.float32)
    env.reset(seed=5)
    for action in actions[:6]:
        env.step(action)
    state = env.save_state()
    first = [env.step(action)[0] for action in actions[6:]]
    env.reset(seed=6)
    env.restore_state(state)
    for action, expected in zip(actions[6:], first, strict=True):
        observation = env.step(action)[0]
        for key, vector in expected.items():
            np.testing.assert_array_equal(observation[key], vector)
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sensing": "sonar"}, "sensing must be one of exact, noise, depth; got 'sonar'"),
        ({"sensing": "noise", "noise": -0.01}, "noise must be finite and not negative.*-0.01"),
        ({"sensing": "noise", "noise": float("nan")}, "noise must be finite.*nan"),
        ({"sensing": "noise", "noise": float("inf")}, "noise must be finite.*inf"),
        ({"sensing": "noise", "noise": "much"}, "noise must be a number of metres, got 'much'"),
        ({"sensing": "noise", "noise": True}, "noise must be a number of metres, got True"),
        ({"noise": 0.02}, "noise goes with sensing='noise' only, got 0.02 and 'exact'"),
        ({"sensing": "depth", "noise": 0.0}, "noise goes with sensing='noise' only"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        gymnasium.make(PLACEMENT, **arguments)


def test_noise_has_a_default():
    assert gymnasium.make(PLACEMENT, sensing="noise").unwrapped.noise == DEFAULT_NOISE
