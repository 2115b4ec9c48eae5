"""The arm's collision shapes in PyBullet, for tests of what the samplers say."""

import numpy as np
import pybullet

from smp_gym.assets import jaco_urdf
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.scene import Obstacle
from smp_gym.tasks.placement.rules import HELD_OBJECT_POSE


def _euler(matrix):
    """Return yaw, pitch and roll of a rotation matrix."""
    return (
        np.arctan2(matrix[1, 0], matrix[0, 0]),
        -np.arcsin(np.clip(matrix[2, 0], -1, 1)),
        np.arctan2(matrix[2, 1], matrix[2, 2]),
    )


class Bullet:
    """The arm's real collision shapes with a held box, and obstacles, in a client of its own."""

    def __init__(self, held=HELD_OBJECT_POSE):
        self.held = held
        self.client = pybullet.connect(pybullet.DIRECT)
        self.arm = pybullet.loadURDF(
            str(jaco_urdf()), useFixedBase=True, physicsClientId=self.client
        )
        names = {}
        for joint in range(pybullet.getNumJoints(self.arm, physicsClientId=self.client)):
            info = pybullet.getJointInfo(self.arm, joint, physicsClientId=self.client)
            names[info[1].decode()] = joint
        self.joints = [names[f"j2s6s200_joint_{i}"] for i in range(1, 7)]
        self.fingers = [
            names[f"j2s6s200_joint_finger_{part}"] for part in ("1", "2", "tip_1", "tip_2")
        ]
        self.box = self.body(Obstacle(shape="box", position=(0, 0, 0), size=(0.025, 0.025, 0.03)))
        angles = Demonstrations.load("Placement").metadata["finger_angles"]
        for joint, angle in zip(self.fingers, angles, strict=True):
            pybullet.resetJointState(self.arm, joint, angle, physicsClientId=self.client)

    def body(self, obstacle):
        x, y, z = obstacle.size
        if obstacle.shape == "box":
            kind = {"shapeType": pybullet.GEOM_BOX, "halfExtents": (x, y, z)}
        elif obstacle.shape == "cylinder":
            kind = {"shapeType": pybullet.GEOM_CYLINDER, "radius": x, "height": 2 * z}
        else:
            kind = {"shapeType": pybullet.GEOM_SPHERE, "radius": x}
        shape = pybullet.createCollisionShape(**kind, physicsClientId=self.client)
        return pybullet.createMultiBody(
            0.0, shape, -1, obstacle.position, obstacle.quaternion, physicsClientId=self.client
        )

    def clearance(self, configurations, obstacles):
        """Return the least distance (m, up to 0.3) of arm and box to obstacles on the way."""
        bodies = [self.body(obstacle) for obstacle in obstacles]
        least = 0.3
        for q in configurations:
            for joint, angle in zip(self.joints, q, strict=True):
                pybullet.resetJointState(self.arm, joint, angle, physicsClientId=self.client)
            state = pybullet.getLinkState(
                self.arm,
                self.joints[-1],
                computeForwardKinematics=True,
                physicsClientId=self.client,
            )
            pose = np.eye(4)
            pose[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
            pose[:3, 3] = state[4]
            held = pose @ kinematics.END_EFFECTOR @ self.held
            z, y, x = _euler(held[:3, :3])
            pybullet.resetBasePositionAndOrientation(
                self.box,
                held[:3, 3],
                pybullet.getQuaternionFromEuler((x, y, z)),
                physicsClientId=self.client,
            )
            for body in bodies:
                for moving in (self.arm, self.box):
                    points = pybullet.getClosestPoints(
                        moving, body, least, physicsClientId=self.client
                    )
                    least = min([least, *(p[8] for p in points)])
        for body in bodies:
            pybullet.removeBody(body, physicsClientId=self.client)
        return least
