"""How maps compare, on distances whose error is known."""

import numpy as np
import pytest

from smp_gym.scene import TABLE
from smp_planner.benchmark.map_accuracy import MapAccuracy
from smp_planner.benchmark.map_comparison import (
    ABOVE_TABLE,
    compare_maps,
    map_table,
    points_around,
    random_scene,
)


def test_hits_are_counted_and_errors_taken_near_the_surface():
    exact = np.array([-0.02, -0.02, -0.005, 0.02, 0.03, 0.05, 0.2])
    found = np.array([-0.01, 0.001, 0.005, 0.03, -0.001, 0.05, 0.9])
    accuracy = MapAccuracy.of(1, exact, found)
    assert (accuracy.scenes, accuracy.points) == (1, 7)
    assert accuracy.inside_occupied == pytest.approx(1 / 2)
    assert accuracy.outside_occupied == pytest.approx(1 / 3)
    # Errors of 10, 21, 10 and 10 mm: between the third and the fourth, at 2.85 of 3.
    assert accuracy.error_p95 == pytest.approx(0.010 + 0.85 * 0.011)


def test_points_stay_above_the_table_and_around_the_bodies():
    rng = np.random.default_rng(0)
    scene = random_scene(3, rng)
    assert TABLE in scene
    points = points_around(scene, rng)
    assert points[:, 2].min() > ABOVE_TABLE
    assert len(points) > 1000


def test_finer_grids_are_more_exact():
    records = compare_maps(1, 2, [0.04, 0.01], False, 0)
    accuracy = {
        name: MapAccuracy.of(1, np.concatenate(record.exact), np.concatenate(record.found))
        for name, record in records.items()
    }
    error = {name: found.error_p95 for name, found in accuracy.items()}
    assert error["exact distance, grid of 10 mm"] < 0.5 * error["exact distance, grid of 40 mm"]
    assert error["shape networks, at the point"] < 0.001
    fine = accuracy["exact distance, grid of 10 mm"]
    assert (fine.inside_occupied, fine.outside_occupied) == (1.0, 0.0)
    table = map_table(records, "title")
    assert table.row_count == len(records) == 5
