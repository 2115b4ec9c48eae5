"""Settings of SVGD side by side on scenes of the tasks."""

import numpy as np
import pytest

from smp_planner.experiments import arm_settings
from smp_planner.experiments.arm_settings import Cell, cells_of, measure_cell
from smp_planner.experiments.paths import diversity
from smp_planner.experiments.tables import summarise


@pytest.fixture(scope="module")
def rows():
    return [
        measure_cell(Cell("Placement", "usual", variant, "easy", 20_000))
        for variant in ("default", "no repulsion")
    ]


def test_a_row_holds_what_the_table_shows(rows):
    for row in rows:
        assert {column.name for column in arm_settings.COLUMNS} <= row.keys()
        assert 0.0 <= row["good"] <= min(row["free"], row["executable"]) <= 100.0
        assert row["solved"] == 100.0
        assert row["modes"] >= 1.0
        assert 0.0 <= row["entropy"] <= np.log(row["modes"]) + 1e-9
    assert [s["variant"] for s in summarise(rows, ("task", "prior", "variant"))] == [
        "default",
        "no repulsion",
    ]


def test_priors_differ_in_the_added_deviation_and_try_once():
    narrow = arm_settings._policy("Placement", "narrow", "smp", "default").planner.settings
    usual = arm_settings._policy("Placement", "usual", "smp", "default").planner.settings
    assert narrow["smooth_std"] == 0.5 * usual["smooth_std"]
    assert (narrow["retries"], usual["retries"]) == (0, 0)


def test_diversity_is_the_mean_distance_of_two_paths():
    still = np.zeros((60, 3))
    paths = np.stack([still, still + np.array([0.3, 0.0, 0.0]), still + np.array([0.0, 0.4, 0.0])])
    paths[:, :, 2] += np.linspace(0.0, 1.0, 60)
    assert diversity(paths) == pytest.approx((0.3 + 0.4 + 0.5) / 3)


def test_all_variants_of_a_scene_and_prior_follow_each_other():
    cells = cells_of(["DrawS", "Placement"], ["usual", "narrow"], "easy", range(5, 8))
    count = len(arm_settings.COMPARED_SETTINGS)
    assert len(cells) == len(set(cells)) == 2 * 3 * 2 * count
    for start in range(0, len(cells), count):
        together = cells[start : start + count]
        assert [cell.variant for cell in together] == list(arm_settings.COMPARED_SETTINGS)
        assert len({(cell.task, cell.prior, cell.seed) for cell in together}) == 1
