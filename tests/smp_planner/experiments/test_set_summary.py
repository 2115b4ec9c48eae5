"""Summary of particle sets: means of cells, and distances as multiples of the noise floor's."""

import numpy as np
import pytest

from smp_planner.experiments.set_summary import ratio_table, ratio_to_floor, set_table


def rows(floor, own, method="smp", task="DrawS"):
    """Return rows of scenes with the distances of the noise floor and of a method."""
    return [
        {"task": task, "method": name, "seed": seed, "wasserstein": value, "good": 50.0 + seed}
        for name, values in (("noise floor", floor), (method, own))
        for seed, value in enumerate(values)
    ]


def test_cells_are_means_of_what_is_known():
    found = rows([100.0, 300.0], [None, 150.0]) + rows([1.0], [None], task="Placement")
    table = set_table(found, (("good", 0), ("wasserstein", 1)))
    assert table == [
        ["", "DrawS", "Placement"],
        ["noise floor", "50 · 200.0", "50 · 1.0"],
        ["smp", "50 · 150.0", "50 · –"],
    ]


def test_a_ratio_is_that_of_means_over_the_scenes_of_both():
    found = rows([100.0, 200.0, None], [150.0, 250.0, 1e6])
    ratio = ratio_to_floor(found, "DrawS", "smp")
    # A bootstrap of two scenes has the scenes themselves at its ends.
    assert ratio == pytest.approx({"count": 2, "value": 400.0 / 300.0, "low": 1.25, "high": 1.5})
    assert ratio_table(found)[1] == ["smp", "1.33 (1.25–1.50)"]


def test_the_interval_of_a_ratio_covers_the_truth():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(60):
        floor = rng.gamma(20.0, 10.0, 40)
        own = 1.3 * floor * rng.gamma(50.0, 0.02, 40)
        ratio = ratio_to_floor(rows(list(floor), list(own)), "DrawS", "smp")
        hits += ratio["low"] <= 1.3 <= ratio["high"]
    # Of 95 % in expectation; fewer than 51 of 60 happen less than once in 300 times.
    assert hits >= 51


def test_without_a_common_scene_there_is_no_ratio():
    with pytest.raises(ValueError, match="a scene of DrawS with smp and noise floor"):
        ratio_to_floor(rows([1.0, None], [None, 2.0]), "DrawS", "smp")
