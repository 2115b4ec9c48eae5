"""What the costs are timed against: tensors and autograd give what the compiled costs give."""

import numpy as np
import pytest
import torch

from smp_gym.robot import kinematics
from smp_gym.scene import TABLE
from smp_planner.benchmark import timing
from smp_planner.benchmark.cost_speed import (
    SPHERE_MARGIN,
    autograd_collision,
    cost_table,
    make_scene,
    make_trajectories,
)
from smp_planner.benchmark.timing import median_time, timed
from smp_planner.collision.costs import CollisionCost
from smp_planner.collision.robot_model import jaco_model
from smp_planner.occupancy.grid import bake_analytic


@pytest.mark.parametrize("edge_width", [0.05, 0.01])
def test_both_sides_compute_the_same_cost(edge_width):
    rng = np.random.default_rng(3)
    scene = make_scene(6, rng)
    assert (scene[0], len(scene)) == (TABLE, 7)
    robot, grid = jaco_model(kinematics.finger_spheres(np.zeros(4))), bake_analytic(scene)
    q = make_trajectories(robot, 5, 20, rng)
    assert ((robot.lower <= q) & (q <= robot.upper)).all()
    cost = CollisionCost(robot, grid)
    value, gradient = cost(q, edge_width, SPHERE_MARGIN)
    oracle, slope = autograd_collision(cost, q, edge_width, torch.float64)
    assert value.max() > 0.0
    np.testing.assert_allclose(value, oracle, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(gradient, slope, rtol=0, atol=1e-5 * np.abs(slope).max())


def test_a_table_has_a_row_for_each_cost():
    table = cost_table(particles=2, steps=5, check_steps=6, obstacles=1, repeats=1, seed=0)
    assert len(table.rows) == 8
    assert "2 particles x 5 steps" in str(table.title)


def test_the_first_call_is_not_timed(monkeypatch):
    clock = iter([0.0, 1.0, 1.0, 4.0, 4.0, 6.0])
    calls = []
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    assert median_time(lambda: calls.append(0), 3) == 2.0
    assert len(calls) == 4


def test_a_timed_call_returns_its_result(monkeypatch):
    clock = iter([2.0, 2.5])
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    assert timed(divmod, 7, 2) == (0.5, (3, 1))
