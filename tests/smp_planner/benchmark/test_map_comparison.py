"""How maps compare, on distances whose error is known."""

import numpy as np
import pytest

from smp_gym.scene import TABLE
from smp_planner.benchmark.map_comparison import (
    ABOVE_TABLE,
    Record,
    compare_maps,
    map_table,
    points_around,
    random_scene,
)


def test_a_record_counts_hits_and_keeps_errors_near_the_surface():
    record = Record()
    exact = np.array([-0.02, -0.02, -0.005, 0.02, 0.03, 0.05, 0.2])
    found = np.array([-0.01, 0.001, 0.005, 0.03, -0.001, 0.05, 0.2])
    record.add(0.5, found, exact)
    assert record.seconds == [0.5]
    assert record.inside.tolist() == [1.0, 2.0]
    assert record.outside.tolist() == [1.0, 3.0]
    (error,) = record.error
    assert error == pytest.approx([0.01, 0.021, 0.01, 0.01])


def test_points_stay_above_the_table_and_around_the_bodies():
    rng = np.random.default_rng(0)
    scene = random_scene(3, rng)
    assert TABLE in scene
    points = points_around(scene, rng)
    assert points[:, 2].min() > ABOVE_TABLE
    assert len(points) > 1000


def test_finer_grids_are_more_exact():
    records = compare_maps(1, 2, [0.04, 0.01], False, 0)
    error = {
        name: np.percentile(np.abs(np.concatenate(r.error)), 95) for name, r in records.items()
    }
    assert error["exact distance, grid of 10 mm"] < 0.5 * error["exact distance, grid of 40 mm"]
    assert error["shape networks, at the point"] < 0.001
    fine = records["exact distance, grid of 10 mm"]
    assert fine.inside[0] == fine.inside[1] > 0.0
    assert fine.outside[0] == 0.0
    table = map_table(records, "title")
    assert table.row_count == len(records) == 5
