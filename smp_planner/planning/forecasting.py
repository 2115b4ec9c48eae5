"""Which obstacles of a problem stand, and where those that move are expected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from smp_gym.scene import Obstacle
from smp_planner.collision.moving import Forecast, is_moving
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.bodies import RobotBody
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.settings import PlanSettings

__all__ = ["forecast_of", "parted", "robot_of", "runs_in_time"]


def forecast_of(
    obstacles: Sequence[Obstacle],
    turns: Mapping[Obstacle, tuple[float, ...]],
    settings: PlanSettings,
) -> Forecast:
    """Return where obstacles are expected after an observation.

    Args:
        obstacles: as they were observed.
        turns: see `Problem`.
        settings: horizon and margins.
    """
    turn = [turns.get(obstacle, (0.0, 0.0, 0.0)) for obstacle in obstacles]
    least, most = settings.forecast_margin
    return Forecast(
        tuple(obstacles),
        np.array(turn, np.float64).reshape(-1, 3),
        settings.forecast_horizon,
        settings.forecast_growth,
        most,
        least,
    )


def robot_of(stage: Stage) -> RobotModel:
    """Return the robot of a stage.

    Raises:
        ValueError: its body is none.
    """
    if not isinstance(stage.body, RobotBody):
        raise ValueError(f"Stage.body must be a robot here, got {stage.body!r}")
    return stage.body.model


def parted(
    problem: Problem, stage: Stage, settings: PlanSettings
) -> tuple[tuple[Obstacle, ...], Forecast | None]:
    """Return the obstacles of a stage that stand, and the forecast of those that move.

    Only a robot's trajectories run in time: for other bodies all obstacles stand.
    """
    timed = isinstance(stage.body, RobotBody) and settings.forecast_horizon > 0.0
    moving = [obstacle for obstacle in stage.obstacles if timed and is_moving(obstacle)]
    if not moving:
        return stage.obstacles, None
    standing = tuple(obstacle for obstacle in stage.obstacles if not is_moving(obstacle))
    return standing, forecast_of(moving, problem.turns, settings)


def runs_in_time(problem: Problem, settings: PlanSettings) -> bool:
    """Return whether some obstacle moves that a robot's trajectory has to pass in time."""
    return any(parted(problem, stage, settings)[1] is not None for stage in problem.stages)
