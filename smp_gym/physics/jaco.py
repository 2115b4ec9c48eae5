"""The arm in the physics world: a Kinova JACO j2s6s200 with tracking joints and two fingers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.observation import CONTROL_PERIOD, GRIPPER_RATE, RobotState
from smp_gym.physics.world import BulletWorld
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, JOINT_VELOCITY, LINKS

__all__ = ["ACTION_SIZE", "ARM", "FINGER_CLOSED", "HAND_LINKS", "Jaco", "set_grip_friction"]

ACTION_SIZE = 7
"""Six joint velocities and the gripper's rate."""

ARM = "jaco"
"""Name of the arm's body in its world."""

FINGER_CLOSED = 1.51
"""rad; command to the proximal finger joints at gripper reference 1, their upper limit."""

FINGER_LINKS = tuple(f"j2s6s200_link_finger_{part}" for part in ("1", "2", "tip_1", "tip_2"))
PEN_LINK = "pen"
HAND_LINKS = (LINKS[6], *FINGER_LINKS, PEN_LINK)
"""Names of palm, fingers and, where the hand has one, pen."""

_ARM_JOINTS = tuple(f"j2s6s200_joint_{i}" for i in range(1, 7))
_FINGER_JOINTS = tuple(f"j2s6s200_joint_finger_{part}" for part in ("1", "2", "tip_1", "tip_2"))
_END_EFFECTOR_JOINT = "j2s6s200_joint_end_effector"

# rad, where the fingertips meet the pen, and where their motors stop: pressing on a rod of the same
# hand would hold nothing, and nearly double the solver's work.
_FINGER_CLOSED_ON_PEN = 1.1788

_UPRIGHT = (0.0, np.pi, np.pi, 0.0, np.pi, 0.0)
# Enough to carry the object at full speed, and gentle enough not to push the arm off its reference.
_FINGER_FORCE = 1.2  # N m
_FINGER_VELOCITY = 1.0  # rad/s, the vendor's limit
_FINGER_GAIN = 0.3
_GRIP_MARGIN = 0.01  # rad, above the wobble of fingers at rest
_GRIP_FRICTION = 1.0


def set_grip_friction(world: BulletWorld, body: int, link: int) -> None:
    """Give an object's link the friction by which fingers hold it."""
    pybullet.changeDynamics(
        body, link, lateralFriction=_GRIP_FRICTION, physicsClientId=world.client
    )


class Jaco:
    """The arm, standing on the table at the origin of a world.

    Actions are integrated into a reference that the joints track. Were they added to the measured
    angles instead, the arm would sag a little with every step.

    Args:
        world: where it stands.
        urdf: its description.
        configuration: (6,) joint angles, rad, in which it starts.
    """

    def __init__(self, world: BulletWorld, urdf: Path, configuration: Sequence[float]) -> None:
        self._world = world
        self._client = world.client
        self._body = world.load_urdf(
            ARM,
            urdf,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE
            | pybullet.URDF_USE_SELF_COLLISION
            | pybullet.URDF_MAINTAIN_LINK_ORDER,
        )
        joints = {}
        effort = {}
        for joint in range(pybullet.getNumJoints(self._body, physicsClientId=self._client)):
            info = pybullet.getJointInfo(self._body, joint, physicsClientId=self._client)
            joints[info[1].decode()] = joint
            effort[info[1].decode()] = float(info[10])
        self._arm = [joints[name] for name in _ARM_JOINTS]
        self._fingers = [joints[name] for name in _FINGER_JOINTS]
        self._end_effector = joints[_END_EFFECTOR_JOINT]
        self._effort = [effort[name] for name in _ARM_JOINTS]
        self._velocity_limit = np.asarray(JOINT_VELOCITY, np.float64)
        self._links = {
            name: link
            for link in range(-1, len(joints))
            if (name := world.part(self._body, link)) in (*LINKS, *FINGER_LINKS, PEN_LINK)
        }
        self._closed = _FINGER_CLOSED_ON_PEN if PEN_LINK in self._links else FINGER_CLOSED
        self._exclude_contacts()
        self._set_dynamics()
        for joint, angle in zip(self._arm, configuration, strict=True):
            pybullet.resetJointState(self._body, joint, angle, physicsClientId=self._client)
        self._grips = False
        self.set_reference(configuration, 0.0)

    def _exclude_contacts(self) -> None:
        """Leave only those contacts within the arm that the planners' spheres know, too."""
        spheres = kinematics.arm_spheres()
        pairs = kinematics.self_collision_pairs(spheres)
        apart = {frozenset(pair) for pair in spheres.link[pairs].tolist()}
        for first, second in combinations(self._links, 2):
            fingers = {first, second} & {*FINGER_LINKS, PEN_LINK}
            a = LINKS[6] if first in HAND_LINKS else first
            b = LINKS[6] if second in HAND_LINKS else second
            across = len(fingers - {PEN_LINK}) == 2 and first[-1] != second[-1]
            if across or frozenset((LINKS.index(a), LINKS.index(b))) in apart:
                continue
            self._set_contact(self._body, self._links[first], self._links[second], False)
        # The base stands on the table.
        table = self._world.body("table")
        self._set_contact(table, -1, self._links[LINKS[0]], False)

    def _set_contact(self, other: int, other_link: int, link: int, enabled: bool) -> None:
        pybullet.setCollisionFilterPair(
            self._body, other, link, other_link, int(enabled), physicsClientId=self._client
        )

    def _set_dynamics(self) -> None:
        for link in (-1, *self._links.values()):
            pybullet.changeDynamics(
                self._body,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=self._client,
            )
        # The fingers are driven together: the object stays where the hand closed on it.
        gear = pybullet.createConstraint(
            self._body,
            self._fingers[0],
            self._body,
            self._fingers[1],
            pybullet.JOINT_GEAR,
            (0.0, 0.0, 1.0),
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
            physicsClientId=self._client,
        )
        pybullet.changeConstraint(
            gear, gearRatio=-1, maxForce=50, erp=0.3, physicsClientId=self._client
        )

    @property
    def reference(self) -> FloatArray:
        """(6,) rad: the joint angles that the motors track."""
        return self._reference.copy()

    @property
    def gripper_reference(self) -> float:
        """0 (open) to 1 (closed): the opening that the finger motors track."""
        return self._gripper

    def set_reference(self, configuration: Sequence[float] | FloatArray, gripper: float) -> None:
        """Set what the motors track: (6,) rad, and 0 (open) to 1 (closed)."""
        self._reference = np.array(configuration, np.float64)
        self._gripper = float(gripper)
        self._opening = False
        self._set_grip(True)

    def _set_grip(self, grips: bool) -> None:
        if grips == self._grips:
            return
        self._grips = grips
        # The engine keeps an anchored point of contact, and the friction that it began with, as
        # long as it sticks: without its anchors going, too, friction would not go at all.
        for name in (LINKS[6], *FINGER_LINKS):
            pybullet.changeDynamics(
                self._body,
                self._links[name],
                lateralFriction=_GRIP_FRICTION if grips else 0.0,
                frictionAnchor=int(grips),
                physicsClientId=self._client,
            )

    def integrate(self, action: FloatArray) -> None:
        """Advance the reference by one environment step.

        Args:
            action: (7,) six joint velocities as fractions of `JOINT_VELOCITY`, and the gripper's
                rate as a fraction of `GRIPPER_RATE`, positive closing.
        """
        advanced = self._reference + action[:6] * self._velocity_limit * CONTROL_PERIOD
        self._reference = np.minimum(np.maximum(advanced, JOINT_LOWER), JOINT_UPPER)
        gripper = self._gripper + float(action[6]) * GRIPPER_RATE * CONTROL_PERIOD
        gripper = min(max(gripper, 0.0), 1.0)
        if gripper != self._gripper:
            self._opening = gripper < self._gripper
        self._gripper = gripper

    def track(self) -> None:
        """Command the motors towards the reference for the coming environment step."""
        states = pybullet.getJointStates(self._body, self._arm, physicsClientId=self._client)
        measured = np.array([state[0] for state in states])
        # The velocity cap spreads the motion over the whole step; without it the motors would jump.
        velocity = np.abs(self._reference - measured) / CONTROL_PERIOD
        velocity = np.minimum(np.maximum(velocity, 1e-3), 1.05 * self._velocity_limit)
        for joint, target, cap, effort in zip(
            self._arm, self._reference.tolist(), velocity.tolist(), self._effort, strict=True
        ):
            pybullet.setJointMotorControl2(
                self._body,
                joint,
                pybullet.POSITION_CONTROL,
                targetPosition=target,
                positionGain=1.0,
                velocityGain=1.0,
                force=effort,
                maxVelocity=cap,
                physicsClientId=self._client,
            )
        proximal = min(self._gripper * FINGER_CLOSED, self._closed)
        for joint, target in zip(self._fingers, (proximal, proximal, 0.0, 0.0), strict=True):
            pybullet.setJointMotorControl2(
                self._body,
                joint,
                pybullet.POSITION_CONTROL,
                targetPosition=target,
                positionGain=_FINGER_GAIN,
                force=_FINGER_FORCE,
                maxVelocity=_FINGER_VELOCITY,
                physicsClientId=self._client,
            )

    def carried(self, pose: NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
        """Return the pose of a frame fixed to the hand.

        Args:
            pose: (4, 4) its pose in the end-effector frame.

        Returns:
            Position (3,) m and quaternion (4,) in the base frame.
        """
        state = self.state()
        hand = Rotation.from_quat(state.end_effector_quaternion)
        position = state.end_effector_position + hand.as_matrix() @ pose[:3, 3]
        return position, (hand * Rotation.from_matrix(np.array(pose[:3, :3]))).as_quat()

    def motion(
        self, point: NDArray[np.floating[Any]]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return position and velocity of a point fixed to the hand.

        Args:
            point: (3,) m, in the end-effector frame.

        Returns:
            Position (3,) m, quaternion (4,) of the end effector, linear velocity (3,) m/s of the
            point and angular velocity (3,) rad/s, in the base frame.
        """
        link = pybullet.getLinkState(
            self._body,
            self._end_effector,
            computeLinkVelocity=True,
            computeForwardKinematics=True,
            physicsClientId=self._client,
        )
        origin, quaternion, linear, angular = (np.array(link[i]) for i in (4, 5, 6, 7))
        rotation = np.reshape(pybullet.getMatrixFromQuaternion(link[5]), (3, 3))
        offset = rotation @ point
        (a, b, c), (x, y, z) = angular.tolist(), offset.tolist()
        turning = np.array([b * z - c * y, c * x - a * z, a * y - b * x])
        return origin + offset, quaternion, linear + turning, angular

    def put(self, configuration: Sequence[float]) -> None:
        """Put the arm into a configuration (6,) rad, at rest; the fingers stay as they are."""
        for joint, angle in zip(self._arm, configuration, strict=True):
            pybullet.resetJointState(self._body, joint, angle, physicsClientId=self._client)

    def stretch(self) -> None:
        """Put the arm upright with the fingers open, where no part of it is near another."""
        self.put(_UPRIGHT)
        for joint in self._fingers:
            pybullet.resetJointState(self._body, joint, 0.0, physicsClientId=self._client)

    def state(self) -> RobotState:
        """Return the measured state."""
        states = pybullet.getJointStates(
            self._body, self._arm + self._fingers, physicsClientId=self._client
        )
        angles = np.array([state[0] for state in states])
        rates = np.array([state[1] for state in states])
        link = pybullet.getLinkState(
            self._body,
            self._end_effector,
            computeForwardKinematics=True,
            physicsClientId=self._client,
        )
        return RobotState(
            configuration=angles[:6],
            reference=self.reference,
            joint_velocity=rates[:6],
            finger_angles=angles[6:],
            gripper_reference=self._gripper,
            finger_velocity=rates[6:],
            end_effector_position=np.array(link[4]),
            end_effector_quaternion=np.array(link[5]),
        )

    def release(self, state: RobotState) -> None:
        """Take the friction from a hand that opens, until it closes again.

        An object may otherwise stick to the palm or to a finger that is withdrawn.

        Args:
            state: as measured after the last step.
        """
        self._set_grip(not self._opening or self.squeezes(state))

    def squeezes(self, state: RobotState) -> bool:
        """Return whether the fingers are commanded further than they have closed.

        They then press on what is between them. When the gripper opens, the command is the first
        to fall below the measured angle: that is where a release begins.
        """
        first, second, *_ = state.finger_angles.tolist()
        return self._gripper * FINGER_CLOSED > (first + second) / 2.0 + _GRIP_MARGIN
