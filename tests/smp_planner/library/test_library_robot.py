"""Robots from their URDF: the packaged arm against its own numbers, a chain written here."""

import dataclasses
import logging
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from smp_gym.assets import jaco_urdf
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.scene import TABLE, Obstacle
from smp_planner.adaptation import adaptation
from smp_planner.library.covering import cover_mesh
from smp_planner.library.scene import REFERENCE_SPHERES, Scene
from smp_planner.library.smp import SMP, AdaptSettings, Box, Circle, GoalRegion, Robot, ViaPoint
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.target import SceneTarget

TIP = "j2s6s200_end_effector"
AXES = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0.6, 0, 0.8), (0, -1, 0), (1, 1, 1)]
JOINT = """
  <joint name="joint_{i}" type="{kind}">
    <parent link="link_{before}"/><child link="link_{i}"/>
    <origin xyz="{x} 0.02 0.15" rpy="0.{i} -0.2 0.1"/><axis xyz="{axis}"/>
    <limit lower="-2.{i}" upper="2.5" velocity="1.{i}" effort="1"/>
  </joint>
  <link name="link_{i}">
    <collision><origin xyz="0 0 0.07" rpy="0 0.3 0"/>
      <geometry><cylinder radius="0.03" length="0.16"/></geometry></collision>
  </link>"""
TOOL = """
  <joint name="mount" type="fixed">
    <parent link="link_7"/><child link="tool"/><origin xyz="0 0.01 0.1" rpy="0.5 0 0"/>
  </joint>
  <link name="tool">
    <collision><geometry><box size="0.1 0.02 0.06"/></geometry></collision>
  </link>"""


def written(folder, kinds=None, extra=TOOL):
    kinds = kinds or ["revolute"] * 7
    parts = [
        JOINT.format(
            i=i, before=i - 1, kind=kind, x=0.03 * i, axis=" ".join(str(x) for x in AXES[i - 1])
        )
        for i, kind in enumerate(kinds, start=1)
    ]
    path = folder / "arm.urdf"
    body = '<link name="link_0"/>' + "".join(parts) + extra
    path.write_text(f'<robot name="arm">{body}</robot>')
    return path


def tool_pose(angles):
    """Return the tool's pose of the chain above, from its own text, by products of rotations."""
    pose = np.eye(4)
    for i, angle in enumerate(angles, start=1):
        origin = np.eye(4)
        origin[:3, :3] = Rotation.from_euler("xyz", [i / 10, -0.2, 0.1]).as_matrix()
        origin[:3, 3] = [0.03 * i, 0.02, 0.15]
        axis = np.array(AXES[i - 1], float)
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        pose = pose @ origin @ turn
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("x", 0.5).as_matrix()
    mount[:3, 3] = [0.0, 0.01, 0.1]
    return pose @ mount


@pytest.fixture(scope="module")
def jaco():
    return Robot.from_urdf(jaco_urdf(), TIP)


@pytest.fixture(scope="module")
def seven(tmp_path_factory):
    return Robot.from_urdf(written(tmp_path_factory.mktemp("urdf")), "tool")


@pytest.fixture(scope="module")
def placing(jaco):
    return SMP.fit(Demonstrations.load("Placement").configurations, robot=jaco)


def test_the_packaged_arm_is_read_as_it_is(jaco):
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 6))
    expected = kinematics.end_effector_pose(q)[:, :3, 3]
    np.testing.assert_allclose(jaco.tool_positions(q), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(jaco.model.lower, kinematics.JOINT_LOWER, atol=1e-9)
    np.testing.assert_allclose(jaco.model.upper, kinematics.JOINT_UPPER, atol=1e-9)
    np.testing.assert_allclose(jaco.model.velocity, kinematics.JOINT_VELOCITY, atol=1e-9)
    assert jaco.joints == tuple(f"j2s6s200_joint_{i}" for i in range(1, 7))


def test_any_axes_will_do(seven):
    rng = np.random.default_rng(1)
    for angles in rng.uniform(-2.0, 2.0, (20, 7)):
        pose = tool_pose(angles)
        points = rng.normal(size=(3, 3))
        for point in points:
            at, jacobian = seven.model.carried_points(angles, point)
            np.testing.assert_allclose(at, pose[:3, :3] @ point + pose[:3, 3], atol=1e-12)
            change = 1e-6 * np.eye(7)
            there = [tool_pose(angles + d)[:3] @ [*point, 1.0] for d in change]
            back = [tool_pose(angles - d)[:3] @ [*point, 1.0] for d in change]
            expected = (np.array(there) - np.array(back)).T / 2e-6
            np.testing.assert_allclose(jacobian, expected, atol=1e-8)
    np.testing.assert_allclose(seven.model.velocity, [1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7])


def test_spheres_cover_the_collision_shapes(jaco, seven):
    rng = np.random.default_rng(2)
    # The tool of the chain, in its own frame: all of its box is in some sphere of the last link.
    on_last = seven.model.link == 7
    box = rng.uniform(-1.0, 1.0, (2000, 3)) * [0.05, 0.01, 0.03]
    placed = box @ seven.model.end_effector[:3, :3].T + seven.model.end_effector[:3, 3]
    gap = np.linalg.norm(placed[:, None] - seven.model.center[on_last], axis=-1)
    assert (gap.min(axis=1) <= 0.2).all()
    assert ((gap - seven.model.radius[on_last]).min(axis=1) <= 1e-9).all()
    assert set(jaco.model.link) == set(range(7))


def test_meshes_are_covered(tmp_path):
    mesh = trimesh.creation.capsule(height=0.3, radius=0.05)
    _check_covers(cover_mesh(mesh, 0.06), mesh.sample(3000), 0.08)
    mesh.export(tmp_path / "shape.stl")
    shape = (
        '<collision><geometry><mesh filename="package://arm/shape.stl" scale="1 1 2"/></geometry>'
    )
    link = f'<link name="part">{shape}</collision></link>'
    joint = '<joint name="weld" type="fixed"><parent link="tool"/><child link="part"/></joint>'
    (tmp_path / "urdf").mkdir()
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "package.xml").touch()
    (tmp_path / "shape.stl").rename(tmp_path / "arm" / "shape.stl")
    robot = Robot.from_urdf(written(tmp_path / "urdf", extra=TOOL + link + joint), "tool")
    tall = mesh.copy()
    tall.apply_transform(np.diag([1.0, 1.0, 2.0, 1.0]))
    points = tall.sample(1000) @ robot.model.end_effector[:3, :3].T
    on_last = robot.model.link == 7
    spheres = np.column_stack([robot.model.center, robot.model.radius])[on_last]
    _check_covers(spheres, points + robot.model.end_effector[:3, 3])
    (tmp_path / "arm" / "shape.stl").unlink()
    with pytest.raises(FileNotFoundError, match=r"names the mesh 'package://arm/shape.stl'"):
        Robot.from_urdf(tmp_path / "urdf" / "arm.urdf", "tool")


def _check_covers(spheres, points, overshoot=None):
    gap = np.linalg.norm(points[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
    assert (gap.min(axis=1) <= 1e-6).all()
    if overshoot is not None:
        reach = np.abs(spheres[:, :3]).max(axis=0) + spheres[:, 3].max()
        assert (reach <= np.abs(points).max(axis=0) + overshoot).all()


def test_held_joints_stand_where_they_are_told(tmp_path):
    path = written(tmp_path, ["revolute"] * 6 + ["planar"])
    with pytest.raises(ValueError, match=r"joint 'joint_7' .* is planar; .* must be held"):
        Robot.from_urdf(path, "tool")
    path = written(tmp_path, ["revolute"] * 6 + ["prismatic"])
    robots = [Robot.from_urdf(path, "tool", held={"joint_7": at}) for at in (0.0, 0.3)]
    assert robots[0].dimension == 6
    q = np.zeros((1, 6))
    moved = robots[1].tool_positions(q) - robots[0].tool_positions(q)
    assert np.linalg.norm(moved) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("change", "tip", "message"),
    [
        (lambda t: t, "hand", "tip must be one of link_0, .*; got 'hand'"),
        (lambda t: t, "link_0", "must be moved by at least one joint"),
        (lambda t: t.replace("robot", "sdf"), "tool", "root is <sdf>"),
        (lambda t: t[:-20], "tool", "is not a URDF"),
        (
            lambda t: t.replace('velocity="1.3"', ""),
            "tool",
            "'joint_3' must have a range and a vel",
        ),
        (lambda t: t.replace('xyz="1 1 1"', 'xyz="0 0 0"'), "tool", "axis that is not zero"),
        (
            lambda t: t.replace('<link name="link_0"/>', '<link name="a"/>'),
            "tool",
            "names the link 'link_0'",
        ),
        (lambda t: t.replace("</robot>", '<link name="b"/></robot>'), "tool", "one root link"),
        (
            lambda t: t.replace("<box ", "<cone "),
            "tool",
            "box, cylinder, capsule, sphere or mesh, got <cone>",
        ),
    ],
)
def test_bad_descriptions_are_named(tmp_path, change, tip, message):
    path = written(tmp_path)
    path.write_text(change(path.read_text()))
    with pytest.raises(ValueError, match=message):
        Robot.from_urdf(path, tip)


def test_unknown_held_joints_and_files_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"held names joints .* elbow"):
        Robot.from_urdf(written(tmp_path), "tool", held={"elbow": 0.0})
    with pytest.raises(FileNotFoundError):
        Robot.from_urdf(tmp_path / "none.urdf", "tool")


def test_an_arm_goes_round_and_reaches_a_region(placing, jaco):
    tool = jaco.tool_positions(placing.demonstrations[0])
    x, y, z = tool[100]
    pillar = Obstacle(shape="cylinder", position=(x, y, z), size=(0.06, 0.06, 0.1))
    region = GoalRegion(np.zeros(3), tool[-1] - 0.02, tool[-1] + 0.02)
    start = placing.demonstrations[0][0]
    plan = placing.adapt([pillar, TABLE], start=start, goal=region, particles=20)
    assert plan.good.sum() >= 18
    np.testing.assert_allclose(plan.trajectories[:, 0], np.tile(start, (20, 1)), atol=1e-6)
    ends = kinematics.end_effector_pose(plan.trajectories[:, -1])[:, :3, 3]
    assert ((ends > region.lower - 0.005) & (ends < region.upper + 0.005)).all()
    # The judge's own spheres of the arm, at all samples of the good paths.
    spheres = kinematics.arm_spheres()
    centers = kinematics.sphere_centers(plan.trajectories[plan.good], spheres)
    across = np.linalg.norm(centers[..., :2] - [x, y], axis=-1) - 0.06
    along = np.abs(centers[..., 2] - z) - 0.1
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    assert (np.maximum(across, along) > 0.0).all()
    assert (outside > 0.0).all()
    np.testing.assert_allclose(plan.tool_paths, jaco.tool_positions(plan.trajectories))
    assert plan.signatures.shape == (20, 5)
    unadapted = placing.adapt(
        [pillar, TABLE], start=start, goal=region, method="promp", particles=20
    )
    assert unadapted.good.sum() < 10


def test_configurations_are_met_and_limits_kept(placing):
    start, end = placing.demonstrations[0][0], placing.demonstrations[1][-1]
    middle = placing.demonstrations[2][100]
    plan = placing.adapt(
        start=Box(start - 0.05, start + 0.05),
        goal=end,
        via_points=[ViaPoint(0.5, middle, 0.1)],
        particles=5,
        method=adaptation("smp", iterations=30),
    )
    np.testing.assert_allclose(plan.trajectories[:, -1], np.tile(end, (5, 1)), atol=1e-6)
    assert plan.passing.all()
    assert plan.executable.all()
    hurried = placing.adapt(
        start=start,
        goal=end,
        particles=5,
        method="promp",
        settings=AdaptSettings(duration_limit=1.0),
    )
    assert not hurried.executable.any()
    assert (hurried.duration > 1.0).all()


def test_what_demonstrations_touch_is_no_collision(placing):
    plan = placing.adapt(method="promp", particles=40)
    # Without obstacles only the arm itself can be hit.
    assert np.isinf(plan.clearance).all()
    assert plan.collision_free.mean() > 0.9


def test_weights_do_not_change_with_steps_and_spheres(placing, jaco):
    model = jaco.model
    tool = jaco.tool_positions(placing.demonstrations[0])
    ball = (Obstacle(shape="sphere", position=tuple(tool[100]), size=(0.1, 0.1, 0.1)),)
    twice = dataclasses.replace(model, spheres=kinematics.concatenate(model.spheres, model.spheres))
    costs = []
    for robot, step in ((model, 1), (model, 2), (twice, 1)):
        body = RobotBody(robot, reference_spheres=REFERENCE_SPHERES)
        cost = body.obstacle_cost(ball, None, SceneMaps(AdaptSettings(), 0))
        path = placing.demonstrations[0][None, :199:step]
        costs.append(cost(path, 0.02, 0.0)[0][0])
    assert costs[0] > 1.0
    assert costs[1] == pytest.approx(costs[0], rel=0.01)
    assert costs[2] == pytest.approx(costs[0])


def test_a_learned_map_serves_a_robot(placing, jaco):
    tool = jaco.tool_positions(placing.demonstrations[0])
    ball = Obstacle(shape="sphere", position=tuple(tool[100]), size=(0.1, 0.1, 0.1))
    scene = Scene(placing.frame, placing.robot, [ball], 0.0)
    path = placing.demonstrations[0][None]
    costs = []
    for kind in ("points", "exact"):
        settings = AdaptSettings(map=kind, map_points=5000, map_steps=400)
        target = SceneTarget(scene.problem((), settings, 0, ()), settings)
        costs.append(target.costs(path)["obstacles"])
    learned, exact = costs
    assert exact > 1.0
    np.testing.assert_allclose(learned, exact, rtol=0.1)


def test_what_does_not_fit_a_robot_is_named(placing, jaco):
    inside = Obstacle(
        shape="box",
        position=tuple(jaco.tool_positions(placing.demonstrations[0])[0]),
        size=(0.1, 0.1, 0.1),
    )
    with pytest.raises(ValueError, match=r"start .* is inside or touches obstacles\[0\]"):
        placing.adapt([inside], start=placing.demonstrations[0][0])
    with pytest.raises(ValueError, match="radius must be 0 for a robot"):
        placing.adapt(radius=0.1)
    with pytest.raises(ValueError, match=r"must be smp_gym\.scene.Obstacle"):
        placing.adapt([Circle((0.0, 0.0), 1.0)])
    with pytest.raises(ValueError, match="out of reach"):
        placing.adapt(goal=GoalRegion(np.zeros(3), np.full(3, 5.0), np.full(3, 5.1)))
    with pytest.raises(ValueError, match="6 joints must have as many coordinates, got 2"):
        SMP.fit(np.random.default_rng(0).normal(size=(3, 10, 2)), robot=jaco)


def test_obstacles_out_of_reach_cost_nothing(placing):
    far = Obstacle(shape="box", position=(9.0, 0.0, 0.0), size=(0.1, 0.1, 0.1))
    plan = placing.adapt([far], particles=3, method=adaptation("smp", iterations=5))
    assert plan.costs["obstacles"].max() == 0.0
    assert plan.clearance.min() > 7.0


def test_a_robot_is_saved_with_its_primitive(placing, tmp_path: Path):
    placing.save(tmp_path / "arm.npz")
    again = SMP.load(tmp_path / "arm.npz")
    assert again.robot is not None
    assert again.robot.joints == placing.robot.joints
    method = adaptation("smp", iterations=5)
    first, second = (p.adapt(particles=4, method=method) for p in (placing, again))
    np.testing.assert_array_equal(first.trajectories, second.trajectories)


def test_a_robot_that_touches_itself_is_told_of(seven, caplog):
    """Links 1 and 7 stand apart in most postures; one demonstration folds them onto each other."""
    rng = np.random.default_rng(3)
    postures = rng.uniform(seven.model.lower, seven.model.upper, (4000, 7))
    centers = seven.model.sphere_centers(torch.from_numpy(postures)).numpy()
    link, radius = seven.model.link, seven.model.radius
    near, far = np.flatnonzero(link == 1), np.flatnonzero(link == 7)
    between = np.linalg.norm(centers[:, near][:, :, None] - centers[:, far][:, None], axis=-1)
    gap = (between - radius[near][:, None] - radius[far]).min(axis=(1, 2))
    open_, folded = postures[gap.argmax()], postures[gap.argmin()]
    assert gap.min() < -0.005 < 0.05 < gap.max()
    assert (gap < 0.0).mean() < 0.5
    clear = [open_ + s * np.linspace(0.0, 0.02, 60)[:, None] for s in (1.0, -1.0, 0.5)]
    touching = np.linspace(folded, folded + 1e-5, 60)
    of_link = dict(zip(seven.bodies, link.tolist(), strict=True))

    def told():
        """Return depths, mm, and demonstrations of the warnings of the two links' bodies."""
        return [
            record.args[2:4]
            for record in caplog.records
            if [of_link[body] for body in record.args[:2]] == [1, 7]
        ]

    with caplog.at_level(logging.WARNING):
        kept = SMP.fit(clear, robot=seven).robot.model.collision_pairs
    assert not told()
    assert {(1, 7)} <= {tuple(pair) for pair in link[kept]}
    with caplog.at_level(logging.WARNING):
        dropped = SMP.fit([*clear, touching], robot=seven).robot.model.collision_pairs
    depth, demonstration = max(told())
    assert depth == pytest.approx(-1e3 * gap.min(), abs=0.1)
    assert demonstration == 3
    of_both = [(link[pairs] == (1, 7)).all(axis=1).sum() for pairs in (kept, dropped)]
    assert of_both[1] < of_both[0]


def test_the_limit_of_duration_follows_demonstrations_and_is_told_of(seven, caplog):
    slow = dataclasses.replace(seven.model, velocity=np.full(7, 0.02))
    robot = dataclasses.replace(seven, model=slow)
    ends = np.linspace(-0.3, 0.3, 80)[:, None] * np.ones(7)
    primitive = SMP.fit([ends, ends + 0.02, ends - 0.02], robot=robot, smooth_std=0.005)
    ask = {"start": ends[0], "goal": ends[-1], "particles": 4, "method": "promp"}
    with caplog.at_level(logging.WARNING):
        plan = primitive.adapt(**ask)
    # 0.6 rad at 0.02 rad/s are 30 s; twice that is more than paths of the primitive take.
    assert (plan.duration > 29.0).all()
    assert plan.executable.all()
    assert "duration_limit" not in caplog.text
    with caplog.at_level(logging.WARNING):
        hurried = primitive.adapt(**ask, settings=AdaptSettings(duration_limit=15.0))
    assert not hurried.executable.any()
    assert "4 of 4 trajectories take longer than duration_limit=15 s" in caplog.text
