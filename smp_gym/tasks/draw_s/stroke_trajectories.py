"""Trajectories along a stroke: the one that draws it, and others that leave it in bumps."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.robot.forward_kernels import sphere_paths
from smp_gym.robot.kinematics import PEN_TIP
from smp_gym.sampling.detours import smoothstep
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.witness import WITNESS_SAMPLES, within_limits
from smp_gym.tasks.draw_s.rules import equal_arc
from smp_gym.tasks.draw_s.strokes import follow, moved

__all__ = [
    "BUMP_HALF_WIDTH",
    "END_SHIFT",
    "PHASES",
    "SCALE",
    "START_SHIFT",
    "YAW",
    "Bumps",
    "Stroke",
    "drawing_body",
    "lead_aside",
    "sample_centers",
    "sample_stroke",
    "tip_path",
]

END_SHIFT = (0.05, 0.06, 0.03)
"""Metres, largest shift of the stroke's end from where it was demonstrated, along x, y and z."""

SCALE = (0.85, 1.15)
"""Size of the S, the demonstrated being 1."""

YAW = 0.3
"""Rad, largest turn of the S about the vertical through its end, in either direction."""

START_SHIFT = 0.02
"""Metres, largest distance of the pen's start from the beginning of the stroke."""

PHASES = np.linspace(0.0, 1.0, WITNESS_SAMPLES)
PHASES.setflags(write=False)
"""(200,) phases of a trajectory's samples."""

_START_BLEND = 0.15
"""Share of the phase in which a movement joins the stroke."""

_BUMP_REGION = (0.2, 0.8)
_BUMP_SPACING = 0.2
BUMP_HALF_WIDTH = (0.10, 0.15)
_BUMP_HEIGHT = (0.13, 0.22)
_BUMP_TURN = 0.08
"""Phases between which the middles of bumps lie, their least distance and half widths (phase); how
far the pen is led aside (m), and the standard deviation of what the joints do besides (rad)."""

_FORWARD = 0.2
"""Largest share of a bump's direction that may point forwards: the hand follows the pen."""

_MAX_ERROR = 1e-4
"""Metres that the pen may be off the stroke."""


@functools.lru_cache(maxsize=1)
def drawing_body() -> MovingBody:
    """Return the demonstrated movements of DrawS, and arm, fingers and pen."""
    demonstrations = Demonstrations.load("DrawS")
    return MovingBody.holding(
        demonstrations.configurations,
        demonstrations.metadata["finger_angles"],
        kinematics.pen_spheres(),
    )


@functools.lru_cache(maxsize=1)
def _template() -> tuple[FloatArray, FloatArray]:
    """Return the mean stroke (200, 3) m and configurations (200, 6) rad that draw it."""
    demonstrations = Demonstrations.load("DrawS")
    return demonstrations.pen_paths.mean(axis=0), demonstrations.mean


def tip_path(trajectory: FloatArray) -> FloatArray:
    """Return the path (T, 1, 3) m of the pen's tip on a trajectory (T, 6) rad."""
    hand = len(kinematics.LINKS) - 1
    tip = kinematics.END_EFFECTOR[:3, :3] @ PEN_TIP + kinematics.END_EFFECTOR[:3, 3]
    return sphere_paths(
        np.ascontiguousarray(trajectory),
        kinematics.BASE_TRANSFORM,
        kinematics.JOINT_ORIGINS,
        np.array([hand]),
        tip[None],
    )


@dataclass(frozen=True, eq=False)
class Stroke:
    """One episode's stroke, and the trajectory of the arm along it.

    Attributes:
        checkpoints: (32, 3) m.
        line: (200, 3) m.
        trajectory: (200, 6) rad, from the episode's start.
        jacobian: (200, 3, 6) m/rad, of the pen's tip on the trajectory.
        pointing: (200, 3) unit vectors along the pen.
    """

    checkpoints: FloatArray
    line: FloatArray
    trajectory: FloatArray
    jacobian: FloatArray
    pointing: FloatArray


def sample_stroke(rng: np.random.Generator) -> Stroke | None:
    """Draw a stroke and the trajectory of the arm along it; None if the arm cannot follow it."""
    points, posture = _template()
    end = points[-1] + rng.uniform(-1.0, 1.0, 3) * END_SHIFT
    yaw = float(rng.uniform(-YAW, YAW))
    line = moved(points, end.tolist(), float(rng.uniform(*SCALE)), yaw)
    near = posture.copy()
    # The first joint turns clockwise.
    near[:, 0] -= np.arctan2(line[:, 1], line[:, 0]) - np.arctan2(points[:, 1], points[:, 0])
    demonstrations = drawing_body().demonstrations
    shift = rng.standard_normal(3)
    shift *= rng.uniform(0.0, START_SHIFT) / np.sqrt((shift**2).sum())
    first = demonstrations[rng.integers(len(demonstrations)), 0] + (near - posture)[0]
    # The start is solved for along with the line.
    trajectory, error = follow(np.vstack([line, line[0] + shift]), np.vstack([near, first]))
    if error > _MAX_ERROR:
        return None
    start, trajectory = trajectory[-1], trajectory[:-1]
    join = 1.0 - smoothstep(np.minimum(PHASES / _START_BLEND, 1.0))
    trajectory = trajectory + join[:, None] * (start - trajectory[0])
    if not within_limits(trajectory):
        return None
    links = kinematics.link_transforms(trajectory)
    pose = links[:, -1] @ kinematics.END_EFFECTOR
    tip = pose[:, :3, :3] @ PEN_TIP + pose[:, :3, 3]
    arms = tip[:, None] - links[:, 1:, :3, 3]
    jacobian = np.swapaxes(np.cross(links[:, 1:, :3, 2], arms), 1, 2)
    return Stroke(equal_arc(line), line, trajectory, jacobian, pose[:, :3, 0])


@dataclass(frozen=True, eq=False)
class Bumps:
    """Bumps of N trajectories: (N, B) centre and half width in phase, (N, B, 3) direction, and top.

    The top (N, B, 6) is what the joints add in the middle of a bump, rad.
    """

    center: FloatArray
    half_width: FloatArray
    aside: FloatArray
    top: FloatArray

    def along(self, phase: FloatArray) -> FloatArray:
        """Return the offsets (N, T, 6) rad of the bumps at phases (T,)."""
        part = (phase - self.center[..., None]) / self.half_width[..., None]
        shape = np.maximum(1.0 - part**2, 0.0) ** 3
        return np.einsum("nbt,nbj->ntj", shape, self.top)


def sample_centers(count: int, bumps: int, rng: np.random.Generator) -> FloatArray:
    """Draw the middle phases (count, bumps) of the bumps of `count` trajectories."""
    first, last = _BUMP_REGION
    free = last - first - (bumps - 1) * _BUMP_SPACING
    center = np.sort(rng.uniform(0.0, free, (count, bumps)), axis=1)
    return np.asarray(center + first + _BUMP_SPACING * np.arange(bumps))


def lead_aside(stroke: Stroke, center: FloatArray, rng: np.random.Generator) -> Bumps:
    """Draw bumps with their middles in phases (N, B)."""
    shape = center.shape
    half_width = rng.uniform(*BUMP_HALF_WIDTH, shape)
    at = np.rint(center * (len(stroke.trajectory) - 1)).astype(np.int64)
    forward = stroke.pointing[at]
    aside = rng.standard_normal((*shape, 3))
    aside /= np.sqrt((aside**2).sum(axis=-1, keepdims=True))
    along = (aside * forward).sum(axis=-1, keepdims=True)
    aside -= np.maximum(along - _FORWARD, 0.0) * forward
    height = rng.uniform(*_BUMP_HEIGHT, (*shape, 1))
    jacobian = stroke.jacobian[at]
    gram = jacobian @ np.swapaxes(jacobian, -1, -2) + 1e-3 * np.eye(3)
    solved = np.linalg.solve(gram, (height * aside)[..., None])
    top = np.einsum("nbij,nbi->nbj", jacobian, solved[..., 0])
    top += rng.normal(0.0, _BUMP_TURN, top.shape)
    return Bumps(center, half_width, aside, top)
