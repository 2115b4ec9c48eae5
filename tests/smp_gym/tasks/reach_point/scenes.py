"""Scenes of ReachPoint: a movement of the joints, whose end is the goal, and bars beside it."""

import numpy as np

from smp_gym.robot.pen import PEN_CONFIGURATION, pen_path
from smp_gym.sampling.draws import Draw, SceneSampler
from smp_gym.sampling.specification import SPECIFICATIONS
from smp_gym.scene import Goal


def draw(difficulty, rng):
    start = np.array(PEN_CONFIGURATION)
    end = start + np.array([0.5, 0.2, 0.2, 0.0, 0.0, 0.0]) * rng.uniform(-1.0, 1.0, 6)
    witness = start + np.linspace(0.0, 1.0, 200)[:, None] * (end - start)
    goal = Goal(kind="point", position=tuple(pen_path(end).tolist()))
    # Rows: shape, position, cosine and sine of the yaw, half-extents.
    rows = [
        [0, -0.5, 0.1 * bar, 0.3, 1, 0, 0.02, 0.02, 0.3]
        for bar in range(SPECIFICATIONS[difficulty].obstacles)
    ]
    return Draw(start, (goal,), np.array(rows).reshape(-1, 9), witness, manipulated=None)


SAMPLER = SceneSampler(draw)
