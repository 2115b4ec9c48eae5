"""Paths in time, against what is known of the fastest motion and by differences of its samples."""

import json
import sys

import numpy as np
import pytest

from smp_planner.library.smp import Robot

VELOCITY = np.array([1.5, 0.8])
BEND = np.stack([np.linspace(-1.0, 1.0, 60), 0.4 * np.sin(np.linspace(0.0, 4.0, 60))], axis=1)


@pytest.fixture(scope="module")
def arm(planar):
    given = {name: getattr(planar, name) for name in planar.__dataclass_fields__}
    return Robot(type(planar)(**{**given, "velocity": VELOCITY}), ("shoulder", "elbow"))


@pytest.mark.parametrize(("distance", "acceleration"), [(1.6, 2.0), (0.2, 2.0)])
def test_a_straight_path_takes_as_long_as_a_trapezoid_or_a_triangle(arm, distance, acceleration):
    path = np.linspace(0.0, 1.0, 50)[:, None] * [0.0, distance]
    motion = arm.timed(path, acceleration)
    top = min(VELOCITY[1], np.sqrt(distance * acceleration))
    fastest = distance / top + top / acceleration
    # Up to the next sample: at the rate to the last one, as controllers want it.
    assert fastest * (1.0 - 1e-3) <= motion.duration <= fastest * (1.0 + 1e-3) + 0.01
    np.testing.assert_allclose(np.diff(motion.times), 0.01)


@pytest.mark.parametrize("path", [BEND, BEND[::-1], BEND[np.repeat(np.arange(60), 2)]])
def test_limits_hold_and_the_path_is_kept(arm, path):
    limits = np.array([1.0, 2.5])
    motion = arm.timed(path, limits, rate=1000.0)
    step = motion.times[1]
    assert step == pytest.approx(1e-3)
    np.testing.assert_allclose(np.diff(motion.times), step)
    moved = np.diff(motion.positions, axis=0) / step
    assert (np.abs(moved) <= VELOCITY * (1.0 + 1e-6)).all()
    assert (np.abs(np.diff(motion.velocities, axis=0) / step) <= limits * (1.0 + 1e-3)).all()
    np.testing.assert_allclose(
        moved, 0.5 * (motion.velocities[1:] + motion.velocities[:-1]), atol=5e-4
    )
    # One of the limits binds nearly everywhere: it could not be faster.
    use = np.maximum(
        (np.abs(motion.velocities) / VELOCITY).max(axis=1),
        (np.abs(motion.accelerations) / limits).max(axis=1),
    )
    assert np.quantile(use, 0.05) > 0.98
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.positions[[0, -1]], path[[0, -1]], atol=1e-12)
    elbow = 0.4 * np.sin(2.0 * (motion.positions[:, 0] + 1.0))
    np.testing.assert_allclose(motion.positions[:, 1], elbow, atol=1e-4)


def test_slower_is_the_same_motion(arm):
    fast = arm.timed(BEND, 2.0)
    half = arm.timed(BEND, 2.0, speed=0.5, rate=50.0)
    stretched = arm.timed(BEND, 2.0, duration=2.0 * fast.duration, rate=50.0)
    assert half.duration == pytest.approx(2.0 * fast.duration, rel=1e-3)
    np.testing.assert_allclose(stretched.positions, fast.positions, atol=1e-9)
    np.testing.assert_allclose(stretched.velocities, fast.velocities / 2.0, atol=1e-9)
    np.testing.assert_allclose(stretched.accelerations, fast.accelerations / 4.0, atol=1e-4)


def test_files_hold_the_motion(arm, tmp_path):
    motion = arm.timed(BEND, 2.0, rate=20.0)
    motion.save(tmp_path / "motion.csv")
    table = np.genfromtxt(tmp_path / "motion.csv", delimiter=",", names=True, deletechars="")
    assert table.dtype.names[:4] == ("time", "shoulder", "elbow", "velocity:shoulder")
    np.testing.assert_allclose(table["elbow"], motion.positions[:, 1], atol=1e-9)
    np.testing.assert_allclose(table["acceleration:elbow"], motion.accelerations[:, 1], atol=1e-9)
    motion.save(tmp_path / "motion.json")
    message = json.loads((tmp_path / "motion.json").read_text())
    assert message["joint_names"] == ["shoulder", "elbow"]
    stamps = [point["time_from_start"] for point in message["points"]]
    times = [stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps]
    np.testing.assert_allclose(times, motion.times, atol=1e-9)
    assert all(0 <= stamp["nanosec"] < 10**9 for stamp in stamps)
    assert message["points"][7]["velocities"] == motion.velocities[7].tolist()
    with pytest.raises(ValueError, match=r"path must end in .csv or .json, got .*motion.txt"):
        motion.save(tmp_path / "motion.txt")


@pytest.mark.parametrize(
    ("path", "options", "message"),
    [
        (BEND[:, :1], {}, r"path must have shape .*2"),
        (BEND[:1], {}, "at least two samples that differ"),
        (np.ones((9, 2)), {}, "at least two samples that differ"),
        (BEND, {"acceleration": [1.0]}, r"acceleration must have shape \(2,?\)"),
        (BEND, {"acceleration": [1.0, 0.0]}, "acceleration must be above 0"),
        (BEND, {"rate": 0.0}, "rate must be .* above 0"),
        (BEND, {"speed": 1.5}, "speed must be .* at most 1"),
        (BEND, {"rate": 1e9}, r"must have fewer than 1000000 samples, but takes .* at rate=1e\+09"),
        (BEND, {"duration": 1e9}, "must have fewer than 1000000 samples, but takes 1e.09 s"),
        (BEND, {"pace": 1e9}, r"must have fewer than 1000000 samples, .* pace \(s\)"),
        (BEND, {"pace": 1e9, "jerk": 20.0}, "must have fewer than 1000000 samples"),
        (
            BEND + np.array([3.0, 0.0]),
            {},
            r"path must keep the limits of joint 'shoulder', .* sample \d+",
        ),
        (BEND - np.array([0.0, 9.0]), {}, r"path must keep the limits of joint 'elbow', \["),
        (BEND, {"duration": 0.5}, r"duration must be at least \d\.\d+ s for this path, got 0.5"),
    ],
)
def test_bad_requests_are_named(arm, path, options, message):
    with pytest.raises(ValueError, match=message):
        arm.timed(path, **{"acceleration": 2.0, **options})


def test_without_the_package_it_says_what_to_install(arm, monkeypatch):
    monkeypatch.setitem(sys.modules, "toppra", None)
    with pytest.raises(ImportError, match=r'pip install "smp-gym\[timing\]"'):
        arm.timed(BEND, 2.0)
