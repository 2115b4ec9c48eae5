"""Places of a tool with orientations: costs against autograd, violations against scipy."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from smp_planner.collision.robot_model import jaco_model
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_constraints import Reaching
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint
from smp_planner.planning.tool_orientations import Cone, Orientation
from smp_planner.planning.tool_passing import ToolPassing

ROBOT = jaco_model()
PATHS = np.random.default_rng(0).uniform(-2.0, 2.0, (12, 9, 6)) + 1.5
POINT = np.array([0.02, -0.05, 0.1])
TURN = Rotation.from_euler("xyz", (0.4, -1.1, 2.0)).as_quat()
SETTINGS = PlanSettings(sigma=0.4)
PLACES = {
    "box": (GoalRegion(POINT, (0.1, -0.1, 0.1), (0.3, 0.2, 0.4)),),
    "cone": (GoalRegion(POINT, (0.1, -0.1, 0.1), (0.3, 0.2, 0.4), Cone(POINT, (1, 2, 0), 0.7)),),
    "fixed": (GoalRegion(POINT, (0.2, 0.0, 0.1), (0.2, 0.0, 0.1), Orientation(TURN, 0.0)),),
    "via": (ToolViaPoint(0.3, POINT, (0.2, 0.3, 0.4), 0.1, Orientation(TURN, 0.9)),),
    "choice": (
        ToolViaPoint(0.3, POINT, (0.2, 0.3, 0.4), 0.1, Cone((0, 0, 1), (0, 1, -1), 0.4)),
        ToolViaPoint(0.3, np.zeros(3), (2.0, 0.3, 0.2), 0.3),
        ToolViaPoint(0.3, POINT, (0.2, 0.3, 0.4), 0.1, Orientation(TURN, 0.5)),
    ),
}
SHARES = (0.5, 0.2, 0.3)


def passing(name, phase=0.3):
    places = PLACES[name]
    shares = SHARES[: len(places)] if len(places) > 1 else (1.0,)
    return ToolPassing("goal", phase, places, ROBOT, shares)


def oracle(name, paths):
    """Return the cost (P,) of paths (P, T, 6), differentiable, from the chain's plain product."""
    share, sigma = SETTINGS.via_share, SETTINGS.sigma
    at = 0.3 * (paths.shape[1] - 1)
    first = int(at)
    q = (1.0 - (at - first)) * paths[:, first] + (at - first) * paths[:, first + 1]
    pose = ROBOT.link_transforms(q)[:, -1] @ torch.from_numpy(ROBOT.end_effector)
    places = PLACES[name]
    logs = []
    for place, weight in zip(places, SHARES if len(places) > 1 else (1.0,), strict=True):
        point = pose[:, :3, :3] @ torch.from_numpy(place.point) + pose[:, :3, 3]
        if isinstance(place, GoalRegion):
            lower, upper = place.lower, place.upper
        else:
            half = share * place.tolerance
            lower, upper = place.position - half, place.position + half
        lower, upper = torch.from_numpy(lower), torch.from_numpy(upper)
        offset = point - torch.minimum(torch.maximum(point, lower), upper)
        angle, free = torch.zeros(len(q), dtype=torch.float64), math.pi
        if isinstance(place.orientation, Cone):
            own = pose[:, :3, :3] @ torch.from_numpy(place.orientation.axis)
            angle = torch.arccos(own @ torch.from_numpy(place.orientation.direction))
            free = max(share * place.orientation.angle, place.orientation.angle - 0.25)
        elif isinstance(place.orientation, Orientation):
            wanted = torch.from_numpy(Rotation.from_quat(place.orientation.quaternion).as_matrix())
            trace = torch.einsum("pij,ij->p", pose[:, :3, :3], wanted)
            angle = torch.arccos((trace - 1.0) / 2.0)
            free = max(share * place.orientation.tolerance, place.orientation.tolerance - 0.25)
        beyond = torch.clamp(angle - free, min=0.0)
        square = (offset.square().sum(-1) + beyond.square()) / (2.0 * sigma**2)
        widths = torch.cat([upper - lower, torch.tensor([2.0 * free], dtype=torch.float64)])
        if name == "box":
            widths = widths[:3]
        volume = torch.log(widths + math.sqrt(2.0 * math.pi) * sigma).sum()
        logs.append((math.log(weight) - square, volume))
    least = min(volume for _, volume in logs)
    return -torch.logsumexp(torch.stack([log - (v - least) for log, v in logs]), dim=0)


@pytest.mark.parametrize("name", PLACES)
def test_costs_and_gradients_are_those_of_autograd(name):
    paths = torch.from_numpy(PATHS).requires_grad_()
    expected = oracle(name, paths)
    (slope,) = torch.autograd.grad(expected.sum(), paths)
    value, gradient = passing(name).cost(SETTINGS)(PATHS)
    np.testing.assert_allclose(value, expected.detach(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gradient, slope, rtol=1e-6, atol=1e-7)
    assert np.abs(gradient).max() > 0.1


@pytest.mark.parametrize("name", PLACES)
def test_violations_are_those_of_scipy(name):
    constraint, settings = passing(name), PlanSettings()
    due = at_phases(PATHS, 0.3)[:, 0]
    pose = ROBOT.link_transforms(torch.from_numpy(due))[:, -1].numpy() @ ROBOT.end_effector
    turns = Rotation.from_matrix(pose[:, :3, :3])
    rows = []
    for place in PLACES[name]:
        point = turns.apply(place.point) + pose[:, :3, 3]
        if isinstance(place, GoalRegion):
            away = np.linalg.norm(point - np.clip(point, place.lower, place.upper), axis=1)
        else:
            away = np.linalg.norm(point - place.position, axis=1) - place.tolerance
        angle = np.zeros(len(due))
        if isinstance(place.orientation, Cone):
            own = turns.apply(place.orientation.axis)
            angle = np.arccos(own @ place.orientation.direction) - place.orientation.angle
        elif isinstance(place.orientation, Orientation):
            wanted = Rotation.from_quat(place.orientation.quaternion)
            angle = (turns * wanted.inv()).magnitude() - place.orientation.tolerance
        rows.append((np.maximum(away, 0.0), np.maximum(angle, 0.0)))
    away, angle = (np.array(column) for column in zip(*rows, strict=True))
    least = (away + angle).argmin(axis=0)
    assert len(set(least.tolist())) == len(rows)
    each = np.arange(len(due))
    np.testing.assert_allclose(constraint.distances(PATHS), away, atol=1e-9)
    np.testing.assert_allclose(constraint.missed(PATHS), away[least, each], atol=1e-9)
    np.testing.assert_allclose(constraint.turned(PATHS), angle[least, each], atol=1e-9)
    assert constraint.slack(settings) == settings.sigma
    assert constraint.oriented == (name != "box")


def test_with_free_orientations_it_costs_what_reaching_a_region_does():
    regions = tuple(
        GoalRegion(point, np.full(3, x), np.full(3, x + 0.2))
        for point, x in ((POINT, 0.0), (np.zeros(3), 0.3))
    )
    shares = (0.3, 0.7)
    expected = Reaching(regions, ROBOT, shares).cost(SETTINGS)(PATHS)
    found = ToolPassing("goal", 1.0, regions, ROBOT, shares).cost(SETTINGS)(PATHS)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
