"""Arguments of the library: mistakes are named, and what is plainly meant is taken."""

import numpy as np
import pytest

from smp_gym.scene import Obstacle
from smp_planner.library.smp import SMP, AdaptSettings, AnyOf, Box, Circle, Rectangle, ViaPoint

PHASE = np.linspace(0.0, 1.0, 40)
PATHS = [np.stack([PHASE, a * np.sin(np.pi * PHASE)], 1) for a in (0.2, 0.25, 0.3, 0.22)]


@pytest.fixture(scope="module")
def primitive():
    return SMP.fit(PATHS)


def on_curve(phase):
    return phase, 0.25 * np.sin(np.pi * phase)


@pytest.mark.parametrize("count", [15, 16, 30])
def test_more_exact_places_than_basis_functions_are_refused(primitive, count):
    via = [ViaPoint(t, on_curve(t)) for t in np.linspace(0.02, 0.98, count)]
    with pytest.raises(ValueError, match=rf"exactly at {count} phases, .* 15 .* tolerance"):
        primitive.adapt(via_points=via, particles=2, method="promp")


def test_start_and_goal_count_and_tolerance_frees(primitive):
    phases = np.linspace(0.05, 0.95, 13)
    held = {"start": on_curve(0.0), "goal": on_curve(1.0), "particles": 2, "method": "promp"}
    with pytest.raises(ValueError, match="exactly at 15 phases"):
        primitive.adapt(via_points=[ViaPoint(t, on_curve(t)) for t in phases], **held)
    loose = [ViaPoint(t, on_curve(t), 0.01) for t in phases]
    assert np.abs(primitive.adapt(via_points=loose, **held).trajectories).max() < 2.0
    fine = SMP.fit(PATHS, basis_functions=25)
    exact = [ViaPoint(t, on_curve(t)) for t in phases]
    assert fine.adapt(via_points=exact, **held).missed["via_points[5]"].max() < 1e-4


@pytest.mark.parametrize("gap", [0.005, 1e-4, 1e-8])
def test_places_that_swing_the_path_are_refused(primitive, gap):
    via = [ViaPoint(0.5, (0.5, 0.25)), ViaPoint(0.5 + gap, (0.5, 0.35))]
    with pytest.raises(ValueError, match=r"via_points\[0\] and via_points\[1\], .* of the phase"):
        primitive.adapt(via_points=via, particles=2, method="promp")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"particles": 1.5}, "particles must be a whole number .* got 1.5"),
        ({"particles": 8.0}, "particles must be a whole number .* got 8.0"),
        ({"particles": 10**9}, "particles must be a whole number from 1 to"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"seed": None}, "seed must be a whole number .* got None"),
        ({"radius": np.nan}, "radius must be a finite number"),
        ({"radius": "1"}, "radius must be a finite number"),
        ({"obstacles": 3}, "obstacles must be a list of Circle"),
        ({"obstacles": "wall"}, "obstacles must be a list of Circle"),
        ({"obstacles": {"a": Circle((0, 0), 1)}}, "obstacles must be a list of Circle"),
        ({"obstacles": AdaptSettings()}, "obstacles must be a list of Circle"),
        ({"via_points": (0.5, 0.1)}, r"via_points\[0\] must be a ViaPoint"),
        ({"start": [1j, 0.0]}, "start must be real numbers"),
        ({"start": ["0", "1"]}, "start must be real numbers"),
        ({"goal": np.ma.masked_array([0.0, 1.0], [True, False])}, "goal must be a plain array"),
        ({"goal": [0.0, np.inf]}, "goal must be finite"),
        ({"goal": None, "start": [0.0]}, "start must have the 2 coordinates"),
        ({"goal": [0.0, 1e300]}, r"goal must be within 1e\+06 extents .* got \[0.0, 1e\+300\]"),
        ({"start": Box((-1e9, 0.0), (0.0, 1.0))}, "start must be within 1e.06 extents"),
        ({"via_points": ViaPoint(0.5, (0.0, -1e20))}, r"via_points\[0\] must be within"),
        ({"per_component": "no"}, "per_component must be True or False, got 'no'"),
        ({"per_component": 1}, "per_component must be True or False, got 1"),
        ({"per_component": None}, "per_component must be True or False, got None"),
        (
            {"method": "rrt"},
            "method must be one of smp, .* and, of a robot, rrt_connect; got 'rrt'",
        ),
        ({"method": 3}, "method must be a name"),
        ({"settings": {"sigma": 1}}, "settings must be AdaptSettings"),
    ],
)
def test_arguments_are_named_with_their_values(primitive, given, message):
    with pytest.raises(ValueError, match=message):
        primitive.adapt(**given)


def test_one_stands_for_a_list_and_numpy_s_numbers_for_python_s(primitive):
    circle, via = Circle(np.array([0.5, 0.6]), np.float32(0.1)), ViaPoint(np.float64(0.5), [0.5, 0])
    plan = primitive.adapt(
        circle, via_points=via, particles=np.int64(3), seed=np.uint32(1), method="promp"
    )
    same = primitive.adapt([circle], via_points=[via], particles=3, seed=1, method="promp")
    np.testing.assert_array_equal(plan.trajectories, same.trajectories)


@pytest.mark.parametrize(
    "make",
    [
        lambda bad: Circle((0.0, 0.0), bad),
        lambda bad: Circle((0.0, bad), 1.0),
        lambda bad: Rectangle((0.0, 0.0), (1.0, bad)),
        lambda bad: Rectangle((0.0, 0.0), (1.0, 1.0), bad),
        lambda bad: Box((0.0, bad), (1.0, 1.0)),
        lambda bad: Box((0.0, 0.0), (1.0, 1.0), sigma=np.nan if bad is None else bad),
        lambda bad: ViaPoint(bad, (0.0, 0.0)),
        lambda bad: ViaPoint(0.5, (0.0, 0.0), bad),
        lambda bad: AnyOf([(0.0, 0.0), (1.0, 1.0)], (1.0, bad)),
        lambda bad: Obstacle(shape="box", position=(0.0, 0.0, bad), size=(1.0, 1.0, 1.0)),
        lambda bad: AdaptSettings(edge_width=(bad, 0.1)),
        lambda bad: AdaptSettings(forecast_margin=(0.1, bad)),
    ],
)
@pytest.mark.parametrize("bad", [np.nan, "a", 1j, None, object(), np.array([1.0, 2.0])])
def test_numbers_are_numbers(make, bad):
    with pytest.raises(ValueError, match=r"must|Input should"):
        make(bad)


@pytest.mark.parametrize(
    "value", [{0.0, 1.0, 2.0}, [True, False, True], np.zeros(3, complex), ["0", "0", "0"]]
)
def test_vectors_of_obstacles_are_vectors_of_numbers(value):
    with pytest.raises(ValueError, match="position"):
        Obstacle(shape="box", position=value, size=(1.0, 1.0, 1.0))
    body = Obstacle(shape="box", position=np.zeros(3, np.float32), size=np.ones(3, np.int64))
    assert body == Obstacle(shape="box", position=(0, 0, 0), size=(1, 1, 1))


@pytest.mark.parametrize("size", [(0.05,), 0.05, (0.05, 0.1), [0.1] * 4, np.array([0.1, 0.2])])
@pytest.mark.parametrize(
    ("shape", "meaning"),
    [("sphere", "radius"), ("cylinder", "half height"), ("box", "hx, hy, hz")],
)
def test_sizes_of_obstacles_say_what_they_are(shape, meaning, size):
    with pytest.raises(ValueError, match=f"size of a {shape} is .*{meaning}.*, got"):
        Obstacle(shape=shape, position=(0.0, 0.0, 0.0), size=size)


def test_reprs_are_short(primitive):
    plan = primitive.adapt(particles=2, method="promp")
    choice = AnyOf([ViaPoint(0.5, np.full(9, 0.125)) for _ in range(90)])
    shown = [primitive, plan, Box((0, 0), (1, 1)), ViaPoint(0.5, np.zeros(2)), Circle((0, 0), 1)]
    shown += [choice, primitive.prior, primitive.mixture, primitive.single, primitive.frame]
    assert repr(choice).endswith("and 86 more)")
    assert all(len(repr(thing)) < 600 for thing in shown)
