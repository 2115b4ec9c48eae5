"""Files of MoveIt: text and YAML say the same, and bad ones are named by line or field."""

import numpy as np
import pytest

from smp_gym.datasets.motion_bench_maker import load_obstacles
from smp_gym.datasets.moveit_scene import (
    base_moved,
    bodies_of,
    frames_of,
    goals_of,
    has_octomap,
    joints_of,
    path_constrained,
    read_message,
)

NEW = """(noname)+
* a box of two
0.5 0 0.1
0 0 0.70710678 0.70710678
2
box
0.1 0.2 0.3
0.1 0 0
0 0 0 1
0.5 0.5 0.5 1
cone
0.05 0.2
0 0.1 0
0 0 0 1
0 0 0 0
1
handle
0 0 0.1
0 0 0 1
* can
0 0 0
0 0 0 1
1
cylinder
0.03
0.14
0.6 0.1 0.07 0 0 0 1
0 0 0 0
0
* tetrahedron
0 0 0
0 0 0 1
2
mesh
4 4
0 0 0
0.1 0 0
0 0.1 0
0 0 0.1
0 2 1
0 1 3
1 2 3
0 3 2
0.4 0 0.2
0 0 0 1
0 0 0 0
sphere
4e-2
0.6 -0.1 0.2
0 0 0 1
0 0 0 0
0
.
"""

OLD = """scene
* board
1
box
0.3 0.2 0.02
0.5 0 0.45
0 0.383 0 0.924
0 0 0 0
* floor
1
plane
0 0 1 0
0 0 0
0 0 0 1
0 0 0 0
.
"""

YAML = """
world:
  collision_objects:
    - id: a box of two
      pose: {position: [0.5, 0, 0.1], orientation: [0, 0, 0.70710678, 0.70710678]}
      primitives:
        - {type: box, dimensions: [0.1, 0.2, 0.3]}
        - {type: 4, dimensions: [0.2, 0.05]}
      primitive_poses:
        - {position: [0.1, 0, 0], orientation: [0, 0, 0, 1]}
        - {position: {x: 0, y: 0.1, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 1}}
    - id: can
      primitives: [{type: cylinder, dimensions: [0.14, 0.03]}]
      primitive_poses: [{position: [0.6, 0.1, 0.07], orientation: [0, 0, 0, 1]}]
    - id: tetrahedron
      primitives: [{type: sphere, dimensions: [0.04]}]
      primitive_poses: [{position: [0.6, -0.1, 0.2], orientation: [0, 0, 0, 1]}]
      meshes:
        - vertices: [[0, 0, 0], {x: 0.1, y: 0, z: 0}, [0, 0.1, 0], [0, 0, 0.1]]
          triangles: [[0, 2, 1], {vertex_indices: [0, 1, 3]}, [1, 2, 3], [0, 3, 2]]
      mesh_poses: [{position: [0.4, 0, 0.2], orientation: [0, 0, 0, 1]}]
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a file and returns its path."""

    def to_file(text, name="scene.scene"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return to_file


def told(body):
    mesh = () if body.vertices is None else (body.vertices.tolist(), body.triangles.tolist())
    pose = np.round([*body.pose.position, *body.pose.quaternion], 9)
    return body.name, body.kind, body.frame, body.dimensions, pose.tolist(), mesh


def test_text_and_yaml_say_the_same(write):
    pytest.importorskip("yaml", reason="PyYAML is not installed")
    text = sorted(told(body) for body in bodies_of(read_message(write(NEW))))
    assert text == sorted(told(body) for body in bodies_of(read_message(write(YAML, "s.yaml"))))
    assert [kind for _, kind, *_ in text] == ["box", "cone", "cylinder", "mesh", "sphere"]
    _, _, _, dimensions, pose, _ = text[1]
    assert dimensions == (0.2, 0.05)
    # A quarter turn takes (0, 0.1) to (-0.1, 0).
    assert pose[:3] == pytest.approx([0.4, 0.0, 0.1])


def test_text_of_before_has_no_poses_of_objects(write):
    board, floor = bodies_of(read_message(write(OLD)))
    assert (board.kind, board.dimensions, floor.kind) == ("box", (0.3, 0.2, 0.02), "plane")
    assert board.pose.position == pytest.approx([0.5, 0.0, 0.45])
    norm = np.hypot(0.383, 0.924)
    assert board.pose.quaternion == pytest.approx((0.0, 0.383 / norm, 0.0, 0.924 / norm))


def test_line_breaks_and_byte_order_marks_do_not_matter(write):
    plain = [told(body) for body in bodies_of(read_message(write(NEW)))]
    for changed in (
        NEW.replace("\n", "\r\n"),
        "\ufeff" + NEW,
        NEW.replace("0.03\n0.14", "0.03 0.14"),
    ):
        assert [told(body) for body in bodies_of(read_message(write(changed)))] == plain


def test_an_empty_scene_has_no_bodies(write):
    assert list(bodies_of(read_message(write("(noname)\n.\n")))) == []


def test_the_environments_read_text_too(write):
    (board,) = load_obstacles(write(OLD), skip_unsupported=True)
    assert board.size == pytest.approx((0.15, 0.10, 0.01))
    with pytest.raises(ValueError, match=r"floor.planes\[0\] is a plane, .* skip_unsupported"):
        load_obstacles(write(OLD))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must be followed by"),
        (NEW.replace("\n.\n", "\n"), r"line 52 must be followed by '\*' or '.', got the end"),
        (NEW + "* more\n", "line 54 must be empty after the end '.', got '\\*'"),
        (NEW.replace("* can", "can"), r"line 20 must begin with '\*' or '.', got 'can'"),
        (NEW.replace("* can", "*"), r"line 20 must have an id of its own after '\*', got none"),
        (NEW.replace("* can", "* tetrahedron"), "line 30 must have an id .* 'tetrahedron' once"),
        (NEW.replace("\nsphere", "\nball"), "line 47 must name a shape of box, .* got 'ball'"),
        (
            NEW.replace("0.03\n", "wide\n"),
            "line 25 must hold the measures of a cylinder, got 'wide'",
        ),
        (NEW.replace("0.03\n", "nan\n"), "line 25 must hold the measures of a cylinder, got 'nan'"),
        (NEW.replace("0.03\n", "0\n"), r"can.primitives\[0\].dimensions must be positive"),
        (NEW.replace("4 4\n", "4 4.5\n"), "line 35 must hold the number of triangles, got '4.5'"),
        (NEW.replace("4 4\n", "4 -1\n"), "line 35 must hold the number of triangles, got '-1'"),
        (NEW.replace("4 4\n", "4 999999999\n"), "line 35 announces 3000000009 .* got .* words"),
        (NEW.replace("0 3 2\n", "0 3 4\n"), r"meshes\[0\].triangles\[3\] must be three of the 4"),
        (NEW.replace("\n2\nbox", "\nx\nbox"), "line 5 must hold the number of shapes, got 'x'"),
        (NEW.replace("0 0 0.70710678 0.70710678", "0 0 0 0"), "pose.orientation must have norm 1"),
    ],
)
def test_damaged_texts_are_refused_by_line_or_field(write, text, message):
    with pytest.raises(ValueError, match=message):
        list(bodies_of(read_message(write(text))))


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "scene.scene"
    path.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(ValueError, match="it is no text"):
        read_message(path)


def test_texts_cut_anywhere_are_refused(write):
    words = NEW.split("\n")
    for count in range(len(words) - 2):
        with pytest.raises(ValueError, match="line"):
            list(bodies_of(read_message(write("\n".join(words[:count])))))


MESH = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}


def with_mesh(**changes):
    item = {"id": "m", "meshes": [{**MESH, **changes}], "mesh_poses": [{}]}
    return {"world": {"collision_objects": [item]}}


@pytest.mark.parametrize(
    ("message", "named"),
    [
        (with_mesh(vertices=[[0, 0]]), r"m.meshes\[0\].vertices\[0\] must be \[x, y, z\]"),
        (with_mesh(vertices=7), r"m.meshes\[0\].vertices must be a list"),
        (with_mesh(triangles=[]), r"m.meshes\[0\] must have vertices and triangles"),
        (with_mesh(triangles=["012"]), r"triangles\[0\] must be three of the 3"),
        (with_mesh(triangles=[[0, 1, True]]), r"triangles\[0\] must be three of the 3"),
        (with_mesh(triangles=[[0, 1, -1]]), r"triangles\[0\] must be three of the 3"),
        (with_mesh(triangles=[{"vertices": [0, 1, 2]}]), r"triangles\[0\] must be three of the 3"),
        (
            {"world": {"collision_objects": [{"id": "m", "meshes": [MESH]}]}},
            "m must have a pose for each of its 1 meshes, got 0",
        ),
    ],
)
def test_damaged_meshes_are_refused_by_field(message, named):
    with pytest.raises(ValueError, match=named):
        list(bodies_of(message))


def test_meshes_of_other_files_have_no_vertices():
    item = {"id": "m", "meshes": [{"resource": "package://a/b.stl"}]}
    (body,) = bodies_of({"world": {"collision_objects": [item]}})
    assert (body.kind, body.vertices) == ("mesh", None)


def test_frames_have_parents_and_poses():
    given = [
        {"child_frame_id": "world", "transform": {"translation": [0, 0, 0]}},
        {
            "header": {"frame_id": "/odom"},
            "child_frame_id": "table",
            "transform": {"translation": {"x": 1, "y": 0, "z": 0}, "rotation": [0, 0, 1, 0]},
        },
    ]
    frames = frames_of({"fixed_frame_transforms": given})
    assert list(frames) == ["table"]
    parent, pose = frames["table"]
    assert parent == "odom"
    assert pose.of(np.array([0.1, 0.2, 0.3])) == pytest.approx([0.9, -0.2, 0.3])
    moved = {"child_frame_id": "world", "transform": {"translation": [0, 0, 1]}}
    for entries, named in (
        ([moved], r"\[0\] must not move the frame 'world' in itself"),
        ([given[1], given[1]], r"\[1\] must place another frame .* got 'table'"),
        ([{"child_frame_id": "a"}], r"\[0\].transform must be a mapping"),
        (7, "fixed_frame_transforms must be a list"),
    ):
        with pytest.raises(ValueError, match=named):
            frames_of({"fixed_frame_transforms": entries})


@pytest.mark.parametrize(
    ("state", "named"),
    [
        (7, "start must be a mapping"),
        ({"joint_state": {"name": ["a"], "position": []}}, "position for each of its 1 names"),
        ({"joint_state": {"name": ["a", "a"], "position": [0, 1]}}, "each joint once, got 'a'"),
        ({"joint_state": {"name": [3], "position": [0]}}, "each joint once, got 3"),
        ({"joint_state": {"name": ["a"], "position": ["far"]}}, "finite numbers, got 'far'"),
        ({"joint_state": {"name": "a", "position": [0]}}, "joint_state.name must be a list"),
    ],
)
def test_damaged_states_are_refused_by_field(state, named):
    with pytest.raises(ValueError, match=named):
        joints_of(state, "start")


def test_what_a_robot_holds_and_where_it_stands_is_told():
    state = {
        "joint_state": {"name": ["b", "a"], "position": [1, "2e-1"]},
        "multi_dof_joint_state": {
            "joint_names": ["virtual"],
            "transforms": [{"translation": [0, 0, 0.5], "rotation": [0, 0, 0, 1]}],
        },
    }
    assert joints_of(state, "s") == {"b": 1.0, "a": 0.2}
    assert base_moved(state, "s") == "virtual"
    state["multi_dof_joint_state"]["transforms"][0]["translation"] = [0, 0, 0]
    assert base_moved(state, "s") is None
    assert joints_of(None, "s") == {}


def test_an_octomap_without_data_is_none():
    empty = {"header": {"frame_id": ""}, "octomap": {"id": "", "data": []}}
    assert not has_octomap({"world": {"octomap": empty}})
    assert has_octomap({"world": {"octomap": {"octomap": {"id": "OcTree", "data": [1]}}}})


def test_goals_are_joints_by_name():
    goal = {"joint_constraints": [{"joint_name": "a", "position": 0.5, "tolerance_above": 0.1}]}
    assert goals_of({"goal_constraints": [goal, goal]}) == ({"a": 0.5}, {"a": 0.5})
    assert goals_of({}) == ()
    for entry, named in (
        ({**goal, "position_constraints": [{}]}, r"\[0\] has position_constraints, but only joint"),
        ({**goal, "orientation_constraints": [{}]}, "has orientation_constraints, but only joint"),
        ({"visibility_constraints": [{}]}, "has visibility_constraints, but only joint"),
        ({}, "joint_constraints must hold at least one joint"),
        ({"joint_constraints": [{"joint_name": "a"}]}, r"\[0\].position must hold finite numbers"),
        ({"joint_constraints": goal["joint_constraints"] * 2}, "each joint once, got 'a'"),
    ):
        with pytest.raises(ValueError, match=named):
            goals_of({"goal_constraints": [entry]})
    assert not path_constrained({"path_constraints": {"name": "", "joint_constraints": []}})
    assert path_constrained({"path_constraints": {"orientation_constraints": [{}]}})
    assert path_constrained({"trajectory_constraints": {"constraints": [{}]}})
