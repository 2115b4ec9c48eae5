"""Autograd's target is the compiled one; measurements make tables."""

import numpy as np
import pytest
import torch

from smp_gym.robot.kinematics import finger_spheres
from smp_gym.scene import TABLE, Obstacle
from smp_planner.benchmark.autograd_planner import AutogradTarget
from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.plan_speed import (
    Measurement,
    Variant,
    compared,
    growth,
    measure,
    replans,
    stages_table,
)
from smp_planner.planning.problem import Problem, Stage, arm_problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.target import SceneTarget
from smp_planner.planning.threads import Threads
from smp_planner.planning.tool_constraints import Reaching, ToolPath
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint

START = np.array([0.0, 3.0, 1.5, 0.0, 2.5, 0.0])


@pytest.mark.parametrize("progress", [0.0, 1.0])
def test_all_costs_together_are_those_of_autograd(progress):
    obstacles = (TABLE, Obstacle(shape="box", position=(0.3, -0.2, 0.2), size=(0.1, 0.1, 0.2)))
    goals = tuple(
        GoalRegion(np.array([0.0, 0.0, z]), np.full(3, 0.1), np.full(3, 0.1 + side))
        for z, side in ((0.0, 0.1), (0.05, 0.2))
    )
    whole = arm_problem(START, obstacles, finger_spheres(np.zeros(4)), goals, seed=0)
    robot, body = whole.robot, whole.body
    vias = tuple(
        ToolViaPoint(phase, np.array([0.0, 0.0, 0.02]), np.full(3, 0.3), 0.05)
        for phase in (0.31, 0.62)
    )
    problem = Problem(
        body,
        (ToolPath(vias, robot), Reaching(goals, robot, (0.3, 0.7))),
        (Stage(0.0, 0.4, body, obstacles), Stage(0.4, 1.0, body, obstacles[:1])),
    )
    settings = PlanSettings(map="exact", sigma=0.1)
    rng = np.random.default_rng(1)
    phase = np.linspace(0.0, 1.0, 50)[None, :, None]
    paths = START + rng.normal(0.0, 0.2, (9, 1, 6)) + phase * rng.normal(0.0, 9.0, (9, 1, 6))
    oracle = AutogradTarget(problem, settings, torch.float64).gradient(paths, progress)
    with Threads(2) as threads:
        target = SceneTarget(problem, settings, threads=threads)
        found = target.gradient(paths, progress)
    assert set(target.costs(paths)) == {
        "obstacles",
        "self_collision",
        "velocity",
        "joint_limits",
        "via_points",
        "goal",
    }
    assert all((cost > 0.0).any() for cost in target.costs(paths).values())
    np.testing.assert_allclose(found, oracle, rtol=0, atol=2e-5 * np.abs(oracle).max())


def measurement(variant, seed, seconds, good, prior):
    stages = {"map": 0.1 * seconds, "inference": 0.9 * seconds}
    return Measurement(variant, "T", seed, seconds, seconds, stages, good, good > 0, prior, 1)


def test_variants_are_compared_scene_by_scene():
    found = [
        measurement("old", 1, 1.0, 0.5, 20.0),
        measurement("old", 2, 3.0, 1.0, 30.0),
        measurement("new", 1, 0.5, 0.75, 19.0),
        measurement("new", 2, 0.75, 1.0, None),
    ]
    head, old, new = compared(found, "old")
    row = dict(zip(head, new, strict=True))
    assert row["of the reference"] == "0.375"
    assert row["good"] == "0.875"
    assert row["scenes"] == "2"
    assert row["solved"] == "2"
    assert new[head.index("good") + 1].startswith("+0.125")
    assert dict(zip(head, old, strict=True))["of the reference"] == "1.000"
    assert stages_table(found)[2] == ["T", "new", "62", "562", "625"]
    assert markdown_table([["a", "b"], ["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"


def test_a_plan_is_measured_in_a_process_of_its_own():
    settings = {"particles": 3, "iterations": 2, "retries": 0}
    found = measure("Placement", "easy", [71_900], [Variant("quick", 1, settings)])
    assert [(m.variant, m.task, m.seed) for m in found] == [("quick", "Placement", 71_900)]
    assert found[0].cpu > 0.0
    assert set(found[0].stages) == {"map", "conditioning", "inference", "verification"}
    assert 0.0 <= found[0].good <= 1.0


def test_the_growth_has_a_row_for_each_number():
    rows = growth(repeats=1)
    assert [row[:2] for row in rows[1:6]] == [
        ["particles", number] for number in ("10", "42", "100", "300", "1000")
    ]
    assert all(float(row[2]) > 0.0 for row in rows[1:])


def test_what_planning_anew_takes_is_set_beside_the_first_plan():
    head, row = replans(["Placement"], "easy", range(40000, 40003))
    assert head == ["task", "scenes", "plan, ms", "anew, ms", "ratio"]
    assert row[:2] == ["Placement", "2"]
    assert all(float(value) > 0.0 for value in row[2:])
