"""Problems of one robot and one task as tensors: what the costs of a batch are computed from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_gym.geometry.distance import PackedObstacles
from smp_gym.geometry.registry import SHAPES
from smp_planner.batch.shape_distance import LOCAL_DISTANCES
from smp_planner.collision.costs import (
    REFERENCE_STEPS,
    JointLimitCost,
    SelfCollisionCost,
    VelocityLimitCost,
)
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.constraints import Constraint, segments
from smp_planner.planning.problem import Problem, difference_of_robots
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_constraints import Reaching, ToolPath

__all__ = [
    "OBSTACLE_ROW",
    "BodyTables",
    "Tables",
    "ToolTables",
    "checked_device",
    "obstacle_rows",
]

OBSTACLE_ROW = 16
"""Numbers of an obstacle: shape, rotation to its frame (9), centre (3), half-extents (3)."""

_MOST_OBSTACLES = 63
_MOST_SPHERES = 63
"""Of a link, like obstacles of a stage: kernels keep sets of them in the bits of one integer."""

_PADDING = 8
"""Lengths are rounded up to a multiple of it, so that batches of a task often have one shape."""


def checked_device(device: str | torch.device) -> torch.device:
    """Return the device of a name.

    Raises:
        ValueError: no such device is at hand.
    """
    try:
        found = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise ValueError(f"device must be 'cpu' or 'cuda', got {device!r}") from error
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if found.type == "cpu" or (found.type == "cuda" and (found.index or 0) < count):
        return found
    there = ", ".join(["'cpu'", *(f"'cuda:{i}'" for i in range(count))])
    raise ValueError(f"device must be one of {there} on this machine, got {device!r}")


@dataclass(frozen=True, eq=False)
class BodyTables:
    """The spheres of B bodies on one chain, and the obstacles that they must stay clear of.

    Attributes:
        first: step at which the body begins to move among these obstacles.
        last: the step after the last one.
        scale: (B,) factor of the sum over steps and spheres.
        spheres: (B, S, 4) m, centre in the frame of its link and radius, in the order of links.
        offsets: (B, n + 2) int32, spheres of link k are those from offsets[k] to offsets[k + 1].
        balls: (B, n + 1, 4) m, centre and radius of a ball around all spheres of a link.
        obstacles: (B, O, `OBSTACLE_ROW`).
        obstacle_count: (B,) int32, how many of them there are.
        pair_masks: (B, S, n + 1) int64, whether sphere s must stay clear of sphere number b of link
            k: bit b.
        pair_links: pairs of links, the inner one first, that have such spheres.
        levers: (B, n + 1, n) m/rad, or without unit of a prismatic joint: the largest of a link's
            spheres; see `RobotModel.levers`.
    """

    first: int
    last: int
    scale: Tensor
    spheres: Tensor
    offsets: Tensor
    balls: Tensor
    obstacles: Tensor
    obstacle_count: Tensor
    pair_masks: Tensor
    pair_links: tuple[tuple[int, int], ...]
    levers: Tensor


@dataclass(frozen=True, eq=False)
class ToolTables:
    """Boxes for points that the hand carries, Eq. (14), each at a phase.

    Boxes of one group are options of a mixture; the costs of groups add up.

    Attributes:
        step: (B, H) int32, step before the phase.
        share: (B, H) of the way to the next step.
        point: (B, H, 3) m in the frame of the last link.
        lower: (B, H, 3) m.
        upper: (B, H, 3) m.
        log_weight: (B, H) of each option.
        group: (B, H) int32, ascending from 1; 0 for rows that stand for nothing.
        sigma: m, of the tails.
    """

    step: Tensor
    share: Tensor
    point: Tensor
    lower: Tensor
    upper: Tensor
    log_weight: Tensor
    group: Tensor
    sigma: float


@dataclass(frozen=True, eq=False)
class Tables:
    """B problems of one robot as tensors.

    Attributes:
        steps: T, equal steps of phase.
        chain: (n + 1, 12) pose of link 0, and from each link to the next joint: rotation, place.
        prismatic: (n) whether a joint is.
        stages: stretches of the trajectory with their obstacles.
        body: all that moves in the end; its obstacles are not used.
        weights: of obstacles, self-collision, velocities and joint limits.
        edge_width: of the map in the first and the last iteration, m.
        margin: m, by which spheres are enlarged while planning.
        own_edge_width: m, of self-collision.
        own_margin: m, of self-collision.
        per_step: (n,) from a step's change to the share of the velocity limit that it needs.
        lower: (n,) rad or m.
        upper: (n,) rad or m.
        tools: boxes for points that the hand carries by name of the constraint.
    """

    steps: int
    chain: Tensor
    prismatic: tuple[bool, ...]
    stages: tuple[BodyTables, ...]
    body: BodyTables
    weights: tuple[float, float, float, float]
    edge_width: tuple[float, float]
    margin: float
    own_edge_width: float
    own_margin: float
    per_step: Tensor
    lower: Tensor
    upper: Tensor
    tools: dict[str, ToolTables]

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.chain) - 1

    @property
    def count(self) -> int:
        """Number of problems B."""
        return len(self.body.spheres)

    @classmethod
    def of(
        cls,
        problems: Sequence[Problem],
        settings: PlanSettings,
        device: torch.device,
        dtype: torch.dtype = torch.float32,
        steps: int | None = None,
    ) -> Tables:
        """Return the tables of problems.

        Args:
            problems: at least one, of one robot and one task.
            settings: weights, widths and steps.
            device: of the tensors.
            dtype: of the tensors.
            steps: T; by default those at which `settings` evaluate costs.

        Raises:
            ValueError: no problem, problems of different robots or tasks, or with something that
                only planning without a device knows.
        """
        _check_alike(problems)
        steps = settings.planning_steps if steps is None else steps
        first = problems[0].robot
        limits = problems[0].body.limit_costs(settings)
        own, speed, bounds = (limits[n][1] for n in ("self_collision", "velocity", "joint_limits"))
        assert isinstance(own, SelfCollisionCost)
        assert isinstance(speed, VelocityLimitCost)
        assert isinstance(bounds, JointLimitCost)
        chain = np.stack([_pose_row(first.base), *(_pose_row(o) for o in first.joint_origins)])
        tables = cls(
            steps=steps,
            chain=torch.from_numpy(chain),
            prismatic=tuple(first.prismatic.tolist()),
            stages=tuple(
                _body_tables([problem.stages[i] for problem in problems], steps)
                for i in range(len(problems[0].stages))
            ),
            body=_body_tables([_Whole(problem.body) for problem in problems], steps),
            weights=(
                settings.obstacle_weight,
                limits["self_collision"][0],
                limits["velocity"][0],
                limits["joint_limits"][0],
            ),
            edge_width=settings.edge_width,
            margin=settings.margin,
            own_edge_width=own.edge_width,
            own_margin=own.margin,
            per_step=torch.from_numpy(
                (steps - 1) / (speed.duration * speed.fraction * speed.velocity)
            ),
            lower=torch.from_numpy(bounds.lower + bounds.margin),
            upper=torch.from_numpy(bounds.upper - bounds.margin),
            tools=_tool_tables(problems, settings, steps),
        )
        return tables.to(device, dtype)

    def of_problems(self, numbers: Sequence[int]) -> Tables:
        """Return the tables of some of the problems, in the order of their numbers."""
        if list(numbers) == list(range(self.count)):
            return self
        index = torch.tensor(numbers, device=self.chain.device)
        per_problem = {"stages": self.stages, "body": self.body, "tools": self.tools}
        return replace(
            self, **{name: _with_each(v, lambda t: t[index]) for name, v in per_problem.items()}
        )

    def to(self, device: torch.device, dtype: torch.dtype) -> Tables:
        """Return the tables on a device, what is not an integer in `dtype`."""

        def moved(tensor: Tensor) -> Tensor:
            kind = dtype if tensor.is_floating_point() else tensor.dtype
            return tensor.contiguous().to(device, kind)

        return _with_each(self, moved)

    def clone(self) -> Tables:
        """Return the tables in memory of their own."""
        return _with_each(self, Tensor.clone)


def _with_each(value: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """Return tables with each tensor changed."""
    if isinstance(value, Tensor):
        return change(value)
    if isinstance(value, tuple):
        return tuple(_with_each(part, change) for part in value)
    if isinstance(value, dict):
        return {name: _with_each(part, change) for name, part in value.items()}
    if isinstance(value, (Tables, BodyTables, ToolTables)):
        parts = {f.name: getattr(value, f.name) for f in fields(value)}
        return replace(value, **{name: _with_each(part, change) for name, part in parts.items()})
    return value


@dataclass(frozen=True)
class _Whole:
    """A body over the whole trajectory, without obstacles."""

    body: Any
    obstacles: tuple[Any, ...] = ()

    def steps(self, count: int) -> slice:
        return slice(0, count)


def _check_alike(problems: Sequence[Problem]) -> None:
    """Refuse what cannot be planned in one batch."""
    if not problems:
        raise ValueError("problems must hold at least one problem to be planned on a device")
    for problem in problems:
        for stage in problem.stages:
            if not isinstance(stage.body, RobotBody):
                raise ValueError(
                    f"problems must be of a robot to be planned on a device, got {stage.body!r}"
                )
            if stage.cloud is not None:
                raise ValueError(
                    "problems must have obstacles, no point cloud, to be planned on a device"
                )
            for obstacle in stage.obstacles:
                if obstacle.shape not in LOCAL_DISTANCES:
                    raise ValueError(
                        f"obstacles must be of the shapes {', '.join(LOCAL_DISTANCES)} to be "
                        f"planned on a device, got {obstacle.shape!r}"
                    )
            if len(stage.obstacles) > _MOST_OBSTACLES:
                raise ValueError(
                    f"a stage must have at most {_MOST_OBSTACLES} obstacles to be planned on a "
                    f"device, got {len(stage.obstacles)}"
                )
    first = problems[0]
    for index, problem in enumerate(problems):
        for stage in problem.stages:
            assert isinstance(stage.body, RobotBody)
            if difference_of_robots(stage.body.model, problem.robot):
                raise ValueError(f"stages of problems[{index}] must have one robot")
        difference = difference_of_robots(problem.robot, first.robot)
        if difference:
            raise ValueError(
                f"problems of one batch must have one robot: problems[{index}] differs from "
                f"problems[0] in {difference}"
            )
        if _kind(problem) != _kind(first):
            raise ValueError(
                "problems of one batch must be of one task: stages and constraints of "
                f"problems[{index}] are {_kind(problem)}, of problems[0] {_kind(first)}"
            )


def _kind(problem: Problem) -> tuple[Any, ...]:
    """Return what problems of one task have in common."""
    stages = tuple((round(s.first, 9), round(s.last, 9)) for s in problem.stages)
    return stages, tuple((type(c).__name__, c.name) for c in problem.constraints)


def _pose_row(pose: FloatArray) -> FloatArray:
    return np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]])


def _stack(arrays: Iterable[NDArray[Any]]) -> Tensor:
    """Stack arrays that may differ in length, padded with zeros to a multiple of `_PADDING`."""
    given = list(arrays)
    longest = -(-max(len(a) for a in given) // _PADDING) * _PADDING
    out = np.zeros((len(given), longest, *given[0].shape[1:]), given[0].dtype)
    for row, array in zip(out, given, strict=True):
        row[: len(array)] = array
    return torch.from_numpy(out)


def _order(model: RobotModel) -> NDArray[np.int64]:
    return np.argsort(model.link, kind="stable")


def _body_tables(parts: Sequence[Any], steps: int) -> BodyTables:
    """Return the tables of one stage of each problem."""
    count = parts[0].steps(steps)
    spheres, offsets, balls, rows, scales, levers = [], [], [], [], [], []
    for part in parts:
        model, order = part.body.model, _order(part.body.model)
        pairs = model.link_pairs
        spheres.append(np.column_stack([model.center, model.radius])[order])
        offsets.append(
            np.searchsorted(model.link[order], np.arange(model.joints + 2)).astype(np.int32)
        )
        balls.append(np.column_stack([pairs.ball_center, pairs.ball_radius]))
        rows.append(obstacle_rows(part.obstacles))
        lever = np.zeros((model.joints + 1, model.joints))
        np.maximum.at(lever, model.link, model.levers)
        levers.append(lever)
        scale = (REFERENCE_STEPS - 1) / (steps - 1)
        moving = int(np.count_nonzero(model.link))
        if part.body.reference_spheres is not None and moving:
            scale *= part.body.reference_spheres / moving
        scales.append(scale)
    masks, pair_links = _pair_masks([part.body.model for part in parts])
    return BodyTables(
        count.start,
        count.stop,
        torch.tensor(scales, dtype=torch.float64),
        _stack(spheres),
        torch.from_numpy(np.stack(offsets)),
        torch.from_numpy(np.stack(balls)),
        _stack(rows),
        torch.tensor([len(row) for row in rows], dtype=torch.int32),
        masks,
        pair_links,
        torch.from_numpy(np.stack(levers)),
    )


def obstacle_rows(obstacles: Sequence[Any]) -> FloatArray:
    """Return the rows (O, `OBSTACLE_ROW`) of obstacles; see `BodyTables`."""
    packed, codes = PackedObstacles.of(obstacles), list(LOCAL_DISTANCES)
    shape = np.array([codes.index(SHAPES[s]) for s in packed.shape], np.float64)
    rotation = packed.rotation.reshape(-1, 9)
    return np.column_stack([shape.reshape(-1, 1), rotation, packed.position, packed.size])


def _pair_masks(models: Sequence[RobotModel]) -> tuple[Tensor, tuple[tuple[int, int], ...]]:
    masks, links = [], set()
    for model in models:
        order = _order(model)
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        first = np.searchsorted(model.link[order], np.arange(model.joints + 2))
        if np.diff(first).max(initial=0) > _MOST_SPHERES:
            raise ValueError(
                f"a link must have at most {_MOST_SPHERES} spheres to be planned on a device, got "
                f"{np.diff(first).max()}"
            )
        pairs = model.link_pairs
        mask = np.zeros((len(order), model.joints + 1), np.int64)
        inner, outer = pairs.pairs.T
        bits = np.int64(1) << (place[inner] - first[model.link[inner]])
        np.bitwise_or.at(mask, (place[outer], model.link[inner]), bits)
        masks.append(mask)
        links |= {(int(i), int(j)) for i, j, _ in pairs.groups}
    return _stack(masks), tuple(sorted(links))


def _tool_tables(
    problems: Sequence[Problem], settings: PlanSettings, steps: int
) -> dict[str, ToolTables]:
    tables = {}
    for index, constraint in enumerate(problems[0].constraints):
        if constraint.cost(settings) is None:
            continue
        found = [_boxes(problem.constraints[index], settings, steps) for problem in problems]
        columns = [_stack(column) for column in zip(*found, strict=True)]
        tables[constraint.name] = ToolTables(*columns, sigma=settings.sigma)  # type: ignore[misc, arg-type]
    return tables


def _boxes(constraint: Constraint, settings: PlanSettings, steps: int) -> tuple[NDArray[Any], ...]:
    """Return the columns of `ToolTables` of one constraint."""
    if isinstance(constraint, Reaching):
        boxes = constraint.boxes(settings)
        group = np.ones(len(boxes.lower), np.int32)
        phases = np.ones(len(group))
        points = [constraint.robot.carried(goal.point) for goal in constraint.goals]
    elif isinstance(constraint, ToolPath):
        boxes = constraint.boxes(settings)
        group = 1 + np.arange(len(boxes.lower), dtype=np.int32)
        phases = np.array(constraint.phases)
        points = [constraint.robot.carried(via.point) for via in constraint.via_points]
    else:
        raise ValueError(
            f"constraints must be on the start, the hand's pose or the tool to be planned on a "
            f"device, got {type(constraint).__name__} {constraint.name!r}"
        )
    step, share = segments(steps, phases)
    return (
        step.astype(np.int32),
        share,
        np.array(points),
        boxes.lower,
        boxes.upper,
        boxes.log_weight,
        group,
    )
