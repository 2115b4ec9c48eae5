"""Robots that stand somewhere in the world, against PyBullet with the same base pose."""

import numpy as np
import pybullet
import pybullet_data
import pytest
from scipy.spatial.transform import Rotation

from smp_gym.scene import Obstacle
from smp_planner.library.planning_scene import PlanningScene
from smp_planner.library.smp import SMP, GoalRegion, Robot

POSITION = (0.7, -0.4, 0.5)
QUATERNION = tuple(Rotation.from_euler("zyx", [1.1, 0.4, -0.3]).as_quat())
ARM = f"{pybullet_data.getDataPath()}/kuka_iiwa/model.urdf"
TIP = "lbr_iiwa_link_7"


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(ARM, TIP, overshoot=0.04, base=(POSITION, QUATERNION))


@pytest.fixture(scope="module")
def plain():
    return Robot.from_urdf(ARM, TIP, overshoot=0.04)


@pytest.fixture(scope="module")
def twin():
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(ARM, POSITION, QUATERNION, useFixedBase=True, physicsClientId=client)

    def place(configuration):
        for index, position in enumerate(configuration):
            pybullet.resetJointState(body, index, position, physicsClientId=client)
        return body

    yield client, place
    pybullet.disconnect(client)


def swing(robot):
    rng = np.random.default_rng(0)
    share = np.linspace(0.0, 1.0, 40)[:, None]
    start, end = np.array([[-0.8, 0.6, 0, -1.3, 0, 1.0, 0], [0.8, 0.7, 0, -1.2, 0, 1.1, 0]])
    bends = 0.05 * rng.normal(size=(5, 1, 7))
    return start + share * (end - start) + np.sin(np.pi * share) * bends


def test_tool_is_where_pybullet_has_it(robot, twin):
    client, place = twin
    rng = np.random.default_rng(1)
    for q in rng.uniform(robot.model.lower, robot.model.upper, (10, 7)):
        body = place(q)
        state = pybullet.getLinkState(
            body, 6, computeForwardKinematics=True, physicsClientId=client
        )
        np.testing.assert_allclose(robot.tool_positions(q), state[4], atol=1e-5)
        assert abs(robot.tool_quaternions(q) @ np.array(state[5])) == pytest.approx(1.0, abs=1e-6)


def test_a_plan_among_obstacles_of_the_world_is_free_for_pybullet(robot, twin):
    client, place = twin
    ways = swing(robot)
    middle = robot.tool_positions(ways[0])[20]
    box = Obstacle(shape="box", position=tuple(middle), size=(0.05, 0.04, 0.06))
    there = robot.tool_positions(ways[0])[-1]
    plan = SMP.fit(list(ways), robot=robot).adapt(
        box,
        start=ways[0][0],
        goal=GoalRegion(np.zeros(3), there - 0.02, there + 0.02),
        particles=16,
        seed=0,
    )
    assert plan.good.any()
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=box.size, physicsClientId=client
    )
    other = pybullet.createMultiBody(0.0, shape, -1, box.position, physicsClientId=client)

    def gap(path):
        return min(
            point[8]
            for q in path
            for point in pybullet.getClosestPoints(place(q), other, 2.0, physicsClientId=client)
        )

    assert gap(ways[0][::2]) < 0.0
    for way in plan.trajectories[plan.good][:3]:
        assert gap(way[::3]) > 0.0
        end = pybullet.getLinkState(place(way[-1]), 6, True, True, physicsClientId=client)[4]
        assert (np.abs(np.array(end) - there) <= 0.0205).all()


def test_a_base_moves_all_that_is_fixed_to_it(robot, plain, tmp_path):
    turn = Rotation.from_quat(QUATERNION)
    q = swing(robot)[0]
    np.testing.assert_allclose(
        robot.tool_positions(q), turn.apply(plain.tool_positions(q)) + POSITION, atol=1e-12
    )
    np.testing.assert_allclose(robot.base_links["lbr_iiwa_link_0"][:3, 3], POSITION)
    primitive = SMP.fit(list(swing(robot)), robot=robot)
    primitive.save(tmp_path / "primitive.npz")
    again = SMP.load(tmp_path / "primitive.npz").robot
    np.testing.assert_array_equal(again.tool_positions(q), robot.tool_positions(q))
    np.testing.assert_array_equal(
        again.base_links["lbr_iiwa_link_0"], robot.base_links["lbr_iiwa_link_0"]
    )


SCENE = """
world:
  collision_objects:
    - id: {name}
      header: {{frame_id: {frame}}}
      primitives: [{{type: box, dimensions: [0.1, 0.2, 0.3]}}]
      primitive_poses: [{{position: [0.1, 0.2, 0.3], orientation: [0, 0, 0, 1]}}]
"""


def test_scenes_are_in_the_world_and_their_frames_at_the_links(robot, tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text(SCENE.format(name="a", frame="world"))
    (body,) = PlanningScene.load(file, robot=robot).obstacles
    np.testing.assert_allclose(body.position, (0.1, 0.2, 0.3))
    file.write_text(SCENE.format(name="b", frame="lbr_iiwa_link_0"))
    (body,) = PlanningScene.load(file, robot=robot).obstacles
    turn = Rotation.from_quat(QUATERNION)
    np.testing.assert_allclose(body.position, turn.apply((0.1, 0.2, 0.3)) + POSITION)
    assert abs(np.dot(body.quaternion, QUATERNION)) == pytest.approx(1.0)


def test_a_root_called_world_is_not_the_world_when_it_stands_elsewhere(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="world"/><joint name="j" type="revolute">'
        '<parent link="world"/><child link="tool"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="tool">'
        '<collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>'
    )
    moved = Robot.from_urdf(path, "tool", base=((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    file = tmp_path / "scene.yaml"
    file.write_text(SCENE.format(name="a", frame="world"))
    (body,) = PlanningScene.load(file, robot=moved).obstacles
    np.testing.assert_allclose(body.position, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(moved.tool_positions(np.zeros(1)), (1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("base", "message"),
    [
        (np.eye(4), "base must be a position and a quaternion"),
        ("ab", "base must be a position and a quaternion"),
        (((0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), r"base: position must have shape \(3,\)"),
        (((0.0, 0.0, np.nan), (0.0, 0.0, 0.0, 1.0)), "base: position must be finite"),
        (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)), "base: quaternion must have norm 1"),
    ],
)
def test_other_bases_are_refused(base, message):
    with pytest.raises(ValueError, match=message):
        Robot.from_urdf(ARM, TIP, base=base)
