"""The accuracy of maps, measured on maps whose accuracy is known."""

import numpy as np
import pytest

from smp_gym.scene import Goal, ManipulatedObject, Obstacle, Scene, fixtures
from smp_planner.benchmark.map_accuracy import measure, measure_default_map
from smp_planner.occupancy.grid import DistanceGrid, bake_analytic


def _scene(*obstacles: Obstacle) -> Scene:
    return Scene(
        task="Placement",
        start=(0.0,) * 6,
        manipulated=ManipulatedObject(),
        goals=(Goal(position=(0.5, 0.3, 0.01)),),
        obstacles=obstacles,
    )


SCENE = _scene(
    Obstacle(shape="box", position=(0.4, -0.2, 0.3), size=(0.05, 0.04, 0.06)),
    Obstacle(shape="sphere", position=(0.5, 0.0, 0.2), size=(0.05, 0.05, 0.05)),
    Obstacle(shape="cylinder", position=(0.3, 0.2, 0.1), size=(0.04, 0.04, 0.1)),
)


def test_the_exact_map_is_right() -> None:
    exact = bake_analytic((*SCENE.obstacles, *fixtures(SCENE)), spacing=0.01)
    accuracy = measure([SCENE], [exact], np.random.default_rng(0))
    assert accuracy is not None
    assert accuracy.inside_occupied == 1.0
    assert accuracy.outside_occupied == 0.0
    assert accuracy.error_p95 < 0.003


@pytest.mark.parametrize(
    ("shift", "inside", "outside"),
    [
        (0.015, 3.5**3 / 4**3, 0.0),
        (-0.03, 1.0, (8**3 - 7**3) / (11**3 - 7**3)),
        (0.2, 0.0, 0.0),
    ],
)
def test_wrong_maps_are_found_out(shift: float, inside: float, outside: float) -> None:
    # Around one sphere of 5 cm, shares are ratios of the volumes of shells.
    ball = Obstacle(shape="sphere", position=(0.5, 0.0, 0.5), size=(0.05, 0.05, 0.05))
    exact = bake_analytic((ball,), spacing=0.01)
    wrong = DistanceGrid(exact.origin, exact.spacing, exact.values + np.float32(shift))
    accuracy = measure([_scene(ball)], [wrong], np.random.default_rng(0))
    assert accuracy is not None
    assert accuracy.inside_occupied == pytest.approx(inside, abs=0.15)
    assert accuracy.outside_occupied == pytest.approx(outside, abs=0.04)
    assert accuracy.error_p95 == pytest.approx(abs(shift), abs=0.003)


def test_the_default_map_keeps_its_promise() -> None:
    accuracy = measure_default_map([SCENE])
    assert accuracy is not None
    assert accuracy.inside_occupied >= 0.99
    assert accuracy.outside_occupied <= 0.02


def test_no_obstacles_have_no_accuracy() -> None:
    assert measure_default_map([_scene()]) is None
