"""Frames of MoveIt's scenes: where links, the file and the user say that they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import shown
from smp_gym.datasets.moveit_fields import WORLD
from smp_gym.geometry.pose import Pose, checked_pose
from smp_planner.library.urdf import Robot

__all__ = ["checked_frames", "frame_poses", "pose_above"]


def checked_frames(frames: Any) -> dict[str, Pose]:
    """Return poses of frames that a user gave, by name.

    Raises:
        ValueError: not a mapping of names to positions and quaternions.
    """
    if frames is None:
        return {}
    if not isinstance(frames, Mapping):
        raise ValueError(f"frames must map names to positions and quaternions, got {shown(frames)}")
    placed = {}
    for name, given in frames.items():
        if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
            raise ValueError(f"frames[{name!r}] must be (position, quaternion), got {shown(given)}")
        placed[str(name).lstrip("/")] = checked_pose(*given, where=f"frames[{name!r}].")
    return placed


def frame_poses(
    names: Sequence[str],
    mentioned: Sequence[str],
    fixed: Mapping[str, tuple[str, Pose]],
    given: Mapping[str, Pose],
    robot: Robot | None,
) -> dict[str, Pose]:
    """Return where frames are in the robot's base frame.

    Args:
        names: of the frames.
        mentioned: frames that the files name.
        fixed: of frames their parents, and their poses there.
        given: the user's, by name.
        robot: whose links are frames, too.
    """
    known = {WORLD, *mentioned, *fixed, *(parent for parent, _ in fixed.values())}
    unknown = sorted(set(given) - known)
    if unknown:
        raise ValueError(f"frames must be of {', '.join(sorted(known))}, got {', '.join(unknown)}")
    placed = dict(given)
    for name, pose in {} if robot is None else robot.base_links.items():
        # A root link of that name which stands elsewhere is not what files call the world.
        if name == WORLD and not np.array_equal(pose, np.eye(4)):
            continue
        placed.setdefault(name, Pose(Rotation.from_matrix(pose[:3, :3]), pose[:3, 3]))
    above = {name: pose_above(name, fixed, placed) for name in dict.fromkeys(names)}
    left = sorted({top for top, _ in above.values()} - set(placed))
    if left and (given or len(left) > 1 or (robot is not None and left != [WORLD])):
        raise ValueError(
            f"frames must say where {' and '.join(left)} are in the robot's base frame, got "
            f"{', '.join(given) or 'none'}"
        )
    return {
        name: placed.get(top, Pose.identity()).then(pose) for name, (top, pose) in above.items()
    }


def pose_above(
    name: str, fixed: Mapping[str, tuple[str, Pose]], placed: Mapping[str, Pose]
) -> tuple[str, Pose]:
    """Return the nearest frame above whose place is known, or the last, and the pose in it."""
    pose, passed = Pose.identity(), {name}
    while name not in placed and name in fixed:
        name, within = fixed[name]
        pose = within.then(pose)
        if name in passed:
            raise ValueError(f"fixed_frame_transforms place {name!r} in itself")
        passed.add(name)
    return name, pose
