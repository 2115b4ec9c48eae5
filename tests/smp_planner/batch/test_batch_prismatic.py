"""Batches of a robot with prismatic joints: gradients against autograd, costs, gaps and checks."""

import dataclasses
import importlib.util

import numpy as np
import pytest
import torch

from smp_gym.robot.kinematics import SphereSet
from smp_gym.scene import Obstacle
from smp_planner.batch.check import path_gaps
from smp_planner.batch.plain_costs import PlainCosts, plain_gaps
from smp_planner.batch.problem_tables import Tables
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import check_collisions
from smp_planner.library.adapt_settings import AdaptSettings
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.target import SceneTarget
from smp_planner.planning.tool_constraints import Reaching
from smp_planner.planning.tool_goals import GoalRegion

CPU = torch.device("cpu")
SETTINGS = AdaptSettings(planning_steps=20, duration_limit=2.0)


def shoulder_rail(axis):
    """Return a chain that turns, slides, turns and slides, its spheres on all links."""
    rng = np.random.default_rng(3)
    origins = np.tile(np.eye(4), (4, 1, 1))
    origins[1, :3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    origins[1:, :3, 3] = np.add(rng.normal(0.0, 0.1, (3, 3)), [0.2, 0.0, 0.0])
    origins[3, :3, :3] = axis
    link = np.repeat(np.arange(5), 2)
    center = rng.normal(0.0, 0.06, (10, 3))
    return RobotModel(
        base=np.eye(4),
        joint_origins=origins,
        end_effector=np.eye(4),
        lower=np.array([-2.0, 0.0, -2.0, -0.2]),
        upper=np.array([2.0, 0.5, 2.0, 0.3]),
        velocity=np.array([1.0, 0.3, 1.0, 0.2]),
        spheres=SphereSet(link, center, np.full(10, 0.05)),
        collision_pairs=np.array([(a, b) for a in range(6) for b in range(a + 4 - a % 2, 10)]),
        prismatic=np.array([False, True, False, True]),
    )


@pytest.fixture(scope="module")
def problems():
    model = shoulder_rail([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    body = RobotBody(model)
    made = []
    for number in range(2):
        obstacles = (
            Obstacle(shape="box", position=(0.5, 0.1 * number, 0.1), size=(0.1, 0.2, 0.1)),
            Obstacle(shape="cylinder", position=(0.1, 0.5, 0.0), size=(0.1, 0.1, 0.2)),
        )
        goal = GoalRegion(np.array([0.02, 0.0, 0.0]), np.full(3, 0.2), np.full(3, 0.25))
        made.append(
            Problem(
                body, (Reaching((goal,), model),), (Stage(0.0, 1.0, body, obstacles),), number, ()
            )
        )
    return made


@pytest.fixture(scope="module")
def paths(problems):
    model, rng = problems[0].robot, np.random.default_rng(0)
    ends = rng.uniform(model.lower - 0.1, model.upper + 0.1, (2, 2, 4, 1, 4))
    share = np.linspace(0.0, 1.0, 20)[:, None]
    return torch.from_numpy(ends[0] + share * (ends[1] - ends[0])).contiguous()


@pytest.fixture(scope="module")
def tables(problems):
    return Tables.of(problems, SETTINGS, CPU, torch.float64)


def test_gradient_is_that_of_autograd(tables, paths):
    assert tables.prismatic == (False, True, False, True)
    given = paths.clone().requires_grad_()
    value, gradient = PlainCosts(tables).weighted(given, 0.02)
    (expected,) = torch.autograd.grad(value.sum(), given)
    assert all(float(expected[..., joint].abs().max()) > 0.1 for joint in range(4))
    torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-8)
    for name, cost in PlainCosts(tables).costs(paths).items():
        assert float(cost.max()) > 1e-3, name


def test_costs_are_those_of_planning_without_a_device(tables, problems, paths):
    found = PlainCosts(tables).costs(paths)
    for b, problem in enumerate(problems):
        target = SceneTarget(problem, SETTINGS)
        for name, expected in target.costs(paths[b].numpy()).items():
            # Obstacles are exact here, on a grid there.
            tolerance = 0.05 if name == "obstacles" else 3e-4
            np.testing.assert_allclose(
                found[name][b], expected, rtol=tolerance, atol=tolerance, err_msg=name
            )


def test_gaps_and_checks_are_those_of_the_exact_check(tables, problems, paths):
    for b, problem in enumerate(problems):
        mine = tables.of_problems([b])
        stage = mine.stages[0]
        obstacles = problem.stages[0].obstacles
        for first in (0, 7):
            still = paths[b, :, first : first + 1].expand(-1, 20, -1).contiguous()
            gap, own = plain_gaps(mine, stage, still[None])
            exact = check_collisions(still.numpy(), problem.robot, obstacles)
            np.testing.assert_allclose(gap[0, :, 0], exact.clearance, atol=1e-9)
            np.testing.assert_array_equal(own[0, :, 0] >= 1e-3, exact.self_free)
        found = path_gaps(mine, stage, paths[b : b + 1], plain_gaps)
        exact = check_collisions(paths[b].numpy(), problem.robot, obstacles)
        np.testing.assert_allclose(found.clearance[0], exact.clearance, atol=2e-3)
        assert not (found.self_free[0].numpy() & ~exact.self_free).any()


def test_kinds_of_joints_tell_robots_apart(problems):
    model = dataclasses.replace(problems[0].robot, prismatic=np.array([False, True, True, True]))
    body = RobotBody(model)
    other = dataclasses.replace(
        problems[1], body=body, stages=(Stage(0.0, 1.0, body, ()),), constraints=()
    )
    with pytest.raises(ValueError, match=r"differs from problems\[0\] in prismatic"):
        Tables.of([problems[0], other], SETTINGS, CPU)


@pytest.mark.skipif(
    not torch.cuda.is_available() or importlib.util.find_spec("triton") is None,
    reason="needs a GPU",
)
def test_fused_kernels_slide_as_plain_torch_does(problems, paths):
    from smp_planner.batch.fused import FusedCosts, fused_gaps

    cuda = torch.device("cuda")
    tables = Tables.of(problems, SETTINGS, cuda)
    given = paths.to(cuda, torch.float32).contiguous()
    plain, fused = PlainCosts(tables), FusedCosts(tables)
    expected, found = plain.gradient(given, 0.02), fused.gradient(given, 0.02)
    assert float((found - expected).norm() / expected.norm()) < 1e-3
    for name, cost in plain.costs(given).items():
        torch.testing.assert_close(fused.costs(given)[name], cost, rtol=1e-3, atol=1e-4)
    for mine, other in zip(
        fused_gaps(tables, tables.stages[0], given),
        plain_gaps(tables, tables.stages[0], given),
        strict=True,
    ):
        torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5)
