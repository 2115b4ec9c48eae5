import numpy as np
import pybullet
import pytest

from smp_gym.assets import jaco_urdf
from smp_gym.robot import kinematics, spheres
from smp_gym.robot.kinematics import (
    JOINT_LOWER,
    JOINT_UPPER,
    LINKS,
    PEN_TIP,
    REACH,
    SHOULDER_HEIGHT,
    UnreachableError,
    box_spheres,
    end_effector_pose,
    finger_spheres,
    inverse_kinematics,
    link_transforms,
    self_collision_pairs,
    sphere_centers,
)


def configurations(count, seed=0):
    return np.random.default_rng(seed).uniform(JOINT_LOWER, JOINT_UPPER, (count, 6))


class Engine:
    """The URDF in the physics engine, whose kinematics are the truth here."""

    def __init__(self):
        self.client = pybullet.connect(pybullet.DIRECT)
        self.body = pybullet.loadURDF(
            str(jaco_urdf()), useFixedBase=True, physicsClientId=self.client
        )
        count = pybullet.getNumJoints(self.body, physicsClientId=self.client)
        info = [pybullet.getJointInfo(self.body, i, self.client) for i in range(count)]
        self.joint = {row[1].decode(): row[0] for row in info}
        self.link = {row[12].decode(): row[0] for row in info}
        self.limits = {row[1].decode(): (row[8], row[9], row[11]) for row in info}

    def set(self, name, angle):
        pybullet.resetJointState(self.body, self.joint[name], angle, physicsClientId=self.client)

    def pose(self, name):
        state = pybullet.getLinkState(
            self.body, self.link[name], computeForwardKinematics=True, physicsClientId=self.client
        )
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        pose[:3, 3] = state[4]
        return pose


@pytest.fixture(scope="module")
def engine():
    engine = Engine()
    yield engine
    pybullet.disconnect(engine.client)


def test_links_are_where_the_physics_engine_has_them(engine):
    for q in configurations(30):
        for i in range(6):
            engine.set(f"j2s6s200_joint_{i + 1}", q[i])
        poses = link_transforms(q)
        for pose, name in zip(poses, LINKS, strict=True):
            np.testing.assert_allclose(pose, engine.pose(name), atol=2e-6)
        expected = engine.pose("j2s6s200_end_effector")
        np.testing.assert_allclose(end_effector_pose(q), expected, atol=2e-6)


def test_fingers_are_where_the_physics_engine_has_them(engine):
    q, angles = configurations(1)[0], np.array([0.4, 0.9, 1.1, 0.2])
    for i in range(6):
        engine.set(f"j2s6s200_joint_{i + 1}", q[i])
    names = ["finger_1", "finger_2", "finger_tip_1", "finger_tip_2"]
    for name, angle in zip(names, angles, strict=True):
        engine.set(f"j2s6s200_joint_{name}", angle)
    centers = sphere_centers(q, finger_spheres(angles))
    expected = []
    for name in ("finger_1", "finger_tip_1", "finger_2", "finger_tip_2"):
        link = f"j2s6s200_link_{name}"
        pose = engine.pose(link)
        local = spheres._link_spheres(link)[:, :3]
        expected.append(local @ pose[:3, :3].T + pose[:3, 3])
    np.testing.assert_allclose(centers, np.concatenate(expected), atol=2e-6)


def test_limits_are_those_of_the_simulated_arm(engine):
    for i in range(6):
        lower, upper, velocity = engine.limits[f"j2s6s200_joint_{i + 1}"]
        assert velocity == pytest.approx(kinematics.JOINT_VELOCITY[i], abs=1e-6)
        if i not in (0, 3, 5):
            assert (lower, upper) == pytest.approx((JOINT_LOWER[i], JOINT_UPPER[i]), abs=1e-6)


def test_batches_of_any_shape_agree_with_single_configurations():
    q = configurations(6).reshape(2, 3, 6)
    poses = end_effector_pose(q)
    assert poses.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(poses[1, 2], end_effector_pose(q[1, 2]))


def test_no_point_of_the_pen_gets_beyond_its_reach():
    # Stretched out nothing is lost but the small offsets that the joints have among themselves.
    stretched = np.array([0.0, np.pi, np.pi, 0.0, np.pi, 0.0])
    q = np.vstack([configurations(5000, seed=4), stretched])
    tip = end_effector_pose(q) @ np.append(PEN_TIP, 1.0)
    distance = np.linalg.norm(tip[:, :3] - (0.0, 0.0, SHOULDER_HEIGHT), axis=1)
    assert (distance <= REACH + 0.002).all()
    assert distance[-1] > REACH - 0.03


@pytest.mark.parametrize("with_rotation", [False, True])
def test_inverse_kinematics_reaches_random_reachable_poses(with_rotation):
    for q in configurations(200, seed=1):
        pose = end_effector_pose(q)
        found = inverse_kinematics(pose[:3, 3], pose[:3, :3] if with_rotation else None)
        assert (found >= JOINT_LOWER).all()
        assert (found <= JOINT_UPPER).all()
        reached = end_effector_pose(found)
        np.testing.assert_allclose(reached[:3, 3], pose[:3, 3], atol=1e-4)
        if with_rotation:
            np.testing.assert_allclose(reached[:3, :3], pose[:3, :3], atol=1e-4)


def test_inverse_kinematics_stays_near_its_seed():
    rng = np.random.default_rng(2)
    for q in np.clip(configurations(50, seed=3), JOINT_LOWER + 0.3, JOINT_UPPER - 0.3):
        pose = end_effector_pose(q)
        near = q + rng.uniform(-0.05, 0.05, 6)
        found = inverse_kinematics(pose[:3, 3], pose[:3, :3], near)
        # Near a singularity the branch may be left; far away it must not be taken lightly.
        assert np.abs(found - near).max() < 0.7


def test_an_unreachable_position_is_named():
    with pytest.raises(UnreachableError, match=r"2\."):
        inverse_kinematics((2.0, 0.0, 0.3))


@pytest.mark.parametrize(
    "arguments",
    [
        ((0.1, 0.2),),
        ((np.nan, 0.0, 0.3),),
        ((0.4, 0.0, 0.3), np.diag([1.0, 1.0, 2.0])),
        ((0.4, 0.0, 0.3), np.diag([1.0, 1.0, -1.0])),
        ((0.4, 0.0, 0.3), None, np.zeros(5)),
    ],
)
def test_bad_poses_are_refused(arguments):
    with pytest.raises(ValueError, match=r"position|rotation|seed"):
        inverse_kinematics(*arguments)


@pytest.mark.parametrize("q", [np.zeros(5), np.full(6, np.nan)])
def test_bad_configurations_are_refused(q):
    with pytest.raises(ValueError, match="configurations"):
        link_transforms(q)


@pytest.mark.parametrize("half", [(0.025, 0.025, 0.03), (0.01, 0.03, 0.1), (0.04, 0.04, 0.04)])
def test_box_spheres_cover_the_box(half):
    rng = np.random.default_rng(4)
    pose = np.eye(4)
    pose[:3, :3] = end_effector_pose(configurations(1)[0])[:3, :3]
    pose[:3, 3] = (0.022, 0.003, -0.004)
    spheres = box_spheres(half, pose)
    local = rng.uniform(-1, 1, (4000, 3))
    face = rng.integers(3, size=4000)
    local[np.arange(4000), face] = np.sign(local[np.arange(4000), face])
    surface = (local * half) @ pose[:3, :3].T + pose[:3, 3]
    q = configurations(1, seed=5)[0]
    hand = end_effector_pose(q)
    points = surface @ hand[:3, :3].T + hand[:3, 3]
    gaps = np.linalg.norm(points[:, None] - sphere_centers(q, spheres), axis=-1) - spheres.radius
    assert gaps.min(axis=1).max() <= 1e-9
    assert len(spheres) <= 12
    assert spheres.radius.max() <= max(min(half), 0.3 * max(half))


def test_box_spheres_refuse_a_flat_box():
    with pytest.raises(ValueError, match="half_extents"):
        box_spheres((0.1, 0.0, 0.1), np.eye(4))


def test_self_collision_pairs_join_links_that_are_apart():
    spheres = kinematics.arm_spheres()
    pairs = self_collision_pairs(spheres)
    assert len(pairs)
    assert (np.abs(spheres.link[pairs[:, 0]] - spheres.link[pairs[:, 1]]) >= 2).all()
