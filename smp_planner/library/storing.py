"""The file of a learned primitive: demonstrations, settings and robot; runs no code.

The primitive is learned again on loading, which takes milliseconds and keeps file and code from
drifting apart.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray, checked_array, checked_number, shown
from smp_gym.robot.kinematics import SphereSet
from smp_gym.untrusted_files import parse_json, read_file
from smp_planner.collision.robot_model import RobotModel
from smp_planner.library.signals import Recorded
from smp_planner.library.urdf import Robot
from smp_planner.occupancy.archive import read_archive, write_archive
from smp_planner.planning.settings import PriorSettings

__all__ = ["read_primitive", "write_primitive"]

_HEADER = {"format": "smp_planner.primitive", "version": 1}
_PRISMATIC_HEADER = {"format": "smp_planner.primitive", "version": 2}
"""Of robots with prismatic joints: who knows version 1 alone would take these for revolute."""

_CHAIN = ("base", "joint_origins", "end_effector", "lower", "upper", "velocity")
_LINKS = ("base_links", "tip_links")
_SPHERES = ("link", "center", "radius")


def write_primitive(
    path: str | Path,
    demonstrations: Sequence[FloatArray],
    settings: PriorSettings,
    robot: Robot | None,
    recorded: Recorded,
) -> None:
    """Write what a primitive is learned from as an `.npz` without pickled objects."""
    arrays: dict[str, NDArray[Any]] = {
        "samples": np.concatenate(demonstrations),
        "lengths": np.array([len(d) for d in demonstrations]),
        "settings": np.array(settings.model_dump_json()),
    }
    if recorded.durations is not None:
        arrays["durations"] = recorded.durations
    if recorded.values:
        arrays["signals"] = np.array(json.dumps(list(recorded.values)))
        arrays["signal_phases"] = np.concatenate(recorded.phases)
        each = [np.concatenate(values) for values in recorded.values.values()]
        arrays["signal_values"] = np.stack(each)
    if robot is not None:
        arrays["joints"] = np.array(json.dumps(robot.joints))
        arrays["continuous"] = np.array(robot.continuous)
        arrays["prismatic"] = robot.model.prismatic
        arrays["standing"] = np.array(json.dumps(dict(robot.standing)))
        arrays["bodies"] = np.array(json.dumps(robot.bodies))
        arrays["held"] = np.array(json.dumps(robot.held))
        pairs = sorted([min(pair), max(pair)] for pair in robot.touching)
        arrays["touching"] = np.array(json.dumps(pairs))
        for field in _LINKS:
            links = {name: pose.tolist() for name, pose in getattr(robot, field).items()}
            arrays[field] = np.array(json.dumps(links))
        arrays |= {f"robot_{name}": getattr(robot.model, name) for name in _CHAIN}
        arrays |= {f"spheres_{name}": getattr(robot.model.spheres, name) for name in _SPHERES}
    slides = robot is not None and robot.model.prismatic.any()
    write_archive(path, _PRISMATIC_HEADER if slides else _HEADER, arrays)


def read_primitive(
    path: str | Path,
) -> tuple[list[FloatArray], PriorSettings, Robot | None, Recorded]:
    """Read what `write_primitive` wrote.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it is damaged, is something else, or is of another version.
    """
    arrays = read_archive(read_file(path), str(path), _HEADER, _PRISMATIC_HEADER)
    try:
        samples, lengths = arrays["samples"], arrays["lengths"]
        whole = lengths.dtype.kind in "iu" and lengths.ndim == 1 and (lengths >= 2).all()
        if samples.ndim != 2 or not whole or lengths.sum() != len(samples):
            raise ValueError(f"{len(samples)} samples do not have the lengths {lengths}")
        demonstrations = np.split(samples, np.cumsum(lengths)[:-1])
        recorded = _recorded(arrays, lengths)
        settings = PriorSettings.model_validate_json(str(arrays["settings"]))
        robot = None
        if "joints" in arrays:
            joints = parse_json(str(arrays["joints"]), "joints")
            robot = Robot(
                RobotModel(
                    **{name: arrays[f"robot_{name}"] for name in _CHAIN},
                    spheres=SphereSet(*(arrays[f"spheres_{name}"] for name in _SPHERES)),
                    collision_pairs=np.empty((0, 2), np.int64),
                    # The first files of version 1 hold revolute joints only.
                    prismatic=arrays.get("prismatic", np.zeros(len(joints), np.bool_)),
                ),
                tuple(str(joint) for joint in joints),
                tuple(bool(entry) for entry in arrays["continuous"]),
                {
                    name: checked_number(f"standing[{name!r}]", position)
                    for name, position in _named(arrays, "standing").items()
                },
                base_links=_poses(arrays, "base_links"),
                tip_links=_poses(arrays, "tip_links"),
                bodies=tuple(str(name) for name in _listed(arrays, "bodies")),
                held=tuple(str(name) for name in _listed(arrays, "held")),
                touching=frozenset(
                    frozenset(map(str, pair)) for pair in _listed(arrays, "touching")
                ),
            )
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error
    return demonstrations, settings, robot, recorded


def _listed(arrays: Mapping[str, NDArray[Any]], field: str) -> list[Any]:
    """Return what a field lists; files of before do not have it."""
    if field not in arrays:
        return []
    given = parse_json(str(arrays[field]), field)
    if not isinstance(given, list):
        raise ValueError(f"{field} must be a list, got {shown(given)}")
    return given


def _poses(arrays: Mapping[str, NDArray[Any]], field: str) -> dict[str, FloatArray]:
    return {
        name: checked_array(f"{field}[{name!r}]", pose, (4, 4))
        for name, pose in _named(arrays, field).items()
    }


def _recorded(arrays: Mapping[str, NDArray[Any]], lengths: NDArray[Any]) -> Recorded:
    durations = arrays.get("durations")
    if durations is not None:
        durations = checked_array("durations", durations, (len(lengths),))
    if "signals" not in arrays:
        return Recorded(durations)
    names = [str(name) for name in parse_json(str(arrays["signals"]), "signals")]
    ends, samples = np.cumsum(lengths)[:-1], int(lengths.sum())
    phases = checked_array("signal_phases", arrays["signal_phases"], (samples,))
    values = checked_array("signal_values", arrays["signal_values"], (len(names), samples))
    each = {name: np.split(row, ends) for name, row in zip(names, values, strict=True)}
    recorded = Recorded(durations, np.split(phases, ends), each)
    recorded.signals()
    return recorded


def _named(arrays: Mapping[str, NDArray[Any]], field: str) -> dict[str, Any]:
    """Return what a field says by name; files of before do not have it."""
    if field not in arrays:
        return {}
    given = parse_json(str(arrays[field]), field)
    if not isinstance(given, dict):
        raise ValueError(f"{field} must hold values by name, got {shown(given)}")
    return given
