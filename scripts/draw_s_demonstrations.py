"""The demonstrations of DrawS: the handwritten S of the LASA data set, drawn in three dimensions.

The seven recordings of `Sshape` (Khansari-Zadeh and Billard 2011) keep their shapes. They are laid
on a bent, leaning sheet in front of the arm, each with a bulge of its own, and the arm follows them
with its hand pointing outwards, as far as the joints' speed allows.
"""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.interpolate import CubicSpline

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.demonstrations import DEMONSTRATION_SAMPLES, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, decode
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_gym.scene import STROKE_POINTS, Goal, Scene
from smp_gym.tasks.draw_s.rules import PEN_CONFIGURATION, equal_arc
from smp_gym.tasks.draw_s.strokes import follow, pen_path
from smp_planner.experiments.lasa import demonstrations

TASK = "DrawS"
SEED = 0

SCALE = 9.0
"""Metres on the sheet per metre of handwriting."""

LEAN = np.radians(65.0)
"""Angle of the sheet to the table, rad: its upper edge is farther away than its lower one."""

LOWER_EDGE = (0.46, 0.15)
"""Distance from the base's axis, and height, of the line on which the S ends, m."""

MIDDLE = 0.018
"""Metres of handwriting from its end, along its lines, to the middle of the sheet."""

BEND_RADIUS = 0.55
BULGE = 0.02
"""Metres: radius of the sheet's bend round the base, standard deviation of the bulges."""

TILT = 0.5
"""Angle of the hand below the horizontal, rad."""

RAMP = 0.15
"""Share of the time in which the pen gathers speed, and in which it loses it."""

DURATION = (10.5, 12.5)
"""Seconds of a demonstration."""

SPEED_LIMIT = 0.9
"""Share of the joint velocity limits that a demonstrator uses at most."""

FloatArray = NDArray[np.float64]


def on_sheet(letter: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a letter (M, 2) m in three dimensions, (M, 3) m."""
    along, up = SCALE * (letter[:, 0] - MIDDLE), SCALE * letter[:, 1]
    bulge = rng.normal(0.0, BULGE) * np.sin(np.pi * up / up.max())
    radius = LOWER_EDGE[0] + np.cos(LEAN) * up + np.sin(LEAN) * bulge
    height = LOWER_EDGE[1] + np.sin(LEAN) * up - np.cos(LEAN) * bulge
    angle = along / BEND_RADIUS
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)


def paced(line: FloatArray, samples: int = DEMONSTRATION_SAMPLES) -> FloatArray:
    """Return a line (M, 3) at equal steps of time, drawn evenly but for its ends, (samples, 3)."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    moving = np.concatenate([[True], np.diff(arc) > 1e-9])
    curve = CubicSpline(arc[moving] / arc[-1], line[moving])
    time = np.linspace(0.0, 1.0, 20 * samples + 1)
    ramp = np.clip(np.minimum(time, 1.0 - time) / RAMP, 0.0, 1.0)
    speed = ramp**2 * (3.0 - 2.0 * ramp)
    share = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
    return curve(np.interp(np.linspace(0.0, 1.0, samples), time, share / share[-1]))


def movement(path: FloatArray, posture: FloatArray) -> FloatArray:
    """Return configurations (T, 6) rad that draw a path (T, 3) m.

    Raises:
        RuntimeError: a point of it is out of reach.
    """
    yaw = np.arctan2(path[:, 1], path[:, 0])
    down = np.full(len(yaw), -np.sin(TILT))
    outwards = np.stack([np.cos(yaw) * np.cos(TILT), np.sin(yaw) * np.cos(TILT), down], axis=-1)
    q, error = follow(path, np.tile(posture, (len(path), 1)), outwards, iterations=40)
    if error > 1e-3:
        raise RuntimeError(f"a point of the stroke stays {error:.4f} m out of reach")
    return q


def record(console: Console) -> Demonstrations:
    """Draw, execute and record all demonstrations.

    Raises:
        RuntimeError: one of them did not succeed.
    """
    rng = np.random.default_rng(SEED)
    env = gymnasium.make("smp_gym/DrawS-v0")
    table = Table("demonstration", "duration, s", "length, m", "speed, % of limit", "outcome")
    trajectories, durations, scenes, fingers = [], [], [], []
    for number, letter in enumerate(1e-3 * demonstrations("Sshape")):
        path = paced(on_sheet(letter, rng))
        wanted = movement(path, np.asarray(PEN_CONFIGURATION))
        duration = round(rng.uniform(*DURATION) / CONTROL_PERIOD) * CONTROL_PERIOD
        scene = scene_of(wanted)
        observation, info = env.reset(options={"scene": scene})
        steps = round(duration / CONTROL_PERIOD)
        state = decode(observation, TASK).robot
        fingers.append(state.finger_angles)
        measured = [state.configuration]
        for target in resample(wanted, steps + 1)[1:]:
            action = np.zeros(7, np.float32)
            rate = (target - state.reference) / (CONTROL_PERIOD * JOINT_VELOCITY)
            action[:6] = np.clip(rate, -1.0, 1.0)
            observation, _, _, _, info = env.step(action)
            state = decode(observation, TASK).robot
            measured.append(state.configuration)
            if info["collided"]:
                break
        outcome = "success" if info["is_success"] else info["failure"] or "not drawn"
        speed = np.abs(np.diff(wanted, axis=0)).max(axis=0) * (len(wanted) - 1) / duration
        share = float((speed / JOINT_VELOCITY).max())
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        table.add_row(
            str(number + 1), f"{duration:.2f}", f"{length:.2f}", f"{100 * share:.0f}", outcome
        )
        if outcome != "success" or share > SPEED_LIMIT:
            console.print(table)
            raise RuntimeError(f"demonstration {number + 1}: {outcome}, speed {share:.2f}")
        trajectories.append(resample(np.array(measured)))
        durations.append(duration)
        scenes.append(scene)
    env.close()
    console.print(table)
    configurations = np.array(trajectories)
    return Demonstrations(
        task=TASK,
        configurations=configurations,
        gripper=np.ones(configurations.shape[:2]),
        durations=np.array(durations),
        scenes=tuple(scenes),
        metadata={
            "recorded_by": "scripts/record_demonstrations.py",
            "source": "LASA handwriting data set, Sshape",
            "seed": SEED,
            "finger_angles": np.mean(fingers, axis=0).tolist(),
            "pen": pen_path(configurations).round(6).tolist(),
        },
    )


def scene_of(configurations: FloatArray) -> Scene:
    """Return the scene without obstacles whose stroke a movement (T, 6) rad draws."""
    points = tuple((x, y, z) for x, y, z in equal_arc(pen_path(configurations)).tolist())
    demanded = (True,) * STROKE_POINTS
    goal = Goal(kind="stroke", position=points[-1], checkpoints=points, demanded=demanded)
    return Scene(task=TASK, start=tuple(configurations[0].tolist()), goals=(goal,))
