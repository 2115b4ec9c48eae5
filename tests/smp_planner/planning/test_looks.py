"""Looks at obstacles with errors of their own, put together."""

import numpy as np
import pytest

from smp_gym.scene import Obstacle, Scene
from smp_gym.sensing.sensors import LOOK_SHARE, NoisySensor
from smp_planner.planning.forecasting import SURPRISE, Looks, surprising

PERIOD, NOISE, STEPS = 0.05, 0.03, 60
SINGLE = NOISE * np.sqrt(LOOK_SHARE)
STAYING = NOISE * np.sqrt(1.0 - LOOK_SHARE)


def ball(x, y=0.0, velocity=(0.0, 0.0, 0.0)):
    position = (float(x), float(y), 0.4)
    return Obstacle(shape="sphere", position=position, size=(0.05,) * 3, velocity=velocity)


def places(obstacles):
    return np.array([obstacle.position for obstacle in obstacles])


def together(looks):
    found = [Looks.first(looks[0])]
    for look in looks[1:]:
        found.append(found[-1].then(look, PERIOD))
    return found


@pytest.fixture(scope="module")
def series():
    """Looks at eight balls that stand, and errors (scene, step, ball, axis) of what they say."""
    true = tuple(ball(0.1 * i) for i in range(8))
    sensor, found, errors = NoisySensor(NOISE), [], []
    for seed in range(20):
        sensor.begin(
            Scene(
                task="Placement",
                seed=seed,
                start=(0.0,) * 6,
                goals=({"position": (0.4, 0.4, 0.02)},),
                obstacles=true,
            )
        )
        looks = together([sensor.perceive(true, None, step) for step in range(STEPS)])
        found.append(looks)
        errors.append([places(look.obstacles) - places(true) for look in looks])
    return found, np.array(errors)


def test_the_mean_of_looks_converges_to_what_they_have_in_common(series):
    _, errors = series
    for n in (1, 4, STEPS):
        expected = np.sqrt(STAYING**2 + SINGLE**2 / n)
        # 480 numbers: their deviation is known to 3.2 %.
        assert abs(errors[:, n - 1].std() / expected - 1.0) < 0.12
    # Of the mean of n looks and that of these and others, m in all, 1 / n - 1 / m differs.
    moved = (errors[:, 29] - errors[:, -1]).std()
    assert abs(moved / (SINGLE * np.sqrt(1.0 / 30 - 1.0 / STEPS)) - 1.0) < 0.1


def test_the_noise_of_a_look_is_found_from_their_changes(series):
    found, _ = series
    assert np.mean([looks[1].deviation for looks in found]) == pytest.approx(SINGLE, rel=0.1)
    for looks in found:
        assert looks[-1].deviation == pytest.approx(SINGLE, rel=0.15)


def test_the_doubt_is_how_far_off_the_mean_is(series):
    """The sensor's two parts are about equal, as is taken for granted of what is not known."""
    found, errors = series
    for n in (4, 12, STEPS):
        said = np.mean([looks[n - 1].doubt for looks in found])
        assert said == pytest.approx(errors[:, n - 1].std(), rel=0.2)
    exact = together([(ball(0.1), ball(0.2))] * 5)
    assert [looks.doubt for looks in exact] == [0.0] * 5


def test_noise_alone_is_no_surprise(series):
    found, errors = series
    for looks, error in zip(found, errors, strict=True):
        np.testing.assert_array_equal(
            [look.count for look in looks[1::20]], [[2] * 8, [22] * 8, [42] * 8]
        )
        for first in (0, 1, 10):
            for look, now in zip(looks[first:], error[first:], strict=True):
                away = np.linalg.norm(now - error[first], axis=1)
                variances = 1.0 / looks[first].count + 1.0 / look.count
                assert not surprising(away, look.deviation, variances).any()
    # It would be one if noise were not known.
    first, last = errors[:, 0], errors[:, -1]
    assert (np.linalg.norm(last - first, axis=-1) > SURPRISE).any(axis=1).all()


def test_exact_looks_are_taken_as_they_are():
    still = (ball(0.1), ball(0.2))
    looks = together([still] * 5)
    assert looks[-1].obstacles == still
    assert looks[-1].deviation == 0.0
    # One that was moved unseen is where it is now, at once; noise is not why.
    moved = (ball(0.1), ball(0.2 + 2.0 * SURPRISE))
    after = looks[-1].then(moved, PERIOD)
    assert after.obstacles == moved
    assert after.count.tolist() == [6, 1]
    assert after.deviation == 0.0


def test_what_moves_is_where_the_last_look_has_it_until_it_stands():
    path = [ball(0.1 * PERIOD * k, velocity=(0.1, 0.0, 0.0)) for k in range(6)]
    looks = together([(ball(1.0), body) for body in path])
    assert all(look.obstacles[1] is look.last[1] for look in looks)
    assert looks[-1].count.tolist() == [6, 1]
    assert looks[-1].deviation < 1e-12
    halted = looks[-1].then((ball(1.0), ball(0.0275)), PERIOD)
    assert halted.obstacles[1].position[0] == 0.0275
    assert halted.then((ball(1.0), ball(0.0275)), PERIOD).count.tolist() == [8, 2]


def test_a_move_within_the_noise_is_forgotten():
    """The weight of a new look stays: what was moved a little is found where it is in the end."""
    rng = np.random.default_rng(0)

    def look(x):
        return tuple(ball(x, i + error) for i, error in enumerate(rng.normal(0.0, 0.02, 8)))

    looks = Looks.first(look(0.0))
    for _ in range(300):
        looks = looks.then(look(0.0), PERIOD)
    for _ in range(300):
        looks = looks.then(look(0.04), PERIOD)
    np.testing.assert_allclose(places(looks.obstacles)[:, 0], 0.04, atol=0.001)


def test_without_obstacles_there_is_nothing_to_say():
    looks = together([()] * 3)[-1]
    assert looks.obstacles == ()
    assert looks.deviation == 0.0
