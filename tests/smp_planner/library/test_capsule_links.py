"""Links whose collision shapes are capsules: covers, and distances of PyBullet to the same URDF."""

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from smp_gym.scene import Obstacle
from smp_planner.collision.verification import check_collisions
from smp_planner.library.link_meshes import link_meshes
from smp_planner.library.smp import Robot

URDF = """<robot name="arm"><link name="ground"/>
<joint name="j" type="revolute"><parent link="ground"/><child link="tool"/>
 <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<link name="tool"><collision><origin xyz="0.3 0.05 0.1" rpy="0.2 1.4 -0.3"/>
 <geometry><capsule radius="{radius}" length="{length}"/></geometry></collision></link></robot>"""
CENTER = np.array([0.3, 0.05, 0.1])
TURN = Rotation.from_euler("xyz", [0.2, 1.4, -0.3])
SIZES = [(0.05, 0.4), (0.1, 0.02), (0.03, 1.5), (0.2, 0.3)]


def robot_of(folder, radius, length, overshoot):
    path = folder / "arm.urdf"
    path.write_text(URDF.format(radius=radius, length=length))
    return path, Robot.from_urdf(path, "tool", overshoot=overshoot)


def from_axis(points, length):
    """Return distances of points (N, 3) from the axis of the capsule at zero, m."""
    local = TURN.inv().apply(points - CENTER)
    beyond = np.maximum(np.abs(local[:, 2]) - length / 2, 0.0)
    return np.sqrt((local[:, :2] ** 2).sum(axis=1) + beyond**2)


@pytest.mark.parametrize(("radius", "length"), SIZES)
@pytest.mark.parametrize("overshoot", [0.005, 0.02, 0.5])
def test_spheres_hold_the_capsule_and_stand_out_by_no_more(tmp_path, radius, length, overshoot):
    _, robot = robot_of(tmp_path, radius, length, overshoot)
    center, size = robot.model.center, robot.model.radius
    rng = np.random.default_rng(0)
    axis = rng.uniform(-length / 2, length / 2, 20_000)
    axis[:4000] = np.sign(axis[:4000]) * length / 2
    away = rng.normal(size=(20_000, 3))
    away *= radius / np.linalg.norm(away, axis=1, keepdims=True)
    points = TURN.apply(away + np.column_stack([0 * axis, 0 * axis, axis])) + CENTER
    gap = np.linalg.norm(points[:, None] - center, axis=-1) - size
    assert gap.min(axis=1).max() <= 1e-9
    assert (from_axis(center, length) + size <= radius + overshoot + 1e-9).all()
    # No more than a chain of balls needs.
    assert len(size) <= length / np.sqrt(radius * overshoot) + 2


@pytest.mark.parametrize(("radius", "length"), SIZES)
def test_clearance_is_that_of_pybullet_less_the_overshoot(tmp_path, radius, length):
    overshoot = 0.01
    path, robot = robot_of(tmp_path, radius, length, overshoot)
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.05, physicsClientId=client)
    ball = pybullet.createMultiBody(0.0, shape, physicsClientId=client)
    rng = np.random.default_rng(1)
    for angle in rng.uniform(-3.0, 3.0, 30):
        place = rng.uniform(-1.0, 1.0, 3)
        pybullet.resetBasePositionAndOrientation(ball, place, (0, 0, 0, 1), physicsClientId=client)
        pybullet.resetJointState(body, 0, angle, physicsClientId=client)
        near = pybullet.getClosestPoints(body, ball, 9.0, physicsClientId=client)
        exact = min(point[8] for point in near)
        obstacle = Obstacle(shape="sphere", position=tuple(place), size=(0.05, 0.05, 0.05))
        still = np.full((1, 2, 1), angle)
        found = check_collisions(still, robot.model, [obstacle]).clearance[0]
        assert exact - overshoot - 1e-4 <= found <= exact + 1e-4
    pybullet.disconnect(client)


def test_it_is_shown_as_it_is(tmp_path):
    _, robot = robot_of(tmp_path, 0.05, 0.4, 0.02)
    (mesh,) = link_meshes(robot)
    np.testing.assert_allclose(from_axis(mesh.vertices, 0.4), 0.05, atol=1e-6)
