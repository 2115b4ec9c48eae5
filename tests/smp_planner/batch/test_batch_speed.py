"""The bench of batches: what it keeps of particles is what the exact check finds."""

import json

import numpy as np

from smp_planner.benchmark import batch_speed
from smp_planner.planners import make_planner


def test_particles_of_several_parts_are_kept_and_checked(problems, tmp_path):
    settings = {"map": "exact", "particles": 6, "iterations": 6, "widths": (1.0, 2.0)}
    settings |= {"samples": 100, "planning_steps": 30, "inference": "quick"}
    planner = make_planner("smp", "Placement", settings=settings)
    batch = batch_speed.make_batch(planner, problems)
    assert (batch.parts, batch.latent.shape[:2]) == (2, (4, 3))
    assert batch.first(1).latent.equal(batch.latent[:2])
    path = tmp_path / "particles.npz"
    shares = batch_speed.write_particles(batch, "cpu", 2, path)
    exact, on_device = batch_speed.exact_shares(planner, problems, path)
    assert exact.shape == (2, 6)
    np.testing.assert_array_equal(exact, on_device)
    np.testing.assert_array_equal(exact.mean(axis=1), shares)
    # The first three are of the learned freedom, the others of twice as much.
    with np.load(path) as data:
        spread = data["weights"].reshape(2, 2, 3, -1).std(axis=2).mean(axis=(0, 2))
    assert spread[1] > 1.3 * spread[0]


def test_rows_hold_what_was_measured(problems):
    settings = {"map": "exact", "particles": 4, "iterations": 3, "planning_steps": 20}
    settings |= {"samples": 100, "inference": "quick", "widths": (1.0,)}
    batch = batch_speed.make_batch(make_planner("smp", "Placement", settings=settings), problems)
    rows = [
        *batch_speed.plan_rows(batch, "cpu", [1, 2], 1, 1),
        *batch_speed.iteration_rows(batch, "cpu", [1], 1, 1),
    ]
    assert [(row["measured"], row["scenes"]) for row in rows[:3]] == [
        ("descent", 1),
        ("plan", 1),
        ("descent", 2),
    ]
    errors = [row["relative"] for row in rows if row["measured"] == "difference from autograd"]
    assert len(errors) == 2
    assert max(errors) < 1e-4
    json.dumps(rows)
