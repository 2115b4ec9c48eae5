"""Goals of a pose from MoveIt's files: what we call reached, MoveIt does, too."""

import json
import math

import numpy as np
import pybullet
import pybullet_data
import pytest
from scipy.spatial.transform import Rotation

from smp_gym.geometry.pose import Pose
from smp_planner import SMP, AnyOf, Cone, Orientation, PlanningScene, Robot

pytest.importorskip("yaml", reason="PyYAML is not installed")

URDF = """<robot name="arm">
<link name="floor"/>
<joint name="stand" type="fixed"><parent link="floor"/><child link="base"/>
 <origin xyz="0.1 -0.2 0.7" rpy="0.3 -0.2 1.1"/></joint>
<link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="upper"/>
 <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="1"/></joint>
<link name="upper"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="wrist" type="fixed"><parent link="upper"/><child link="flange"/>
 <origin xyz="0 0.1 0.4" rpy="0.5 0 -1"/></joint>
<link name="flange"/>
<joint name="mount" type="fixed"><parent link="flange"/><child link="cup"/>
 <origin xyz="0.1 0 0.05" rpy="-1 0.7 0.2"/></joint>
<link name="cup"/>
</robot>"""
STAND = Pose(Rotation.from_euler("xyz", (0.3, -0.2, 1.1)), np.array([0.1, -0.2, 0.7]))
MOUNT = Pose(Rotation.from_euler("xyz", (-1.0, 0.7, 0.2)), np.array([0.1, 0.0, 0.05]))
"""Of the base in the root link, and of the cup in the flange, which is the tip."""

SCENE = {"world": {"collision_objects": []}}
OFFSET = [0.02, -0.01, 0.1]
TURNED = Rotation.from_euler("xyz", (0.9, 0.4, -2.0)).as_quat().tolist()
REGION = {"position": [0.3, 0.4, 0.2], "orientation": TURNED}


def position(kind="box", dimensions=(0.1, 0.2, 0.05), pose=REGION, **changes):
    region = {
        "primitives": [{"type": kind, "dimensions": list(dimensions)}],
        "primitive_poses": [pose],
    }
    fields = {"header": {"frame_id": "base"}, "link_name": "cup", "target_point_offset": OFFSET}
    return {**fields, "constraint_region": region, **changes}


def orientation(tolerances, **changes):
    fields = {"header": {"frame_id": "base"}, "link_name": "cup", "orientation": TURNED}
    for axis, tolerance in zip("xyz", tolerances, strict=True):
        fields[f"absolute_{axis}_axis_tolerance"] = tolerance
    return {**fields, **changes}


def goal(of_place, of_turn=None):
    entry = {"position_constraints": [of_place]}
    return entry if of_turn is None else {**entry, "orientation_constraints": [of_turn]}


@pytest.fixture
def load(tmp_path):
    """Return a function that loads goals for the arm above."""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)

    def loaded(*goals, robot=True, **fields):
        scene, request = tmp_path / "scene.yaml", tmp_path / "request.yaml"
        scene.write_text(json.dumps({**SCENE, **fields}))
        request.write_text(json.dumps({"goal_constraints": list(goals)}))
        arm = Robot.from_urdf(path, "flange") if robot else None
        return PlanningScene.load(scene, request=request, robot=arm)

    return loaded


@pytest.mark.parametrize(
    ("kind", "dimensions"),
    [("box", (0.1, 0.2, 0.05)), ("box", (0.3, 0.001, 0.3)), ("sphere", (0.07,))],
)
@pytest.mark.parametrize("turn", [TURNED, [0.0, 0.0, 0.0, 1.0], [0.0, 0.5**0.5, 0.0, 0.5**0.5]])
def test_places_in_our_region_are_in_moveits(load, kind, dimensions, turn):
    pose = {"position": REGION["position"], "orientation": turn}
    (region,) = load(goal(position(kind, dimensions, pose))).tool_goals
    np.testing.assert_allclose(region.point, MOUNT.of(np.array(OFFSET)), atol=1e-12)
    corners = np.random.default_rng(0).choice([0.0, 1.0], (50, 3))
    places = region.lower + corners * (region.upper - region.lower)
    base = STAND.rotation.inv().apply(places - STAND.position)
    local = Rotation.from_quat(turn).inv().apply(base - REGION["position"])
    if kind == "box":
        share = np.abs(local) / (np.array(dimensions) / 2.0)
        assert share.max() == pytest.approx(1.0)
    else:
        np.testing.assert_allclose(np.linalg.norm(local, axis=1), dimensions[0])


def test_a_box_along_the_axes_stays_what_it_is(load):
    turn = (STAND.rotation.inv() * Rotation.from_euler("z", np.pi / 2)).as_quat().tolist()
    pose = {"position": [0.0, 0.0, 0.0], "orientation": turn}
    (region,) = load(goal(position(pose=pose))).tool_goals
    np.testing.assert_allclose(region.upper - region.lower, (0.2, 0.1, 0.05), atol=1e-9)
    assert region.orientation is None


WHOLE = 2.0 * math.pi


@pytest.mark.parametrize(
    ("tolerances", "meaning", "kind"),
    [
        ((0.1, 0.2, 0.3), 0, Orientation),
        ((0.1, 0.2, 0.3), 1, Orientation),
        ((2.0, 1.0, 1.9), 0, Orientation),
        ((2.0, 3.0, 2.5), 0, Orientation),
        ((0.4, WHOLE, 0.3), 0, Orientation),
        ((0.4, 0.6, 3.15), 0, Cone),
        ((WHOLE, 0.5, 0.3), 0, Cone),
        ((WHOLE, 0.5, WHOLE), 0, Cone),
        ((1.8, 2.0, 3.1415), 0, Cone),
        ((0.4, 0.6, WHOLE), 1, Orientation),
        ((WHOLE, WHOLE, WHOLE), 0, None),
        ((WHOLE, WHOLE, WHOLE), 1, None),
    ],
)
def test_orientations_that_we_allow_moveit_does(load, tolerances, meaning, kind):
    """By the difference to the link's orientation as MoveIt measures it."""
    asked = orientation(tolerances, parameterization=meaning)
    (region,) = load(goal(position(), asked)).tool_goals
    if kind is None:
        assert region.orientation is None
        return
    assert isinstance(region.orientation, kind)
    allowed = region.orientation.allowed
    assert allowed <= min(t for t in tolerances if t > 0.0)
    rng = np.random.default_rng(1)
    if kind is Cone:
        axis, direction = region.orientation.axis, region.orientation.direction
        there = Rotation.align_vectors(direction[None], axis[None])[0]
        spun = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, (4000, 1)) * direction)
        across = np.cross(direction, rng.normal(size=(4000, 3)))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        tools = Rotation.from_rotvec(0.999 * allowed * across) * spun * there
    else:
        across = rng.normal(size=(4000, 3))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        wanted = Rotation.from_quat(region.orientation.quaternion)
        tools = Rotation.from_rotvec(0.999 * allowed * across) * wanted
    found = region.orientation.turned(tools.as_matrix())[0]
    np.testing.assert_allclose(found, 0.999 * allowed, atol=1e-9)
    links = tools * MOUNT.rotation
    difference = (STAND.rotation * Rotation.from_quat(TURNED)).inv() * links
    angles = difference.as_rotvec() if meaning else difference.as_euler("XYZ")
    worst = np.abs(angles).max(axis=0)
    assert (worst <= np.array(tolerances) + 1e-9).all()
    # It is not narrower than it has to be, up to what MoveIt's angles differ from ours.
    assert (worst / tolerances).max() > 0.7 or allowed == np.pi / 2


def test_regions_of_one_goal_and_several_goals_are_choices(load):
    both = position()
    region = both["constraint_region"]
    region["primitives"] += [{"type": "sphere", "dimensions": [0.1]}]
    region["primitive_poses"] += [REGION]
    joints = {"joint_constraints": [{"joint_name": "turn", "position": 0.5}]}
    scene = load(goal(both), joints, goal(position(), orientation((0.1,) * 3)))
    assert len(scene.tool_goals) == 3
    assert [g.orientation is None for g in scene.tool_goals] == [True, True, False]
    assert scene.goals == ({"turn": 0.5},)
    assert repr(scene) == "PlanningScene(0 obstacles, no start, 1 goals, 3 goals of the tool)"


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        (goal(position(link_name="upper_arm")), r"tip does \(.*flange.*\), got 'upper_arm'"),
        (goal(position(), orientation((0.1,) * 3, link_name="base")), "got 'base'"),
        (goal(position(link_name="")), "link_name must name a link, got ''"),
        (goal(position("cylinder", (0.1, 0.2))), "must be a box or a sphere, got 'cylinder'"),
        (goal(position(constraint_region={"meshes": [{}]})), "constraint_region has meshes"),
        (goal(position(constraint_region={})), "primitives must hold a box or a sphere"),
        (goal(position("box", (0.1, -0.2, 0.1))), "dimensions must be positive"),
        (goal(position(header={"frame_id": "moon"})), "frames must say where moon are"),
        (goal(position(), orientation((0.1,) * 3, header={"frame_id": "sun"})), "where sun are"),
        (goal(position(), orientation((0.1, -0.1, 0.1))), "tolerances of at least 0"),
        (goal(position(), orientation((0.1, None, 0.1))), "absolute_y_axis_tolerance must hold"),
        (goal(position(), orientation((0.1,) * 3, parameterization=2)), "must be 0 or 1, got 2"),
        (goal(position(), orientation((0.1,) * 3, orientation=None)), "orientation must be given"),
        (
            goal(position(), orientation((0.1,) * 3, orientation=[0, 0, 0, 2])),
            "orientation must have norm 1",
        ),
        (
            {"position_constraints": [position(), position()]},
            "position_constraints must hold one constraint, got 2",
        ),
        (
            {"orientation_constraints": [orientation((0.1,) * 3)]},
            "has orientation_constraints, but no position_constraints",
        ),
        (
            {"joint_constraints": [{"joint_name": "turn", "position": 0}], **goal(position())},
            "has position_constraints, but only joint_constraints alone",
        ),
        ({**goal(position()), "visibility_constraints": [{}]}, "has visibility_constraints"),
    ],
)
def test_what_cannot_be_read_is_refused(load, entry, named):
    with pytest.raises(ValueError, match=named):
        load(entry)


def test_a_goal_of_a_pose_needs_the_robot(load):
    with pytest.raises(ValueError, match=r"goal_constraints\[0\] .* robot= must be given"):
        load(goal(position()), robot=False)


def test_links_of_the_tip_are_saved(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    robot = Robot.from_urdf(path, "flange")
    assert set(robot.tip_links) == {"upper", "flange", "cup"}
    np.testing.assert_allclose(robot.tip_links["flange"], np.eye(4), atol=1e-12)
    paths = [np.linspace([0.0], [1.0 + bend], 30) for bend in (0.0, 0.1, 0.2)]
    SMP.fit(paths, robot=robot).save(tmp_path / "arm.npz")
    again = SMP.load(tmp_path / "arm.npz").robot
    for name, pose in robot.tip_links.items():
        np.testing.assert_array_equal(again.tip_links[name], pose)


def test_a_public_robot_ends_where_moveit_wants_it(tmp_path):
    """By PyBullet's forward kinematics."""
    file = f"{pybullet_data.getDataPath()}/kuka_iiwa/model.urdf"
    robot = Robot.from_urdf(file, tip="lbr_iiwa_link_7")
    right, left = [-0.9, 0.5, 0.0, -1.4, 0.0, 1.2, 0.0], [0.9, 0.6, 0.0, -1.3, 0.0, 1.2, 0.0]
    phase, bends = np.linspace(0.0, 1.0, 100), np.random.default_rng(0).normal(0.0, 0.1, (5, 7))
    swings = [
        right + np.outer(phase, np.subtract(left, right)) + np.outer(np.sin(np.pi * phase), bend)
        for bend in bends
    ]
    arm = SMP.fit(swings, robot=robot)
    place = robot.tool_positions(swings[0][-1]) + np.array([0.05, -0.1, 0.1])
    turn = Rotation.from_euler("z", 0.5) * Rotation.from_quat(robot.tool_quaternions(swings[0][-1]))
    world, link = {"frame_id": "world"}, {"link_name": "lbr_iiwa_link_7"}
    region = {"position": place.tolist(), "orientation": [0.0, 0.0, 0.0, 1.0]}
    request = goal(
        position("sphere", (0.02,), region, header=world, target_point_offset=[0, 0, 0], **link),
        orientation((0.05, 0.05, 0.1), orientation=turn.as_quat().tolist(), header=world, **link),
    )
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps({**SCENE, "goal_constraints": [request]}))
    scene = PlanningScene.load(path, robot=robot)
    plan = arm.adapt(
        scene.obstacles, start=swings[0][0], goal=AnyOf(scene.tool_goals), particles=12
    )
    assert plan.good.all()
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(file, useFixedBase=True, physicsClientId=client)
    for end in plan.trajectories[:, -1]:
        for joint, angle in enumerate(end):
            pybullet.resetJointState(body, joint, angle, physicsClientId=client)
        state = pybullet.getLinkState(body, 6, computeForwardKinematics=1, physicsClientId=client)
        assert np.linalg.norm(state[4] - place) < 0.02 + 0.005
        angles = (turn.inv() * Rotation.from_quat(state[5])).as_euler("XYZ")
        assert (np.abs(angles) < np.array([0.05, 0.05, 0.1]) + 0.005).all()
    pybullet.disconnect(client)
