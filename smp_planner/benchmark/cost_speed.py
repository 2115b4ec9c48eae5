"""Run time of the planner's costs: compiled with analytic gradients against autograd."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from rich.table import Table

from smp_gym.robot import kinematics
from smp_gym.scene import TABLE, Obstacle
from smp_planner.benchmark.timing import median_time
from smp_planner.collision.autograd import by_autograd, map_collision
from smp_planner.collision.costs import CollisionCost, SelfCollisionCost, ValueAndGradient
from smp_planner.collision.robot_model import RobotModel, jaco_model
from smp_planner.collision.verification import check_collisions
from smp_planner.occupancy.grid import bake_analytic

__all__ = ["autograd_collision", "cost_table", "make_scene", "make_trajectories"]

SPHERE_MARGIN = 0.01
"""m, by which link spheres are enlarged."""


def make_scene(obstacles: int, rng: np.random.Generator) -> tuple[Obstacle, ...]:
    """Return the table and boxes around the arm."""
    bodies = [TABLE]
    for _ in range(obstacles):
        angle, radius = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 0.6)
        x, y, z = radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.05, 0.5)
        size = tuple(rng.uniform(0.03, 0.06, 3).tolist())
        bodies.append(Obstacle(shape="box", position=(x, y, z), size=size))
    return tuple(bodies)


def make_trajectories(
    robot: RobotModel, particles: int, steps: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return smooth paths (P,T,6) rad between postures over the table."""
    home = np.array([0.0, 3.0, 1.5, 0.0, 2.5, 0.0])
    start, change = rng.normal(size=(2, particles, 1, 6)) * [[[[0.3]]], [[[0.6]]]]
    phase = np.linspace(0.0, 1.0, steps)[None, :, None]
    return np.clip(home + start + change * phase**2 * (3 - 2 * phase), robot.lower, robot.upper)


def autograd_collision(
    cost: CollisionCost,
    trajectories: NDArray[np.float64],
    edge_width: float,
    dtype: torch.dtype,
) -> ValueAndGradient:
    """Return value and gradient of a `CollisionCost` by tensors and autograd."""
    function = partial(map_collision, cost, edge_width=edge_width, margin=SPHERE_MARGIN)
    return by_autograd(function, torch.as_tensor(trajectories, dtype=dtype))


def cost_table(
    particles: int, steps: int, check_steps: int, obstacles: int, repeats: int, seed: int
) -> Table:
    """Return a table of how long value and gradient of each cost take, on one thread.

    Args:
        particles: trajectories P of a set.
        steps: T of them.
        check_steps: T of the trajectories of the exact check.
        obstacles: boxes besides the table.
        repeats: calls of which the median is taken.
        seed: of scene and trajectories.
    """
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    scene = make_scene(obstacles, rng)
    grid = bake_analytic(scene)
    robot = jaco_model(kinematics.finger_spheres(np.zeros(4)))
    q = make_trajectories(robot, particles, steps, rng)
    finished = make_trajectories(robot, particles, check_steps, rng)
    collision, own = CollisionCost(robot, grid), SelfCollisionCost(robot)

    rows: list[tuple[str, float, float | None]] = []
    for edge_width in (0.05, 0.01):
        name = f"obstacles, edge {100 * edge_width:.0f} cm"
        oracle = partial(autograd_collision, collision, q, edge_width)
        slow = median_time(partial(oracle, torch.float64), repeats)
        single = median_time(partial(oracle, torch.float32), repeats)
        fast = median_time(partial(collision, q, edge_width, SPHERE_MARGIN), repeats)
        rows.append((f"{name}: autograd, float64", slow, slow))
        rows.append((f"{name}: autograd, float32", single, slow))
        rows.append((f"{name}: compiled, float32", fast, slow))
    rows.append(("the arm itself: compiled", median_time(partial(own, q), repeats), None))
    check = median_time(partial(check_collisions, finished, robot, scene), repeats)
    rows.append((f"exact check, {particles} x {check_steps}", check, None))

    table = Table(
        title=f"{particles} particles x {steps} steps x {collision.summed_spheres} moving spheres, "
        f"{len(robot.collision_pairs)} pairs, {len(scene)} bodies, one thread"
    )
    table.add_column("value and gradient of")
    table.add_column("ms", justify="right")
    table.add_column("times faster", justify="right")
    for name, seconds, reference in rows:
        ratio = "" if reference is None else f"{reference / seconds:.1f}"
        table.add_row(name, f"{1e3 * seconds:.2f}", ratio)
    return table
