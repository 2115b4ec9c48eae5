"""Plans without a good particle say what binds: obstacles, links, joints, durations, requests."""

import re

import numpy as np
import pybullet
import pybullet_data
import pytest
from pybullet_utils.bullet_client import BulletClient

from smp_gym.scene import Obstacle
from smp_planner.experiments.public_arms import swings
from smp_planner.library.binding import what_binds
from smp_planner.library.requests import constraints_of
from smp_planner.library.scene import Scene
from smp_planner.library.smp import (
    SMP,
    AdaptSettings,
    Circle,
    GoalRegion,
    Orientation,
    PointCloud,
    Rectangle,
    Robot,
    ToolViaPoint,
    ViaPoint,
)
from smp_planner.planners.rrt_connect.planner import RRTConnectSettings

PHASE = np.linspace(0.0, 1.0, 60)
LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="1"/>'
LENGTH = 0.4


def planar_arm():
    """Return a URDF of three links of 0.4 m that turn in the plane."""
    parts, parent = ["<link name='base'/>"], "base"
    for number in (1, 2, 3):
        name = f"link_{number}"
        parts.append(
            f"<joint name='joint_{number}' type='revolute'><parent link='{parent}'/>"
            f"<child link='{name}'/><origin xyz='{LENGTH * (number > 1)} 0 0'/>"
            f"<axis xyz='0 0 1'/>{LIMIT}</joint><link name='{name}'><collision>"
            f"<origin xyz='{LENGTH / 2} 0 0'/><geometry><box size='{LENGTH} 0.06 0.06'/></geometry>"
            "</collision></link>"
        )
        parent = name
    return f"<robot name='arm'>{''.join(parts)}</robot>"


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(planar_arm())
    ways = [
        np.stack([2.0 * PHASE - 1.0, 0.3 * np.sin(np.pi * PHASE) + b * PHASE, 0.2 * PHASE], 1)
        for b in (0.0, 0.1, 0.2)
    ]
    return SMP.fit(ways, robot=Robot.from_urdf(path, "link_3"))


@pytest.fixture(scope="module")
def strokes():
    """Return a primitive of strokes in mm."""
    return SMP.fit(
        [100.0 * np.stack([PHASE, b * np.sin(np.pi * PHASE)], 1) for b in (0.2, 0.25, 0.3)]
    )


def ends(arm):
    return {"start": arm.demonstrations[0][0], "goal": arm.demonstrations[0][-1]}


def number(pattern, message):
    return float(re.search(pattern, message)[1])


@pytest.mark.parametrize("place", [0, 1, 4])
def test_the_obstacle_is_named_in_the_users_unit(strokes, place):
    obstacles = [Circle((50.0, 400.0 + 10.0 * k), 1.0) for k in range(4)]
    # Whoever passes the wall is 2 mm inside it at its middle.
    obstacles.insert(place, Rectangle((50.0, 0.0), (2.0, 2000.0)))
    plan = strokes.adapt(obstacles, start=(0, 0), goal=(100, 0), particles=3, method="promp")
    assert re.search(
        rf"the least bad one is chosen: it meets obstacles\[{place}\] \(", plan.message
    )
    assert number(r"clearance (\S+)\)", plan.message) == pytest.approx(-2.0, abs=0.02)


def test_many_obstacles_are_counted(strokes):
    wall = [Circle((50.0, y), 4.0) for y in np.arange(-300.0, 300.0, 2.0)]
    plan = strokes.adapt(wall, start=(0, 0), goal=(100, 0), particles=2, method="promp")
    gap = np.array([np.linalg.norm(plan.best - w.center, axis=1).min() - 4.0 for w in wall])
    deepest = int(gap.argmin())
    met = int((gap < 0.0).sum())
    assert f"it meets obstacles[{deepest}] (clearance" in plan.message
    assert abs(number(r"and (\d+) more", plan.message) + 3 - met) <= 1


def test_the_requests_that_are_missed_are_named(strokes):
    two = [ViaPoint(0.5, (50, 25), 1.0), ViaPoint(0.501, (50, 55), 1.0)]
    plan = strokes.adapt(via_points=two, particles=4)
    assert not plan.good.any()
    for name in ("via_points[0]", "via_points[1]"):
        by = number(rf"misses {re.escape(name)} by (\S+?)(,|$)", plan.message)
        assert by == pytest.approx(plan.missed[name][plan.chosen], rel=0.01)


def test_the_tool_is_measured_in_metres_and_its_turn_in_radians(arm):
    pose = arm.robot.tool_positions(arm.demonstrations[0])[-1]
    turned = Orientation((1.0, 0.0, 0.0, 0.0), 0.1)
    goal = GoalRegion(np.zeros(3), pose + 0.1, pose + 0.2, orientation=turned)
    via = ToolViaPoint(0.5, np.zeros(3), pose + 0.3 * np.eye(3)[2], 0.01)
    constraints = constraints_of(arm.frame, None, [via], goal, 0.01, arm._angles)
    settings = AdaptSettings()
    scene = Scene(arm.frame, arm.robot, (), 0.0)
    problem = scene.problem(constraints, settings, 0, arm.demonstrations)
    text = what_binds(problem, arm.demonstrations[0], settings, arm.frame, arm.robot, scene.order)
    # The corner of the region is 0.1 m away along each axis; the arm lies in the plane.
    assert number(r"misses goal by (\S+) m,", text) == pytest.approx(0.1 * 3**0.5, rel=0.02)
    assert number(r"orientation of goal by (\S+) rad", text) == pytest.approx(np.pi - 0.1, abs=0.01)
    assert number(r"misses via_points\[0\] by (\S+) m", text) > 0.28


def test_links_that_touch_are_named(arm):
    plan = arm.adapt(start=arm.demonstrations[0][0], goal=(1.0, 2.95, 2.9), particles=3)
    assert not plan.good.any()
    assert "it has links too near to each other: link_1 by link_3 (-" in plan.message
    assert "a smaller overshoot= leaves more room, touching= or srdf= says what" in plan.message


def test_what_spheres_alone_keep_apart_is_solved_by_the_advice():
    """Between Panda's links 5 and 7 are 18 mm, as PyBullet has it, less than spheres stand out."""
    folder = f"{pybullet_data.getDataPath()}/franka_panda"
    packages = {"meshes": f"{folder}/meshes"}
    ready, turned = np.array([[0.0, 0.2, 0.0, -1.9, 0.0, 2.1, 0.8]] * 2)
    # Joint 7 alone turns, past where the spheres of links 5 and 7 meet.
    turned[6] = -2.0
    client = BulletClient(pybullet.DIRECT)
    body = client.loadURDF(f"{folder}/panda.urdf", useFixedBase=True)
    infos = [client.getJointInfo(body, k) for k in range(client.getNumJoints(body))]
    links = {info[12].decode(): info[0] for info in infos}
    for angle in np.linspace(0.8, -2.0, 50):
        for joint, position in zip(range(7), [*ready[:6], angle], strict=True):
            client.resetJointState(body, joint, position)
        pair = links["panda_link5"], links["panda_link7"]
        near = client.getClosestPoints(body, body, 1.0, *pair)
        assert min(point[8] for point in near) > 0.015
    client.disconnect()
    ways = swings(ready, ready + 0.2 * np.eye(7)[6], np.random.default_rng(0))
    plans = []
    for more in ({}, {"touching": [("panda_link5", "panda_link7")]}):
        robot = Robot.from_urdf(f"{folder}/panda.urdf", tip="panda_hand", packages=packages, **more)
        arm = SMP.fit(ways, robot=robot)
        plans.append(arm.adapt(start=ways[0][0], goal=turned, particles=4))
    spheres, told = plans
    assert not spheres.good.any()
    assert "panda_link5 by panda_link7 (" in spheres.message
    assert told.good.any()


def test_the_joint_that_takes_too_long_is_named(arm):
    plan = arm.adapt(**ends(arm), particles=3, settings=AdaptSettings(duration_limit=0.5))
    assert "beyond duration_limit=0.5 s, for joint 'joint_1' at 2 rad/s" in plan.message
    took = number(r"it takes (\S+) s", plan.message)
    assert took == pytest.approx(plan.duration[plan.chosen], rel=0.01)


def test_the_joint_beyond_its_limits_is_named(arm):
    scene = Scene(arm.frame, arm.robot, (), 0.0)
    problem = scene.problem((), AdaptSettings(), 0, arm.demonstrations)
    path = arm.demonstrations[0] + [0.0, 0.0, 3.0]
    text = what_binds(problem, path, AdaptSettings(), arm.frame, arm.robot, scene.order)
    assert "has joint 'joint_3' beyond its limits [-3, 3] by 0.2 rad" in text


@pytest.mark.parametrize("method", ["promp", RRTConnectSettings(iterations=200, particles=2)])
def test_what_an_arm_meets_is_named_by_every_method(arm, method):
    far_and_wall = [
        Obstacle(shape="sphere", position=(0.0, 5.0, 0.0), size=(0.1, 0.1, 0.1)),
        Obstacle(shape="box", position=(0.9, 0.0, 0.0), size=(0.6, 0.02, 0.9)),
    ]
    plan = arm.adapt(far_and_wall, **ends(arm), particles=2, method=method)
    assert not plan.good.any()
    assert "it meets obstacles[1] (clearance -" in plan.message


def test_a_cloud_is_named_by_its_place():
    lines = [
        np.stack([PHASE, b * np.sin(np.pi * PHASE), 0.1 * PHASE], 1) for b in (0.1, 0.12, 0.14)
    ]
    y, z = np.meshgrid(np.linspace(-1.5, 1.5, 120), np.linspace(-1.5, 1.5, 120))
    wall = np.stack([np.full(y.size, 0.5), y.ravel(), z.ravel()], 1)
    cloud = PointCloud(wall, sensor=(-1.0, 0.0, 0.0), thickness=0.1, inflation=0.05)
    far = Obstacle(shape="sphere", position=(0.0, 5.0, 0.0), size=(0.1, 0.1, 0.1))
    plan = SMP.fit(lines).adapt(
        [cloud, far],
        start=lines[0][0],
        goal=lines[0][-1],
        particles=2,
        method="promp",
        settings=AdaptSettings(map_steps=300),
    )
    assert not plan.good.any()
    assert "it meets obstacles[0] (clearance -" in plan.message


def test_a_good_plan_says_nothing(arm, strokes):
    assert arm.adapt(**ends(arm), particles=3).message == ""
    assert strokes.adapt(particles=3).message == ""
