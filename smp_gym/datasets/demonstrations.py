"""Demonstrations: sets of recorded trajectories of one task, as frozen data in an ``.npz`` file.

A demonstration is sampled at T equal steps of phase, from the start of the movement (phase 0) to
the release or the final pose (phase 1), where the arm is at rest. Beside the arm's configuration it
holds the *commanded* gripper reference (0 open, 1 closed): in tasks that release an object the
command is 1 until the object is let go and 0 from then on, so that the phase of the release can be
read from the data (`Demonstrations.release_phase`).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, checked_array, checked_count, shown
from smp_gym.assets import asset_path
from smp_gym.atomic_files import replacing
from smp_gym.robot.pen import pen_path
from smp_gym.scene import Scene
from smp_gym.tasks.registry import task_definition
from smp_gym.untrusted_files import parse_json, read_arrays, read_file

__all__ = ["DEMONSTRATION_SAMPLES", "FORMAT_VERSION", "Demonstrations", "resample"]

DEMONSTRATION_SAMPLES = 200
"""Samples of phase of each demonstration that ships with the package."""

FORMAT_VERSION = 1
"""Version of the file format that `Demonstrations.save` writes."""

_ARRAYS = ("configurations", "gripper", "durations")


def _checked_array(name: str, value: Any, shape: tuple[int | None, ...]) -> FloatArray:
    """Return a read-only float64 copy of `value`; None in `shape` matches any length."""
    array = checked_array(f"Demonstrations.{name}", value, shape)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """N demonstrations of one task, each T samples of a D-joint arm at equal steps of phase.

    Attributes:
        task: name of the task, one of `smp_gym.tasks.task_names`.
        configurations: (N, T, D) rad, measured joint angles; N >= 2, T >= 2.
        gripper: (N, T) commanded gripper reference, 0 open to 1 closed.
        durations: (N,) s, time from phase 0 to phase 1.
        scenes: the scene of each demonstration, N of them.
        metadata: anything else worth keeping, as JSON values.

    Raises:
        ValueError: arrays of unequal dimension, fewer than two demonstrations, values that are not
            finite or out of range; the message names the attribute and the value.
    """

    task: str
    configurations: FloatArray
    gripper: FloatArray
    durations: FloatArray
    scenes: tuple[Scene, ...]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        task_definition(self.task)
        configurations = _checked_array("configurations", self.configurations, (None, None, None))
        count, samples, _ = configurations.shape
        if count < 2:
            raise ValueError(f"Demonstrations needs at least two demonstrations, got {count}")
        if samples < 2:
            raise ValueError(f"a demonstration needs at least two samples, got {samples}")
        gripper = _checked_array("gripper", self.gripper, (count, samples))
        if gripper.min() < 0.0 or gripper.max() > 1.0:
            raise ValueError(
                "Demonstrations.gripper must lie in [0, 1], got values from "
                f"{gripper.min()} to {gripper.max()}"
            )
        durations = _checked_array("durations", self.durations, (count,))
        if durations.min() <= 0.0:
            raise ValueError(f"Demonstrations.durations must be positive, got {durations.min()}")
        if not isinstance(self.scenes, Sequence) or not all(
            isinstance(scene, Scene) for scene in self.scenes
        ):
            raise ValueError(f"Demonstrations.scenes must be Scenes, got {shown(self.scenes)}")
        scenes = tuple(self.scenes)
        if len(scenes) != count:
            raise ValueError(
                f"Demonstrations.scenes must hold one scene for each of {count} demonstrations, "
                f"got {len(scenes)}"
            )
        for scene in scenes:
            if scene.task != self.task:
                raise ValueError(
                    f"Demonstrations.scenes must be of task {self.task!r}, got {scene.task!r}"
                )
        object.__setattr__(self, "configurations", configurations)
        object.__setattr__(self, "gripper", gripper)
        object.__setattr__(self, "durations", durations)
        object.__setattr__(self, "scenes", scenes)
        if not isinstance(self.metadata, Mapping):
            raise ValueError(
                f"Demonstrations.metadata must be a mapping, got {shown(self.metadata)}"
            )
        object.__setattr__(self, "metadata", dict(self.metadata))

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        count, samples, joints = self.configurations.shape
        return f"Demonstrations({self.task}, {count} of {samples} x {joints})"

    def __len__(self) -> int:
        return len(self.configurations)

    @property
    def mean(self) -> FloatArray:
        """(T, D) rad, mean over the demonstrations at each phase."""
        return self.configurations.mean(axis=0)

    @property
    def pen_paths(self) -> FloatArray:
        """(N, T, 3) m, where the pen's tip is: the demonstrations of DrawS in Cartesian space.

        By forward kinematics from the configurations, in the base frame.

        Raises:
            ValueError: demonstrations of another task, in which the hand holds no pen.
        """
        if self.task != "DrawS":
            raise ValueError(f"only demonstrations of DrawS have pen_paths; these are {self.task}")
        return pen_path(self.configurations)

    @property
    def release_phase(self) -> float:
        """Mean phase at which the gripper is first commanded open after having been closed.

        1.0 where the gripper never opens: then there is nothing to release.
        """
        samples = self.gripper.shape[1]
        closed = np.maximum.accumulate(self.gripper >= 0.5, axis=1)
        opened = closed & (self.gripper < 0.5)
        first = np.where(opened.any(axis=1), opened.argmax(axis=1), samples - 1)
        return float(first.mean() / (samples - 1))

    def save(self, path: str | Path) -> None:
        """Write the demonstrations to `path` (compressed ``.npz``, no pickle).

        Task, scenes and metadata are one JSON string inside. The same demonstrations give the same
        bytes.

        Raises:
            ValueError: `path` does not end in ``.npz``, or the metadata is not JSON.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise ValueError(f"path must end in .npz, got {str(path)!r}")
        content = self.to_bytes()
        with replacing(path) as aside:
            aside.write_bytes(content)

    def to_bytes(self) -> bytes:
        """Return the content of the file that `save` writes.

        Raises:
            ValueError: the metadata is not JSON.
        """
        header = {
            "version": FORMAT_VERSION,
            "task": self.task,
            "scenes": [scene.model_dump(mode="json") for scene in self.scenes],
            "metadata": self.metadata,
        }
        try:
            text = json.dumps(header, sort_keys=True, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"metadata must be JSON values, got {self.metadata!r}") from error
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, header=np.array(text), **arrays)
        return buffer.getvalue()

    @classmethod
    def load(cls, task_or_path: str | Path) -> Demonstrations:
        """Return the demonstrations that ship for a task, or those of a file.

        Args:
            task_or_path: name of a task, or path of a file that `save` wrote.

        Raises:
            FileNotFoundError: neither a task with demonstrations nor an existing file.
            ValueError: the file is corrupt, of another version, or holds what `Demonstrations`
                does not allow; the message names the file.
        """
        path = _locate(task_or_path)
        return cls.parse(read_file(path), str(path))

    @classmethod
    def parse(cls, content: bytes, source: str) -> Demonstrations:
        """Return the demonstrations of a file that `save` wrote.

        Args:
            content: of the whole file.
            source: its name, for errors.

        Raises:
            ValueError: as `load`.
        """
        try:
            arrays = read_arrays(content, "the file")
            missing = {"header", *_ARRAYS} - set(arrays)
            if missing:
                raise ValueError(f"no entry {', '.join(sorted(missing))}")
            header = parse_json(str(arrays["header"]), "the header")
            if not isinstance(header, dict) or header.get("version") != FORMAT_VERSION:
                version = header.get("version") if isinstance(header, dict) else header
                raise ValueError(f"format version must be {FORMAT_VERSION}, got {shown(version)}")
            wanted = {"version", "task", "scenes", "metadata"}
            if set(header) != wanted or not isinstance(header["scenes"], list):
                raise ValueError(f"the header must hold {', '.join(sorted(wanted))}")
            return cls(
                task=header["task"],
                scenes=tuple(Scene.model_validate(s) for s in header["scenes"]),
                metadata=header["metadata"],
                **{name: arrays[name] for name in _ARRAYS},
            )
        except (ValueError, TypeError) as error:
            raise ValueError(f"{source} is not a file of demonstrations: {error}") from error


def _locate(task_or_path: str | Path) -> Path:
    if not isinstance(task_or_path, str | Path):
        raise ValueError(f"task or path must be a text, got {shown(task_or_path)}")
    folder = asset_path("demonstrations")
    shipped = sorted(path.stem for path in folder.glob("*.npz"))
    if str(task_or_path) in shipped:
        return folder / f"{task_or_path}.npz"
    path = Path(task_or_path)
    if not path.is_file():
        raise FileNotFoundError(
            f"no demonstrations at {str(path)!r}: give a file, or a task, one of "
            f"{', '.join(shipped)}"
        )
    return path


def resample(values: FloatArray, samples: int = DEMONSTRATION_SAMPLES) -> FloatArray:
    """Return a trajectory recorded at equal time steps, at `samples` equal steps of phase.

    Args:
        values: (M, D) samples at equal steps, M >= 4; any unit.
        samples: how many to return, at least 2.

    Returns:
        (samples, D), a cubic spline through the given samples; the first and last are kept exactly.
    """
    from scipy.interpolate import CubicSpline

    values = checked_array("values", values, (None, None))
    if len(values) < 4:
        raise ValueError(f"values must have shape (M >= 4, D), got {values.shape}")
    samples = checked_count("samples", samples, least=2)
    spline = CubicSpline(np.linspace(0.0, 1.0, len(values)), values)
    result: FloatArray = spline(np.linspace(0.0, 1.0, samples))
    result[0], result[-1] = values[0], values[-1]
    return result
