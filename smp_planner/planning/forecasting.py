"""Where obstacles are and will be: the mean of looks at what stands, the forecast of what moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.scene import Obstacle
from smp_planner.collision.forecast import Forecast, is_moving
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.settings import PlanSettings

__all__ = ["SURPRISE", "Looks", "forecast_of", "parted", "robot_of", "runs_in_time", "surprising"]

SURPRISE = 0.015
"""m, beyond what noise explains, by which an obstacle must be elsewhere than expected to count as
having been moved."""

_SURE = 5.0
"""Standard deviations that noise explains: of a vector of three normal numbers, 1 in 65 000 is
longer."""

_MEMORY = 60
"""Most looks that count in a mean: the weight of a new one never gets less than that of so many."""

_ENOUGH = 24
"""Number of changes from which on they say how large the noise is, to 15 %. With fewer, those of
the look that is to be judged are counted among them."""


def _positions(obstacles: Sequence[Obstacle]) -> FloatArray:
    return np.array([o.position for o in obstacles], np.float64).reshape(-1, 3)


def _velocities(obstacles: Sequence[Obstacle]) -> FloatArray:
    return np.array([o.velocity for o in obstacles], np.float64).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Looks:
    """What successive looks at the same obstacles say together.

    What stands is where the mean of all looks at it says, a recursive one, m <- m + (z - m) / n. Of
    n looks, the part of the noise that each has for itself has 1 / n of the variance in it; what
    all have in common stays. What moves is where the last look says. A look from which noise does
    not explain the distance to the mean begins that anew. How large the noise is follows from the
    changes from look to look that velocities do not explain, half of whose mean square is the
    variance along an axis; with exact looks it is 0, and the mean is the last of them.

    Attributes:
        last: obstacles as the last look has them.
        obstacles: as all looks have them.
        count: (N,) how many looks each place is the mean of.
        squares: m^2, sum of the squares of unexplained changes.
        changes: number of these.
    """

    last: tuple[Obstacle, ...]
    obstacles: tuple[Obstacle, ...]
    count: IntArray
    squares: float = 0.0
    changes: int = 0

    @classmethod
    def first(cls, obstacles: tuple[Obstacle, ...]) -> Looks:
        """Return what the first look says."""
        return cls(obstacles, obstacles, np.ones(len(obstacles), np.int64))

    @property
    def deviation(self) -> float:
        """Standard deviation of the noise that each look has for itself, along an axis, m."""
        return _deviation(self.squares, self.changes)

    @property
    def doubt(self) -> float:
        """Standard deviation of where the mean of the looks says that obstacles stand, m.

        What all looks have in common cannot be told from them: it is taken to be as large as what
        each has for itself, which is known.
        """
        fewest = int(self.count.min(initial=_MEMORY))
        return self.deviation * math.sqrt(1.0 + 1.0 / fewest)

    def then(self, obstacles: tuple[Obstacle, ...], seconds: float) -> Looks:
        """Return what the looks say together with one more.

        Args:
            obstacles: as it has them, the same ones in the same order.
            seconds: since the last look.
        """
        seen, mean = _positions(obstacles), _positions(self.obstacles)
        velocity = 0.5 * (_velocities(self.last) + _velocities(obstacles))
        change = np.square(seen - _positions(self.last) - seconds * velocity)
        noise = self.deviation
        if self.changes < _ENOUGH:
            noise = _deviation(self.squares + float(change.sum()), self.changes + change.size)
        away = np.linalg.norm(seen - mean, axis=1)
        standing = np.array(
            [not (is_moving(o) or is_moving(n)) for o, n in zip(self.last, obstacles, strict=True)],
            np.bool_,
        )
        kept = standing & ~surprising(away, noise, 1.0 + 1.0 / self.count)
        calm = change[kept | ~standing]
        count = np.where(kept, np.minimum(self.count + 1, _MEMORY), 1)
        mean = np.where(kept[:, None], mean + (seen - mean) / count[:, None], seen)
        return Looks(
            obstacles,
            tuple(
                o if n == 1 else o.model_copy(update={"position": tuple(place)})
                for o, n, place in zip(obstacles, count, mean.tolist(), strict=True)
            ),
            count,
            self.squares + float(calm.sum()),
            self.changes + calm.size,
        )


def _deviation(squares: float, changes: int) -> float:
    return math.sqrt(squares / (2.0 * changes)) if changes else 0.0


def surprising(distance: FloatArray, deviation: float, variances: FloatArray) -> BoolArray:
    """Return whether obstacles (N,) are elsewhere than expected by more than noise explains.

    Args:
        distance: (N,) m, from where they were expected.
        deviation: m, of a look along an axis.
        variances: (N,) of the difference between what was expected and what was found, in units of
            that of a look.
    """
    return np.asarray(distance > SURPRISE + _SURE * deviation * np.sqrt(variances))


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
