"""Planning scenes of MoveIt as obstacles of any robot, against PyBullet and trimesh."""

import json
from pathlib import Path

import numpy as np
import pybullet
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from smp_gym.geometry.distance import signed_distance
from smp_planner import SMP, PlanningScene, Robot

pytest.importorskip("yaml", reason="PyYAML is not installed")

OVERSHOOT, CELL = 0.004, 0.03
WEDGE = trimesh.Trimesh(
    [(0, 0, 0), (0.3, 0, 0), (0.3, 0.2, 0), (0, 0.2, 0), (0, 0, 0.15), (0, 0.2, 0.15)],
    [(0, 2, 1), (0, 3, 2), (0, 1, 4), (2, 3, 5), (0, 4, 5), (0, 5, 3), (1, 2, 5), (1, 5, 4)],
)
SHAPES = {
    "box": [0.3, 0.1, 0.2],
    "sphere": [0.12],
    "cylinder": [0.4, 0.08],
    "cone": [0.3, 0.1],
    "mesh": None,
}
"""Dimensions, m, as of shape_msgs/SolidPrimitive."""


def poses(seed, count):
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=seed).as_quat()
    return list(zip(rng.normal(0.0, 0.6, (count, 3)).tolist(), turns.tolist(), strict=True))


def message(objects, **fields):
    """Return a scene: objects are (id, frame, own pose, [(shape, pose)])."""
    items = []
    for name, frame, own, shapes in objects:
        item = {"id": name, "pose": posed(own), "header": {"frame_id": frame}}
        for shape, pose in shapes:
            if shape == "mesh":
                entry = {
                    "vertices": WEDGE.vertices.tolist(),
                    "triangles": [{"vertex_indices": t} for t in WEDGE.faces.tolist()],
                }
                item.setdefault("meshes", []).append(entry)
                item.setdefault("mesh_poses", []).append(posed(pose))
            else:
                entry = {"type": shape, "dimensions": SHAPES[shape]}
                item.setdefault("primitives", []).append(entry)
                item.setdefault("primitive_poses", []).append(posed(pose))
        items.append(item)
    return {"world": {"collision_objects": items}, **fields}


def posed(pose):
    return {"position": list(pose[0]), "orientation": list(pose[1])}


def text(objects):
    """Return the same as text of MoveIt; frames are not told there."""
    lines = ["(noname)+"]

    def put(*rows):
        lines.extend(" ".join(f"{number:.9g}" for number in row) for row in rows)

    for name, _, own, shapes in objects:
        lines.append(f"* {name}")
        put(*own)
        lines.append(str(len(shapes)))
        for shape, pose in shapes:
            lines.append(shape)
            if shape == "mesh":
                put((len(WEDGE.vertices), len(WEDGE.faces)), *WEDGE.vertices, *WEDGE.faces)
            else:
                reverse = shape in ("cylinder", "cone")
                put(SHAPES[shape][::-1] if reverse else SHAPES[shape])
            put(*pose, (0, 0, 0, 0))
        lines.append("0")
    return "\n".join([*lines, ".", ""])


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a message, or a text, and returns its path.

    JSON is YAML, too.
    """

    def to_file(content, name="scene.yaml"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return to_file


@pytest.fixture
def bullet():
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


def true_distance(client, shape, pose, points):
    """Return distances (N,) m of points outside to a body, by PyBullet or trimesh."""
    position, quaternion = pose
    if shape in ("cone", "mesh"):
        mesh = WEDGE
        if shape == "cone":
            height, radius = SHAPES["cone"]
            mesh = trimesh.creation.cone(radius, height, sections=256)
            mesh.apply_translation((0.0, 0.0, -height / 2))
        local = Rotation.from_quat(quaternion).inv().apply(points - position)
        return trimesh.proximity.closest_point_naive(mesh, local)[1]
    numbers = SHAPES[shape]
    arguments = {
        "box": lambda: {"halfExtents": [number / 2 for number in numbers]},
        "sphere": lambda: {"radius": numbers[0]},
        "cylinder": lambda: {"height": numbers[0], "radius": numbers[1]},
    }[shape]()
    body, ball = (
        pybullet.createMultiBody(
            0,
            pybullet.createCollisionShape(
                getattr(pybullet, f"GEOM_{kind.upper()}"), **given, physicsClientId=client
            ),
            basePosition=position,
            baseOrientation=quaternion,
            physicsClientId=client,
        )
        for kind, given in ((shape, arguments), ("sphere", {"radius": 1e-3}))
    )
    found = []
    for point in points:
        pybullet.resetBasePositionAndOrientation(ball, point, (0, 0, 0, 1), physicsClientId=client)
        near = pybullet.getClosestPoints(ball, body, 10.0, physicsClientId=client)
        found.append(min(contact[8] for contact in near) + 1e-3)
    return np.array(found)


def chained(*given):
    """Return the composition of poses by PyBullet."""
    position, quaternion = given[0]
    for inner in given[1:]:
        position, quaternion = pybullet.multiplyTransforms(position, quaternion, *inner)
    return position, quaternion


def agree(client, scene, bodies):
    """Check the distances of a scene against the true ones of bodies (name, shape, pose)."""
    for number, (name, shape, pose) in enumerate(bodies):
        parts = [o for o, of in zip(scene.obstacles, scene.names, strict=True) if of == name]
        assert parts
        points = np.random.default_rng(number).uniform(-0.7, 0.7, (60, 3)) + pose[0]
        exact = true_distance(client, shape, pose, points)
        distance = signed_distance(points, parts)
        beyond = {"cone": OVERSHOOT, "mesh": np.sqrt(3.0) * CELL}.get(shape, 0.0)
        far = distance > 0.01
        assert far.sum() > 20
        assert (distance[far] <= exact[far] + 1e-3).all()
        assert (distance[far] >= exact[far] - beyond - 1e-3).all()


def test_bodies_lie_where_pybullet_puts_them(write, bullet):
    """Of all shapes, in objects that are turned themselves, from YAML and from text."""
    own, inner = poses(0, len(SHAPES)), poses(1, len(SHAPES))
    objects = [
        (f"a {shape}", "", own[index], [(shape, inner[index])])
        for index, shape in enumerate(SHAPES)
    ]
    bodies = [(name, shape, chained(up, pose)) for name, _, up, ((shape, pose),) in objects]
    files = write(message(objects)), write(text(objects), "scene.scene")
    scenes = [PlanningScene.load(file, cell=CELL, overshoot=OVERSHOOT) for file in files]
    for scene in scenes:
        agree(bullet, scene, bodies)
        assert set(scene.names) == {name for name, *_ in objects}
        assert (scene.start, scene.goals) == (None, ())
    first, second = (scene.obstacles for scene in scenes)
    assert len(first) == len(second)


def test_many_bodies_are_all_kept(write):
    """Wherever they are: no limit of the environments' arm holds here."""
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    objects = [
        (f"o{index}", "base", pose, [("box", still), ("sphere", still)])
        for index, pose in enumerate(poses(2, 40))
    ]
    objects.append(("far", "base", ((0.0, 30.0, -20.0), (0.0, 0.0, 0.0, 1.0)), [("box", still)]))
    scene = PlanningScene.load(write(message(objects)))
    assert len(scene.obstacles) == 81
    assert scene.obstacles[-1].position == (0.0, 30.0, -20.0)


URDF = """<robot name="arm">
<link name="floor"/>
<joint name="stand" type="fixed"><parent link="floor"/><child link="base"/>
 <origin xyz="0.1 -0.2 0.7" rpy="0.3 -0.2 1.1"/></joint>
<link name="base"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="post"/>
 <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="1"/></joint>
<link name="post"/>
<joint name="shoulder" type="revolute"><parent link="post"/><child link="upper"/>
 <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1"/></joint>
<link name="upper"><collision><origin xyz="0.2 0 0"/>
 <geometry><box size="0.4 0.05 0.05"/></geometry></collision></link>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
 <origin xyz="0.4 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1"/></joint>
<link name="lower"><collision><origin xyz="0.2 0 0"/>
 <geometry><box size="0.4 0.05 0.05"/></geometry></collision></link>
<joint name="finger" type="prismatic"><parent link="lower"/><child link="left"/>
 <origin xyz="0.4 0.02 0"/><axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1"/></joint>
<link name="left"/>
<joint name="other" type="prismatic"><parent link="lower"/><child link="right"/>
 <origin xyz="0.4 -0.02 0"/><axis xyz="0 -1 0"/><limit lower="0" upper="0.04" velocity="1"/>
 <mimic joint="finger" multiplier="0.5" offset="0.01"/></joint>
<link name="right"/>
</robot>"""


def robot_in(folder, **held):
    path = Path(folder) / "arm.urdf"
    path.write_text(URDF)
    return Robot.from_urdf(path, "lower", held={"lift": 0.2, **held})


def test_frames_of_links_of_the_file_and_of_the_user_are_respected(write, bullet, tmp_path):
    robot = robot_in(tmp_path)
    (table, odom, shelf), inner = poses(3, 3), poses(4, 6)
    places = {
        "": ((0, 0, 0), (0, 0, 0, 1)),
        "world": ((0, 0, 0), (0, 0, 0, 1)),
        "odom": odom,
        "/table": chained(odom, table),
        "shelf": chained(odom, table, shelf),
    }
    turn = pybullet.getQuaternionFromEuler((0.3, -0.2, 1.1))
    base = ((0.1, -0.2, 0.7), turn)
    places["base"], places["post"] = base, chained(base, ((0, 0, 0.3), (0, 0, 0, 1)))
    transforms = [
        {
            "header": {"frame_id": parent},
            "child_frame_id": child,
            "transform": {"translation": list(pose[0]), "rotation": list(pose[1])},
        }
        for parent, child, pose in (("odom", "table", table), ("table", "shelf", shelf))
    ]
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    known = {name: place for name, place in places.items() if name not in ("", "world")}
    objects = [
        (name, name, still, [("cylinder", inner[index % 6])]) for index, name in enumerate(known)
    ]
    file = write(message(objects, fixed_frame_transforms=transforms))
    scene = PlanningScene.load(file, robot=robot, frames={"odom": odom})
    agree(
        bullet,
        scene,
        [(n, "cylinder", chained(places[n], pose)) for n, _, _, ((_, pose),) in objects],
    )
    alone = [(name, name, still, [("box", inner[0])]) for name in ("", "world", "base")]
    scene = PlanningScene.load(write(message(alone)), robot=robot)
    agree(
        bullet,
        scene,
        [(name, "box", chained(places[name], inner[0])) for name in ("", "world", "base")],
    )


def test_the_one_frame_of_a_file_is_taken_for_the_root_link(write, bullet):
    (pose,) = poses(5, 1)
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    file = write(message([("a", "base_link", pose, [("box", still)])]))
    agree(bullet, PlanningScene.load(file), [("a", "box", pose)])


def box_in(*frames, **fields):
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return message([(f"{f} box", f, still, [("box", still)]) for f in frames], **fields)


def refused(write, scene, tmp_path=None, **arguments):
    if tmp_path is not None:
        arguments["robot"] = robot_in(tmp_path)
    with pytest.raises(ValueError, match=r"\S") as caught:
        PlanningScene.load(write(scene), **arguments)
    return str(caught.value)


def test_frames_of_unknown_place_are_refused(write, tmp_path):
    turned = [0.0, 0.0, 0.0, 1.0]
    said = refused(write, box_in("odom", "base_link"))
    assert "frames must say where base_link and odom are" in said
    assert str(tmp_path / "scene.yaml") in said
    assert "where odom are" in refused(write, box_in("odom"), tmp_path)
    where = {"odom": ([0, 0, 1], turned)}
    assert "where base_link are" in refused(write, box_in("odom", "base_link"), frames=where)
    assert "of base_link, world, got odom" in refused(write, box_in("base_link"), frames=where)
    cycle = [
        {"header": {"frame_id": a}, "child_frame_id": b, "transform": {}}
        for a, b in (("x", "y"), ("y", "x"))
    ]
    assert "place 'x' in itself" in refused(write, box_in("x", fixed_frame_transforms=cycle))
    for frames, named in (
        (7, "frames must map names"),
        ({"odom": 3}, "frames['odom'] must be (position, quaternion), got 3"),
        ({"odom": ([0, 0], turned)}, "frames['odom'].position must have shape"),
        ({"odom": ([0, 0, 0], [0, 0, 0, 2])}, "frames['odom'].quaternion must have norm 1"),
    ):
        assert named in refused(write, box_in("odom"), frames=frames)


def moved(joint):
    transform = {"translation": [0, 0, 1], "rotation": [0, 0, 0, 1]}
    return {"multi_dof_joint_state": {"joint_names": [joint], "transforms": [transform]}}


@pytest.mark.parametrize(
    ("scene", "named", "skipped"),
    [
        ({"name": "no world"}, "world must be a mapping, got None", False),
        ([1, 2], "the file must be a mapping", False),
        ("a: [1", "not YAML", False),
        ("a: &x [1]\nb: *x\n", "aliases are not allowed", False),
        (
            box_in("world", robot_state=moved("virtual")),
            "moves the robot's base by 'virtual'",
            False,
        ),
        (
            box_in("world", robot_state={"joint_state": {"name": ["a"], "position": []}}),
            "robot_state.joint_state must have a position for each of its 1 names, got 0",
            False,
        ),
        (
            {"world": {"octomap": {"octomap": {"data": [1]}}}},
            "world has an octomap; skip_unsupported=True",
            True,
        ),
        (
            {"world": {"collision_objects": [{"id": "m", "meshes": [{"resource": "a.stl"}]}]}},
            "m.meshes[0] is a mesh of another file, which is not read",
            True,
        ),
        (
            {"world": {"collision_objects": [{"id": "p", "planes": [{"coef": [0, 0, 1, 0]}]}]}},
            "p.planes[0] is a plane, which is not read",
            True,
        ),
        (
            box_in("world", path_constraints={"joint_constraints": [{}]}),
            "it constrains the path",
            True,
        ),
    ],
)
def test_what_cannot_be_used_is_refused_or_skipped(write, scene, named, skipped):
    assert named in refused(write, scene)
    file = write(scene)
    if skipped:
        scene = PlanningScene.load(file, skip_unsupported=True)
        assert len(scene.obstacles) == ("world box" in scene.names)
    else:
        with pytest.raises(ValueError, match="that can be used"):
            PlanningScene.load(file, skip_unsupported=True)


@pytest.mark.parametrize("value", ["no", 1, None])
def test_whether_to_skip_is_yes_or_no(tmp_path, value):
    path = tmp_path / "scene.yaml"
    path.write_text("world: {collision_objects: []}")
    with pytest.raises(ValueError, match="skip_unsupported must be True or False, got"):
        PlanningScene.load(path, skip_unsupported=value)


def test_a_base_that_was_moved_is_the_users_to_place(write):
    scene = box_in("world", robot_state=moved("virtual"))
    placed = {"world": ([0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 1.0])}
    (box,) = PlanningScene.load(write(scene), frames=placed).obstacles
    assert box.position == (0.0, 0.0, -1.0)


def test_bodies_that_need_too_many_parts_are_named(write):
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    for shape, arguments, named in (
        ("mesh", {"cell": 0.001}, "odd.meshes[0], 0.3 x 0.2 x 0.15 m, would need about"),
        ("cone", {"overshoot": 1e-7}, "odd.primitives[0]: overshoot must be large enough"),
        ("cone", {"overshoot": 0.0}, "overshoot must be a finite number above"),
        ("mesh", {"cell": -1.0}, "cell must be a finite number above"),
    ):
        assert named in refused(write, message([("odd", "", still, [(shape, still)])]), **arguments)
    flat = message([("odd", "", still, [("mesh", still)])])
    flat["world"]["collision_objects"][0]["meshes"][0]["vertices"] = [[0, 0, 0]] * 6
    assert "odd.meshes[0] must have triangles of finite size" in refused(write, flat)


JOINTS = {"elbow": 0.5, "finger": 0.0, "other": 0.01, "lift": 0.2, "shoulder": -1.0}


def state(**changes):
    joints = {**JOINTS, **changes}
    return {"joint_state": {"name": list(joints), "position": list(joints.values())}}


def goal(**joints):
    return {
        "joint_constraints": [
            {"joint_name": name, "position": position} for name, position in joints.items()
        ]
    }


def test_queries_come_in_the_robots_order(write, tmp_path):
    robot = robot_in(tmp_path)
    assert robot.joints == ("shoulder", "elbow")
    asked = {
        "start_state": state(),
        "goal_constraints": [goal(elbow=0.1, shoulder=1.0), goal(shoulder=0.9, elbow=0.2)],
    }
    scene = PlanningScene.load(
        write(box_in("world", robot_state=state(shoulder=2.0, wheel=3.0))),
        request=write({**asked, "path_constraints": {"name": ""}}, "request.yaml"),
    )
    assert robot.configuration(scene.start, ignored=["wheel"]).tolist() == [-1.0, 0.5]
    assert [robot.configuration(given).tolist() for given in scene.goals] == [
        [1.0, 0.1],
        [0.9, 0.2],
    ]
    # All in one file, and a state alone.
    whole = PlanningScene.load(write(box_in("world", **asked)))
    assert (whole.start, whole.goals) == (JOINTS, scene.goals)
    alone = PlanningScene.load(write(box_in("world", robot_state=state())))
    assert (alone.start, alone.goals) == (JOINTS, ())
    diff = write({"start_state": {"is_diff": True}, "goal_constraints": []}, "diff.yaml")
    assert PlanningScene.load(write(box_in("world", robot_state=state())), request=diff).start == (
        JOINTS
    )


def test_joints_that_do_not_move_must_stand_as_the_robot_holds_them(tmp_path):
    robot = robot_in(tmp_path)
    assert dict(robot.standing) == pytest.approx({"lift": 0.2, "finger": 0.0, "other": 0.01})
    with pytest.raises(ValueError, match=r"held=\{'finger': 0.04, 'other': 0.03\}"):
        robot.configuration({**JOINTS, "finger": 0.04, "other": 0.03})
    # A mimic joint follows.
    open_hand = robot_in(tmp_path, finger=0.04)
    assert open_hand.configuration({**JOINTS, "finger": 0.04, "other": 0.03}).tolist() == [-1, 0.5]
    with pytest.raises(ValueError, match=r"held=\{'lift': 0.3\}"):
        robot.configuration({**JOINTS, "lift": 0.3})


@pytest.mark.parametrize(
    ("positions", "arguments", "named"),
    [
        ({"elbow": 0.5}, {}, "must give all joints, but lack shoulder"),
        ({**JOINTS, "wheel": 0.0}, {}, r"joints that the robot lacks \(ignored= .*: wheel"),
        ({**JOINTS, "elbow": "bent"}, {}, r"positions\['elbow'\] must be a finite number"),
        ([0.0, 0.5], {}, "positions must map names of joints to numbers"),
        (JOINTS, {"ignored": "wheel"}, "ignored must be names of joints"),
        (JOINTS, {"ignored": ["elbow"]}, "must give all joints, but lack elbow"),
    ],
)
def test_bad_positions_are_named(tmp_path, positions, arguments, named):
    with pytest.raises(ValueError, match=named):
        robot_in(tmp_path).configuration(positions, **arguments)


@pytest.mark.parametrize(
    ("request_", "named"),
    [
        ({"workspace": 1}, "it must have start_state or goal_constraints, got ['workspace']"),
        ({"start_state": 3}, "start_state must be a mapping"),
        ({"start_state": moved("planar")}, "start_state moves the robot's base by 'planar'"),
        ({"goal_constraints": [{"visibility_constraints": [{}]}]}, "only joint_constraints"),
        ({"goal_constraints": [{"position_constraints": [{}]}]}, "link_name must name a link"),
        ({"goal_constraints": [], "path_constraints": {"position_constraints": [1]}}, "the path"),
    ],
)
def test_damaged_requests_are_refused(write, request_, named):
    file = write(request_, "request.yaml")
    said = refused(write, box_in("world"), request=file)
    assert said.startswith(f"{file} is no request that can be used: ")
    assert named in said


def test_missing_files_are_os_errors(write, tmp_path):
    for arguments in ({}, {"request": tmp_path / "none.yaml"}):
        path = tmp_path / "none.scene" if not arguments else write(box_in("world"))
        with pytest.raises(FileNotFoundError):
            PlanningScene.load(path, **arguments)


def test_what_a_robot_knows_of_its_other_joints_and_links_is_saved(tmp_path):
    robot = robot_in(tmp_path)
    time = np.linspace(0.0, 1.0, 30)[:, None]
    paths = [np.hstack([time - 0.5, 0.5 * time + bend * time**2]) for bend in (0.0, 0.1, 0.2)]
    SMP.fit(paths, robot=robot).save(tmp_path / "arm.npz")
    again = SMP.load(tmp_path / "arm.npz").robot
    assert dict(again.standing) == dict(robot.standing)
    assert set(again.base_links) == {"floor", "base", "post"}
    for name, pose in robot.base_links.items():
        np.testing.assert_array_equal(again.base_links[name], pose)
    with np.load(tmp_path / "arm.npz") as archive:
        arrays = dict(archive)
    for name, bad in (("standing", [1]), ("standing", {"a": "b"}), ("base_links", {"a": [1.0]})):
        np.savez(tmp_path / "bad.npz", **{**arrays, name: np.array(json.dumps(bad))})
        with pytest.raises(ValueError, match=name):
            SMP.load(tmp_path / "bad.npz")
    # Files of before say neither.
    del arrays["standing"], arrays["base_links"]
    np.savez(tmp_path / "before.npz", **arrays)
    assert dict(SMP.load(tmp_path / "before.npz").robot.standing) == {}
