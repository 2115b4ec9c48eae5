"""Motions with velocities at the ends, limits of jerk and a pace, by differences of samples."""

import sys

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from smp_planner.library.smp import Robot

VELOCITY = np.array([1.5, 0.8])
ACCELERATION = np.array([2.0, 2.5])
JERK = np.array([15.0, 30.0])
LINE = np.linspace(-1.0, 1.0, 60)
BEND = np.stack([LINE, 0.4 * np.sin(2.0 * (LINE + 1.0))], axis=1)
CORNER = np.concatenate(
    [np.linspace((0.0, 0.0), (0.8, 0.0), 25), np.linspace((0.8, 0.0), (0.8, 0.6), 25)[1:]]
)
BACK = np.concatenate([BEND[:30], BEND[28::-1]])
ENDS = [(0.0, 0.0), (0.5, 0.0), (0.0, 0.4), (0.5, 0.4)]


@pytest.fixture(scope="module")
def arm(planar):
    given = {name: getattr(planar, name) for name in planar.__dataclass_fields__}
    return Robot(type(planar)(**{**given, "velocity": VELOCITY}), ("shoulder", "elbow"))


def length_of(path):
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))


def check_limits(motion, acceleration, jerk=None, ends=(0.0, 0.0)):
    """Check the limits by differences of positions, and that the derivatives are theirs."""
    step = motion.times[1]
    np.testing.assert_allclose(np.diff(motion.times), step)
    velocity = np.diff(motion.positions, axis=0) / step
    assert (np.abs(velocity) <= VELOCITY * (1.0 + 1e-6)).all()
    assert (np.abs(np.diff(velocity, axis=0)) / step <= acceleration * (1.0 + 1e-4)).all()
    middle = 0.5 * (motion.velocities[1:] + motion.velocities[:-1])
    np.testing.assert_allclose(velocity, middle, atol=acceleration.max() * step)
    np.testing.assert_allclose(
        np.linalg.norm(motion.velocities[[0, -1]], axis=1), ends, rtol=1e-6, atol=1e-9
    )
    if jerk is not None:
        assert (np.abs(np.diff(velocity, n=2, axis=0)) / step**2 <= jerk * (1.0 + 1e-3)).all()
        found = np.diff(motion.accelerations, axis=0) / step
        assert (np.abs(found) <= jerk * (1.0 + 1e-6)).all()


def check_path(motion, path):
    """Check that all positions lie on the spline through the samples."""
    length = length_of(path)
    fine = CubicSpline(length, path)(np.linspace(0.0, length[-1], 200_001))
    near = [np.linalg.norm(fine - position, axis=1).min() for position in motion.positions[::97]]
    assert max(near) < 1e-5
    np.testing.assert_allclose(motion.positions[[0, -1]], path[[0, -1]], atol=1e-9)


def double_s(distance, velocity, acceleration, jerk):
    """Return the least time from rest to rest along a line, of seven pieces of equal jerk."""

    def gaining(top):
        if top * jerk < acceleration**2:
            return 2.0 * np.sqrt(top / jerk)
        return top / acceleration + acceleration / jerk

    if distance >= velocity * gaining(velocity):
        return distance / velocity + gaining(velocity)
    tops = np.linspace(0.0, velocity, 1_000_001)[1:]
    gains = np.where(
        tops * jerk < acceleration**2,
        2.0 * np.sqrt(tops / jerk),
        tops / acceleration + acceleration / jerk,
    )
    return 2.0 * gains[np.searchsorted(tops * gains, distance)]


@pytest.mark.parametrize(
    ("distance", "jerk", "samples"),
    [(0.02, 5.0, 50), (0.02, 100.0, 2), (0.2, 10.0, 2), (1.6, 5.0, 2), (1.6, 100.0, 50)],
)
def test_along_a_line_a_limit_of_jerk_takes_as_long_as_seven_pieces(arm, distance, jerk, samples):
    path = np.linspace(0.0, 1.0, samples)[:, None] * [0.0, distance]
    motion = arm.timed(path, 2.0, jerk=jerk, rate=1e4)
    fastest = double_s(distance, VELOCITY[1], 2.0, jerk)
    assert fastest * (1.0 - 1e-6) <= motion.duration <= fastest * 1.01 + 1e-4


@pytest.mark.parametrize(
    ("path", "ends"),
    [
        (BEND, ENDS[1]),
        (BEND[::-1], ENDS[2]),
        (CORNER, ENDS[0]),
        (CORNER, ENDS[3]),
        (BACK, ENDS[0]),
        (BACK, ENDS[3]),
        (BEND[[0, -1]], ENDS[1]),
    ],
)
def test_limits_of_jerk_hold_and_the_path_is_kept(arm, path, ends):
    motion = arm.timed(
        path,
        ACCELERATION,
        jerk=JERK,
        rate=1000.0,
        start_velocity=ends[0],
        end_velocity=ends[1],
    )
    check_limits(motion, ACCELERATION, JERK, ends)
    check_path(motion, path)
    unlimited = arm.timed(
        path, ACCELERATION, rate=1000.0, start_velocity=ends[0], end_velocity=ends[1]
    )
    assert unlimited.duration <= motion.duration


@pytest.mark.parametrize("ends", ENDS[1:])
@pytest.mark.parametrize("path", [BEND, CORNER, BACK])
def test_velocities_at_the_ends_are_kept(arm, path, ends):
    motion = arm.timed(
        path, ACCELERATION, rate=1000.0, start_velocity=ends[0], end_velocity=ends[1]
    )
    check_limits(motion, ACCELERATION, ends=ends)
    check_path(motion, path)
    assert motion.duration < arm.timed(path, ACCELERATION, rate=1000.0).duration


def test_a_motion_goes_on_from_where_another_one_was(arm):
    whole = arm.timed(BEND, ACCELERATION, rate=1000.0)
    cut = np.searchsorted(whole.phases, 20 / 59)
    # A little less: at its limits it could not begin where rounding puts it beyond them.
    velocity = 0.99 * whole.velocities[cut]
    rest = arm.timed(BEND[20:], ACCELERATION, rate=1000.0, start_velocity=velocity)
    np.testing.assert_allclose(rest.velocities[0], velocity, atol=5e-3)
    # Both are the fastest from here on.
    assert rest.duration == pytest.approx(whole.duration - whole.times[cut], abs=0.02)


@pytest.mark.parametrize(
    ("jerk", "ends"), [(None, ends) for ends in ENDS] + [(JERK, ENDS[0]), (JERK, ENDS[3])]
)
def test_a_duration_is_kept_with_the_velocities_at_the_ends(arm, jerk, ends):
    options = {"jerk": jerk, "start_velocity": ends[0], "end_velocity": ends[1], "rate": 1000.0}
    for duration in (3.0, 30.0):
        motion = arm.timed(BEND, ACCELERATION, duration=duration, **options)
        assert motion.duration == pytest.approx(duration, rel=1e-9)
        check_limits(motion, ACCELERATION, jerk, ends)
    with pytest.raises(ValueError, match=r"duration must be at least [12]\.\d+ s for this path"):
        arm.timed(BEND, ACCELERATION, **{**options, "duration": 0.5})


def test_a_short_path_between_velocities_cannot_take_long(arm):
    """From 0.7 rad/s along 0.1 rad to the same: braking and gaining again takes its length."""
    path = np.linspace(0.0, 1.0, 20)[:, None] * [0.0, 0.1]
    least = np.sqrt(0.7**2 - 2.0 * 2.0 * 0.05)
    longest = 2.0 * (0.7 - least) / 2.0
    options = {"start_velocity": [0.0, 0.7], "end_velocity": 0.7}
    with pytest.raises(ValueError, match=r"duration must be at most (0\.\d+) s") as caught:
        arm.timed(path, 2.0, duration=1.0, **options)
    said = float(str(caught.value).split("at most ")[1].split()[0])
    assert said == pytest.approx(longest, rel=0.01)
    motion = arm.timed(path, 2.0, duration=0.99 * said, rate=1000.0, **options)
    check_limits(motion, np.array([2.0, 2.0]), ends=(0.7, 0.7))
    with pytest.raises(ValueError, match=r"duration must be at most 0\.\d+ s"):
        arm.timed(path, 2.0, duration=1.0, jerk=100.0, **options)


def test_speed_is_a_share_of_all_limits(arm):
    fast = arm.timed(BEND, ACCELERATION, jerk=JERK)
    half = arm.timed(BEND, ACCELERATION, jerk=JERK, speed=0.5, rate=1000.0)
    check_limits(half, ACCELERATION / 4.0, JERK / 8.0)
    assert half.duration == pytest.approx(2.0 * fast.duration, rel=0.01)


@pytest.mark.parametrize("jerk", [None, JERK])
def test_a_pace_is_that_of_the_samples_where_limits_allow_it(arm, jerk):
    """Samples at equal times of a motion that itself is slow and within the limits."""
    time = np.linspace(0.0, 1.0, 120)
    share = time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
    path = np.stack([share - 0.5, 0.4 * np.sin(2.0 * share)], axis=1)
    fastest = arm.timed(path, ACCELERATION, jerk=jerk)
    slow = arm.timed(path, ACCELERATION, jerk=jerk, pace=6.0)
    assert 6.0 <= slow.duration <= 6.0 * 1.04
    # It goes with the time, but for what is lost where it begins.
    np.testing.assert_allclose(slow.phases, slow.times / 6.0, atol=0.04)
    hasty = arm.timed(path, ACCELERATION, jerk=jerk, pace=0.1)
    assert hasty.duration == pytest.approx(fastest.duration, abs=0.011)
    halved = arm.timed(path, ACCELERATION, jerk=jerk, pace=6.0, speed=0.5)
    assert halved.duration == pytest.approx(2.0 * slow.duration, rel=0.01)


def test_a_pace_is_slower_only_where_limits_bind(arm):
    """Twice as fast as the elbow may be in the middle third, slow in the others."""
    share = np.interp(np.linspace(0.0, 1.0, 121), [0.0, 1 / 3, 2 / 3, 1.0], [0.0, 0.1, 0.9, 1.0])
    motion = arm.timed(np.outer(share, [0.0, 2.0]), 10.0, pace=3.0)
    middle = (motion.phases > 0.4) & (motion.phases < 0.6)
    np.testing.assert_allclose(motion.velocities[middle, 1], VELOCITY[1], rtol=5e-3)
    outer = (motion.phases > 0.1) & (motion.phases < 0.3)
    np.testing.assert_allclose(motion.velocities[outer, 1], 0.2, rtol=1e-2)
    assert motion.duration == pytest.approx(1.0 + 1.6 / 0.8 + 1.0, abs=0.1)


def test_what_limits_allow_is_said_and_done(arm):
    """The greatest velocity at an end, from rest along a line: sqrt(2 a d), or cbrt by the jerk."""
    path = np.linspace(0.0, 1.0, 30)[:, None] * [0.0, 0.1]
    for jerk, truth in ((None, np.sqrt(2.0 * 2.0 * 0.1)), (10.0, (10.0 * 0.1**2) ** (1.0 / 3.0))):
        options = {"jerk": jerk, "start_velocity": 0.0}
        name = "start_velocity" if jerk is None else "end_velocity"
        with pytest.raises(ValueError, match=name):
            arm.timed(path, 2.0, end_velocity=truth * 1.02, **options)
        motion = arm.timed(path, 2.0, end_velocity=truth * 0.96, rate=1000.0, **options)
        limits = None if jerk is None else np.array([jerk, jerk])
        check_limits(motion, np.array([2.0, 2.0]), limits, (0.0, truth * 0.96))
        with pytest.raises(
            ValueError, match=r"start_velocity must have a norm of at most"
        ) as caught:
            arm.timed(path, 2.0, start_velocity=0.79, jerk=jerk)
        said = float(str(caught.value).split("at most ")[1].split()[0])
        assert said == pytest.approx(truth, rel=0.03)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"jerk": [1.0]}, r"jerk must have shape \(2,?\)"),
        ({"jerk": [1.0, 0.0]}, "jerk must be above 0"),
        ({"jerk": "high"}, "jerk must be real numbers"),
        ({"pace": 0.0}, "pace must be .* above 0"),
        ({"pace": [1.0]}, "pace must be a finite number"),
        ({"start_velocity": -0.1}, "start_velocity must be .* at least 0"),
        ({"start_velocity": [0.1]}, r"start_velocity must have shape \(2,?\)"),
        ({"start_velocity": [0.1, -0.1]}, r"start_velocity must be along the path, .* \[0.78"),
        ({"start_velocity": -0.3 * (BEND[1] - BEND[0])}, "start_velocity must be along the path"),
        ({"end_velocity": [0.1, 0.1]}, "end_velocity must be along the path"),
        ({"end_velocity": 3.0}, r"end_velocity must have a norm of at most 1\.\d+ rad/s"),
        ({"end_velocity": 3.0, "jerk": 20.0}, r"end_velocity must have a norm of at most 1\.\d+"),
        ({"start_velocity": 3.0, "jerk": 20.0}, r"start_velocity must have a norm of at most 1\."),
    ],
)
def test_bad_settings_are_named(arm, options, message):
    with pytest.raises(ValueError, match=message):
        arm.timed(BEND, ACCELERATION, **options)


def test_a_setting_that_there_is_not_is_refused(arm):
    with pytest.raises(TypeError, match="sped"):
        arm.timed(BEND, ACCELERATION, sped=0.5)


def test_limits_of_jerk_need_no_further_package(arm, monkeypatch):
    monkeypatch.setitem(sys.modules, "toppra", None)
    assert arm.timed(BEND, ACCELERATION, jerk=JERK).duration > 0.0
