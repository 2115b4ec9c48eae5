"""Learning of a grasp from demonstrations: the phase at which the hand closes, and its approach.

Seen from the object's pose at the start, demonstrations of a grasp agree where it matters, though
the object stood elsewhere in each. That stretch before the hand closes is what has to be repeated:
its poses, relative to the object, become via-poses where the object stands now.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import end_effector_pose
from smp_planner.policy.tracking import gripper_event

__all__ = ["AGREEMENT", "VIA_POSES", "Grasping", "learn_grasping", "upright_pose"]

AGREEMENT = 0.002
"""m; poses agree where they are within this distance of their mean in all demonstrations."""

VIA_POSES = 5
"""Number of poses taken from the stretch in which demonstrations agree."""


@dataclass(frozen=True)
class Grasping:
    """A demonstrated grasp.

    Attributes:
        phases: (H,) in [0, 1], of the poses; the hand closes at the last of them.
        poses: (H, 4, 4) of the end effector in the frame of the object, whose origin is the
            object's centre at the start and whose z axis points up.
        finger_angles: (4,) rad, of the fingers that hold the object.
        object_in_hand: (4, 4) pose of the held object in the end-effector frame.
    """

    phases: FloatArray
    poses: FloatArray
    finger_angles: FloatArray
    object_in_hand: FloatArray

    @property
    def phase(self) -> float:
        """Phase at which the hand closes."""
        return float(self.phases[-1])


def upright_pose(position: FloatArray, yaw: float) -> FloatArray:
    """Return the pose (4, 4) of something upright at (3,) m, turned by `yaw` rad."""
    pose = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = position
    return pose


def learn_grasping(demonstrations: Demonstrations) -> Grasping | None:
    """Return the grasp that demonstrations show, or None if the object is in the hand throughout.

    Raises:
        ValueError: demonstrations that begin with the object on the table do not close the hand,
            disagree about where, or do not say how the object is held.
    """
    objects = [scene.manipulated for scene in demonstrations.scenes]
    frames = [upright_pose(np.array(o.position), o.yaw) for o in objects if o and o.position]
    if not frames:
        return None
    event = gripper_event(demonstrations.gripper)
    missing = {"finger_angles", "object_in_hand"} - set(demonstrations.metadata)
    if len(frames) < len(objects) or event is None or event.command < 0.0 or missing:
        raise ValueError(
            "demonstrations that begin with the object on the table must all do so, close the "
            f"hand, and have the metadata finger_angles and object_in_hand; missing: "
            f"{', '.join(sorted(missing)) or 'none'}"
        )
    hands = end_effector_pose(demonstrations.configurations)
    relative = np.linalg.inv(np.array(frames))[:, None] @ hands
    mean = relative.mean(axis=0)
    spread = np.linalg.norm((relative - mean)[..., :3, 3], axis=-1).max(axis=0)
    last = len(spread) - 1
    grasp = round(event.phase * last)
    agreeing = spread[: grasp + 1] <= AGREEMENT
    if not agreeing[-1]:
        raise ValueError(
            "demonstrations must agree about the hand's pose relative to the object when it "
            f"closes, to {AGREEMENT} m; they differ by {spread[grasp]:.4f} m"
        )
    apart = np.flatnonzero(~agreeing)
    begin = int(apart[-1]) + 1 if len(apart) else 0
    samples = np.linspace(begin, grasp, VIA_POSES).round().astype(int)
    poses = mean[samples]
    left, _, right = np.linalg.svd(poses[:, :3, :3])
    poses[:, :3, :3] = left @ right
    return Grasping(
        phases=samples / last,
        poses=poses,
        finger_angles=np.array(demonstrations.metadata["finger_angles"], np.float64),
        object_in_hand=np.array(demonstrations.metadata["object_in_hand"], np.float64),
    )
