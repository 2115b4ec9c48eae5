"""Limits of joints up front, and angles that are more than numbers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smp_planner.adaptation import adaptation
from smp_planner.library.joint_angles import JointAngles, unwrapped
from smp_planner.library.smp import SMP, AnyOf, Box, Robot, ViaPoint

PHASE = np.linspace(0.0, 1.0, 30)
TURN = 2.0 * np.pi


@pytest.fixture(scope="module")
def arm(planar):
    return Robot(planar, ("shoulder", "elbow"))


@pytest.fixture(scope="module")
def turning(planar):
    model = type(planar)(
        **{
            **{name: getattr(planar, name) for name in planar.__dataclass_fields__},
            "lower": np.array([-2.0 * TURN, -3.0]),
            "upper": np.array([2.0 * TURN, 3.0]),
        }
    )
    return Robot(model, ("shoulder", "elbow"), (True, False))


def demonstrations(begin=-2.5, end=1.0):
    swing = np.sin(np.pi * PHASE)
    smooth = PHASE**2 * (3.0 - 2.0 * PHASE)
    first = begin + (end - begin) * smooth
    return [np.stack([first, 1.0 + bend * swing], 1) for bend in (-0.2, 0.1, 0.3)]


@pytest.fixture(scope="module")
def primitive(arm):
    return SMP.fit(demonstrations(), robot=arm)


@pytest.mark.parametrize("beyond", [0.0, 1e-9, 1e-6])
def test_at_a_limit_is_allowed_and_executable(primitive, beyond):
    plan = primitive.adapt(
        start=(-3.0 - beyond, 1.0), goal=(1.0, 1.0), particles=4, method=adaptation("smp")
    )
    assert plan.executable.all()
    assert np.abs(plan.trajectories[:, 0, 0] + 3.0).max() < 1e-8


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"start": (-3.0 - 1e-5, 1.0)}, r"start .* 'shoulder', \[-3, 3\] rad, got -3.00001"),
        ({"goal": (1.0, 3.5)}, r"goal must keep .* 'elbow', \[-3, 3\] rad, got 3.5"),
        ({"goal": np.degrees((1.0, 1.0))}, "goal must keep .* 'elbow'|'shoulder'"),
        ({"goal": Box((1.0, 3.1), (1.1, 3.2))}, "goal must keep .* 'elbow'"),
        ({"goal": AnyOf([(1.0, 1.0), (1.0, -9.0)])}, "goal must keep .* 'elbow'"),
        ({"via_points": ViaPoint(0.5, (4.0, 0.0), 0.1)}, r"via_points\[0\] must keep .*'shoulder'"),
    ],
)
def test_beyond_a_limit_is_named_up_front(primitive, request_, message):
    with pytest.raises(ValueError, match=message):
        primitive.adapt(particles=2, **request_)


@pytest.mark.parametrize(
    "change",
    [np.degrees, lambda path: path - [0.0, 4.2], lambda path: path - [0.501, 0.0]],
)
def test_demonstrations_beyond_limits_are_named(arm, change):
    with pytest.raises(ValueError, match=r"demonstrations\[\d\] must keep the limits of joint '"):
        SMP.fit([change(path) for path in demonstrations()], robot=arm)


@pytest.mark.parametrize("begin", [-4.0, 2.0, 6.0])
def test_wrapped_angles_of_continuous_joints_are_unwrapped(turning, begin):
    plain = demonstrations(begin, begin + 3.5)
    wrapped = [path.copy() for path in plain]
    for number, path in enumerate(wrapped):
        path[:, 0] = (path[:, 0] + np.pi) % TURN - np.pi + (TURN if number == 1 else 0.0)
    read = unwrapped(wrapped, turning)
    for found, path in zip(read, plain, strict=True):
        assert np.abs(np.diff(found[:, 0])).max() < 1.0
        np.testing.assert_allclose(np.cos(found), np.cos(path), atol=1e-9)
        np.testing.assert_allclose(found[:, 0], read[0][:, 0], atol=1e-9)


def test_missing_angles_are_left_out(turning):
    path = demonstrations(2.0, 5.5)[0]
    path[:, 0] = (path[:, 0] + np.pi) % TURN - np.pi
    path[5:8, 0] = np.nan
    found = unwrapped([path, path], turning)[0][:, 0]
    assert np.isnan(found).sum() == 3
    assert np.abs(np.diff(found[np.isfinite(found)])).max() < 1.0


def test_jumps_of_joints_that_are_not_continuous_are_named(arm):
    wrapped = demonstrations(2.0, 4.5)
    for path in wrapped:
        path[:, 0] = np.where(path[:, 0] > 3.0, path[:, 0] - TURN + 0.3, path[:, 0])
    with pytest.raises(ValueError, match=r"demonstrations\[0\] jumps by .* of joint 'shoulder'"):
        SMP.fit(wrapped, robot=arm)


@pytest.mark.parametrize("turns", [-1, 0, 1, 2])
def test_requests_are_turned_to_the_nearest_branch(turning, turns):
    angles = JointAngles(turning, demonstrations(2.0, 5.5))
    asked = np.array([5.4 + turns * TURN, 1.0])
    lower, upper = angles.placed("goal", 1.0, asked, asked)
    np.testing.assert_allclose(lower, [5.4, 1.0], atol=1e-12)
    np.testing.assert_array_equal(lower, upper)
    box = angles.placed("start", 0.0, asked - 3.4, asked - 3.2)
    np.testing.assert_allclose(np.mean(box, axis=0), [2.1, -2.3], atol=1e-12)


@pytest.mark.parametrize("column", [0, 1, 3])
@pytest.mark.parametrize("digits", [2, 3, 9])
def test_rotation_matrices_are_no_plain_coordinates(column, digits):
    rng = np.random.default_rng(0)
    paths = []
    for _ in range(3):
        turns = Rotation.from_rotvec(rng.normal(size=3) + np.outer(PHASE, rng.normal(size=3)))
        rest = PHASE[:, None] + rng.normal(size=(1, 3))
        matrices = turns.as_matrix().reshape(-1, 9)
        paths.append(np.round(np.insert(rest, [column], matrices, axis=1), digits))
    with pytest.raises(ValueError, match=f"coordinates {column} to {column + 8} .* rotation matr"):
        SMP.fit(paths)
    # Two columns of a rotation are no rotation.
    SMP.fit([path[:, 1:] if column == 0 else path[:, :-4] for path in paths])


@pytest.mark.parametrize("column", [0, 1, 3])
@pytest.mark.parametrize("digits", [2, 3])
def test_quaternions_are_no_plain_coordinates(column, digits):
    rng = np.random.default_rng(0)
    paths = []
    for _ in range(3):
        turn = rng.normal(size=4) + np.outer(PHASE, rng.normal(size=4))
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        rest = PHASE[:, None] + rng.normal(size=(1, 4))
        paths.append(np.round(np.insert(rest, [column], turn, axis=1), digits))
    with pytest.raises(ValueError, match=f"coordinates {column} to {column + 3} .* quaternions"):
        SMP.fit(paths)
