"""Pages of plans: what viser serves, asked of its server, and moved by its controls."""

import time
import urllib.request

import gymnasium as gym
import numpy as np
import pytest

from smp_gym.observation import decode
from smp_gym.robot import kinematics
from smp_gym.scene import Obstacle
from smp_planner import SMP, AdaptSettings, Circle, PointCloud, Robot
from smp_planner.adaptation import adaptation
from smp_planner.collision.robot_model import jaco_model
from smp_planner.planning.viewer import Exhibit, Lines, Motion, exhibit_of, show
from smp_planner.policy.planner_policy import PlannerPolicy

PHASE = np.linspace(0.0, 1.0, 40)
BOX = Obstacle(shape="box", position=(0.5, -0.3, 0.1), size=(0.05, 0.1, 0.2))


@pytest.fixture(scope="module")
def plan():
    bows = (-0.1, 0.0, 0.1, 0.2)
    paths = [np.stack([PHASE, b * np.sin(np.pi * PHASE), 0.1 * PHASE], axis=1) for b in bows]
    ball = Obstacle(shape="sphere", position=(0.5, 0.05, 0.05), size=(0.08, 0.08, 0.08))
    return SMP.fit(paths).adapt([ball, BOX], start=(0.0, 0.0, 0.0), goal=(1.0, 0.0, 0.1),
                                particles=6, method="promp")  # fmt: skip


@pytest.fixture
def served():
    pages = []

    def serve(exhibit):
        pages.append(show(exhibit, port=18431))
        return pages[-1]

    yield serve
    for page in pages:
        page.close()


def test_a_page_holds_what_the_plan_does(plan, served):
    exhibit = exhibit_of(plan)
    shown = sum(len(lines.paths) for label, lines in exhibit.lines.items() if ":" in label)
    assert shown == 4 + 6
    np.testing.assert_array_equal(exhibit.lines["chosen particle"].paths[0], plan.best)
    assert list(exhibit.obstacles) == list(plan.display["obstacles"])
    page = served(exhibit)
    assert b"<title>Viser</title>" in urllib.request.urlopen(page.address, timeout=10).read()
    assert page.address.startswith("http://127.0.0.1:")
    assert [name for name in page.nodes if name.startswith("obstacles")] == [
        "obstacles/0",
        "obstacles/1",
    ]
    node = page.nodes["lines/chosen particle"]
    pieces = np.stack([plan.best[:-1], plan.best[1:]], axis=1)
    np.testing.assert_allclose(node.points, pieces, atol=1e-6)
    page.controls["chosen particle"].value = False
    assert until(lambda: not node.visible)


def test_the_slider_moves_the_robot(served):
    spheres = kinematics.arm_spheres()
    turning = np.zeros((11, 6)) + kinematics.JOINT_LOWER.clip(-3.0) + 1.0
    turning[:, 0] = np.linspace(-0.5, 0.5, 11)
    centers = kinematics.sphere_centers(turning, spheres)
    motion, still = Motion(centers, spheres.radius), Motion(centers[:1], spheres.radius)
    lines = {"path": Lines([centers[:, -1]], "#f28c1c")}
    page = served(Exhibit("arm", lines, [BOX], motions={"turning": motion, "still": still}))
    assert list(page.controls) == ["path", "trajectory", "phase"]
    count = len(spheres.radius)
    assert until(lambda: near(page, count, centers[0]))
    page.controls["phase"].value = 0.5
    assert until(lambda: near(page, count, centers[5]))
    page.controls["trajectory"].value = "still"
    assert until(lambda: near(page, count, centers[0]))


def near(page, count, centers):
    shown = [page.nodes[f"robot/{number}"].position for number in range(count)]
    return np.allclose(shown, centers, atol=1e-6)


def until(true, seconds=10.0):
    """Return whether something comes true: controls act in a thread of the server."""
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.01)
    return true()


def test_faces_are_those_of_the_body(served):
    mesh = served(Exhibit("box", {}, [BOX])).nodes["obstacles/0"]
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    low, high = np.array(BOX.position) - BOX.size, np.array(BOX.position) + BOX.size
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], [low, high], atol=1e-6)
    corners = vertices[faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    a, b, c = 2 * np.array(BOX.size)
    assert areas.sum() / 2 == pytest.approx(2 * (a * b + b * c + a * c), rel=1e-5)


def test_the_model_of_a_robot_gives_its_spheres(plan):
    model = jaco_model()
    paths = np.zeros((6, 5, 6)) + kinematics.JOINT_LOWER.clip(-3.0) + 1.0
    arm = plan.changed(
        trajectories=paths,
        tool_paths=np.zeros((6, 5, 3)),
        display={"model": model, "tool_demonstrations": []},
    )
    motion = exhibit_of(arm).motions["chosen particle"]
    expected = kinematics.sphere_centers(paths[0], kinematics.arm_spheres())
    np.testing.assert_allclose(motion.centers, expected, atol=1e-9)
    np.testing.assert_array_equal(motion.radii, kinematics.arm_spheres().radius)


def test_particles_on_their_way_are_on_a_slider(served):
    bows = (-0.1, 0.0, 0.1, 0.2)
    paths = [np.stack([PHASE, b * np.sin(np.pi * PHASE), 0.1 * PHASE], axis=1) for b in bows]
    plan = SMP.fit(paths).adapt([BOX], particles=5, history=2,
                                method=adaptation("smp", iterations=4))  # fmt: skip
    exhibit = exhibit_of(plan)
    assert list(exhibit.on_the_way) == [0, 2]
    for iteration, lines in exhibit.on_the_way.items():
        shown = np.concatenate([each.paths for each in lines.values()])
        expected = plan.history[iteration].trajectories
        np.testing.assert_array_equal(np.sort(shown, axis=0), np.sort(expected, axis=0))
    page = served(exhibit)
    settled = page.nodes["lines/chosen particle"]
    of_stops = [
        [node for name, node in page.nodes.items() if name.startswith(f"iterations/{iteration}/")]
        for iteration in (0, 2)
    ]

    def visible():
        return [settled.visible, *(all(n.visible for n in nodes) for nodes in of_stops)]

    assert visible() == [True, False, False]
    page.controls["iterations"].value = 2
    assert until(lambda: visible() == [False, False, True])
    assert "After 2 iterations: " in page.controls["of iterations"].content
    page.controls["iterations"].value = 0
    assert until(lambda: visible() == [False, True, False])
    # What is hidden by its box stays hidden at the end.
    page.controls["chosen particle"].value = False
    page.controls["iterations"].value = 4
    assert until(lambda: "the last" in page.controls["of iterations"].content)
    assert until(lambda: visible() == [False, False, False])
    assert page.nodes["lines/demonstrations: 4"].visible


def test_what_was_executed_is_shown_beside_the_plan(plan):
    moved = plan.best + 0.01
    lines = exhibit_of(plan, moved).lines
    np.testing.assert_array_equal(lines["executed"].paths[0], moved)
    assert lines["executed"].color != lines["chosen particle"].color
    with pytest.raises(ValueError, match="executed must have shape"):
        plan.watch(executed=moved[:, :2])


URDF = """
<robot name="turning">
  <link name="foot"><visual><geometry><sphere radius="0.1"/></geometry></visual></link>
  <joint name="turn" type="revolute">
    <parent link="foot"/><child link="arm"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="1" effort="1"/>
  </joint>
  <link name="arm">
    <visual>
      <origin xyz="0.3 0 0"/><geometry>{visual}</geometry>
    </visual>
    <collision><origin xyz="0.3 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision>
  </link>
</robot>
"""
SEEN, BEHIND = '<box size="0.6 0.04 0.02"/>', '<mesh filename="gone.obj"/>'


@pytest.mark.parametrize(
    ("visual", "half"), [(SEEN, (0.3, 0.02, 0.01)), (BEHIND, (0.25, 0.05, 0.05))]
)
def test_a_robot_is_seen_by_its_links(tmp_path, served, visual, half):
    """A quarter of a turn about y brings x to -z; without a mesh it is the collision shape."""
    path = tmp_path / "turning.urdf"
    path.write_text(URDF.format(visual=visual))
    robot = Robot.from_urdf(path, "arm")
    paths = [np.linspace(0.0, np.pi / 2, 30)[:, None] + a for a in (-0.01, 0.0, 0.01)]
    plan = SMP.fit(paths, robot).adapt(particles=2, method="promp", start=(0.0,),
                                       goal=(np.pi / 2,))  # fmt: skip
    exhibit = exhibit_of(plan)
    page = served(exhibit)
    foot, arm = page.nodes["links/0"], page.nodes["links/1"]
    np.testing.assert_allclose(np.abs(foot.vertices).max(axis=0), 0.1, atol=1e-3)
    assert not page.nodes["robot/0"].visible
    page.controls["phase"].value = 1.0
    assert until(lambda: np.allclose(placed(arm).mean(axis=0), [0.0, 0.0, 0.2], atol=1e-3))
    low, high = placed(arm).min(axis=0), placed(arm).max(axis=0)
    x, y, z = half
    np.testing.assert_allclose(low, [-z, -y, 0.2 - x], atol=3e-3)
    np.testing.assert_allclose(high, [z, y, 0.2 + x], atol=3e-3)
    page.controls["links"].value, page.controls["spheres"].value = False, True
    assert until(lambda: not arm.visible and page.nodes["robot/0"].visible)


def placed(node):
    """Return the vertices of a mesh where it is shown, by the quaternion (w, x, y, z)."""
    turn, axis = node.wxyz[0], np.asarray(node.wxyz[1:])
    points = np.asarray(node.vertices, float)
    beside = np.cross(axis, points)
    return points + 2 * (turn * beside + np.cross(axis, beside)) + node.position


def test_a_plan_of_an_environment_is_shown(served):
    env = gym.make("smp_gym/Placement-v0", difficulty="medium")
    try:
        policy = PlannerPolicy.make("promp", "Placement")
        observation, _ = env.reset(seed=4)
        plan = policy.plan(observation)
        scene = env.get_wrapper_attr("scene")
    finally:
        env.close()
    executed = plan.trajectories[1]
    exhibit = exhibit_of(plan, executed)
    assert len(exhibit.obstacles) == len(scene.obstacles)
    shown = sum(len(lines.paths) for label, lines in exhibit.lines.items() if ":" in label)
    assert shown == len(policy.demonstrations.configurations) + len(plan.trajectories)
    tool = kinematics.end_effector_pose(executed)[:, :3, 3]
    np.testing.assert_allclose(exhibit.lines["executed"].paths[0], tool, atol=1e-9)
    assert list(exhibit.motions) == ["chosen particle", "executed"]
    page = served(exhibit)
    page.controls["trajectory"].value = "executed"
    page.controls["phase"].value = 1.0
    poses = kinematics.link_transforms(executed[-1])
    for number in range(1, 7):
        node = page.nodes[f"links/{number}"]
        assert until(lambda n=number, node=node: np.allclose(node.position, poses[n, :3, 3]))
    # The base stands where the arm's own description has it: symmetric, on the table.
    base = placed(page.nodes["links/0"])
    assert base[:, 2].min() == pytest.approx(0.0, abs=0.01)


def test_a_cloud_of_ones_own_is_shown_by_its_points(served):
    across, up = np.meshgrid(np.linspace(-0.2, 0.2, 15), np.linspace(-0.1, 0.3, 15))
    wall = np.stack([np.full(across.size, 0.5), across.ravel() + 0.5, up.ravel()], axis=1)
    bows = (-0.1, 0.0, 0.1, 0.2)
    paths = [np.stack([PHASE, b * np.sin(np.pi * PHASE), 0.1 * PHASE], axis=1) for b in bows]
    settings = AdaptSettings(map_points=2000, map_steps=20)
    cloud = PointCloud(wall, sensor=(-1.0, 0.5, 0.1), inflation=0.05)
    plan = SMP.fit(paths).adapt([BOX, cloud], particles=2, method="promp", settings=settings)
    page = served(exhibit_of(plan))
    node = page.nodes["clouds/0"]
    np.testing.assert_allclose(node.points, wall, atol=1e-6)
    # Points next to each other are told apart, and leave less than they cover.
    assert 0.004 < node.point_size < 0.4 / 14
    assert [name for name in page.nodes if name.startswith("obstacles")] == ["obstacles/0"]
    page.controls["points: 225"].value = False
    assert until(lambda: not node.visible)


def test_several_clouds_have_boxes_of_their_own(served):
    rng = np.random.default_rng(0)
    many, one, none = rng.normal(size=(50, 3)), np.ones((1, 3)), np.empty((0, 3))
    page = served(Exhibit("clouds", {}, clouds=[many, none, one]))
    assert [name for name in page.nodes if name.startswith("clouds")] == ["clouds/0", "clouds/1"]
    assert len(page.nodes["clouds/1"].points) == 1
    assert page.nodes["clouds/1"].point_size > 0.0
    assert list(page.controls) == ["points: 50", "points: 1 (2)"]
    page.controls["points: 1 (2)"].value = False
    assert until(lambda: not page.nodes["clouds/1"].visible)
    assert page.nodes["clouds/0"].visible


def test_a_plan_on_what_a_camera_sees_shows_its_points(served):
    env = gym.make("smp_gym/Placement-v0", difficulty="easy", sensing="depth")
    try:
        policy = PlannerPolicy.make("promp", "Placement", settings={"particles": 4})
        observation, _ = env.reset(seed=3)
        plan = policy.plan(observation)
    finally:
        env.close()
    page = served(exhibit_of(plan))
    seen = decode(observation, "Placement").points
    assert len(seen) > 50
    np.testing.assert_allclose(page.nodes["clouds/0"].points, seen, atol=1e-6)
    assert not [name for name in page.nodes if name.startswith("obstacles")]


def test_paths_in_the_plane_are_refused():
    flat = [np.stack([PHASE, bow * np.sin(np.pi * PHASE)], axis=1) for bow in (0.1, 0.2)]
    plan = SMP.fit(flat).adapt([Circle((0.5, 0.1), 0.05)], particles=2, method="promp")
    with pytest.raises(ValueError, match=r"in space and of robots .*D = 2; plot draws"):
        plan.watch()
