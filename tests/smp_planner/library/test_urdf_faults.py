"""Descriptions of robots that are wrong: nothing is taken for free or small, faults are named."""

import numpy as np
import pytest
import trimesh

from smp_planner.library.covering import MOST_SPHERES
from smp_planner.library.smp import SMP, Robot

BOX = '<box size="0.1 0.1 0.1"/>'
LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="1"/>'


def shape(geometry, tag="collision"):
    return f"<{tag}><geometry>{geometry}</geometry></{tag}>"


def joint(name, parent, child, limit=LIMIT, kind="revolute", axis="0 0 1", more=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/>{limit}{more}</joint>'
    )


def link(name, *shapes):
    return f'<link name="{name}">{"".join(shapes)}</link>'


def robot(folder, *elements, tip="arm", **options):
    folder.mkdir(exist_ok=True)
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(elements)}</robot>')
    return Robot.from_urdf(path, tip, **options)


def one(folder, geometry=BOX, limit=LIMIT, kind="revolute", axis="0 0 1", **options):
    parts = link("base"), joint("j", "base", "arm", limit, kind, axis), link("arm", shape(geometry))
    return robot(folder, *parts, **options)


@pytest.fixture(scope="module")
def block():
    return trimesh.creation.box((0.1, 0.1, 0.1)).export(file_type="stl")


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ('<box size="0 0.1 0.1"/>', "link 'arm', box, must have a positive size, got '0 0.1 0.1'"),
        ('<box size="0.1 -0.1 0.1"/>', "link 'arm', box, must have a positive size"),
        ('<box size="nan 0.1 0.1"/>', "link 'arm', box, must have 3 numbers as size"),
        ('<box size="0.1 0.1"/>', "link 'arm', box, must have 3 numbers as size"),
        ('<box size="inf 1 1"/>', "link 'arm', box, must have a finite size"),
        ('<cylinder radius="0" length="1"/>', "cylinder, must have a positive radius, got '0'"),
        ('<cylinder radius="0.1"/>', "cylinder, must have the attribute 'length'"),
        ("<sphere/>", "sphere, must have the attribute 'radius'"),
        ('<sphere radius="${r}"/>', r"radius='\$\{r\}': expand the file with xacro"),
        ('<cone radius="0.1" length="1"/>', "link 'arm', .* got <cone>"),
        ('<capsule radius="0.1"/>', "link 'arm', capsule, must have the attribute 'length'"),
        ('<capsule radius="-1" length="1"/>', "capsule, must have a positive radius, got '-1'"),
        (
            '<capsule radius="0.01" length="900"/>',
            "capsule of link 'arm', 0.02 x 0.02 x 900 m, .* choose a larger overshoot",
        ),
        ('<mesh filename="block.stl" scale="0.001"/>', "mesh, must have 3 numbers as scale"),
        ('<mesh filename="block.stl" scale="1 0 1"/>', "mesh, must have a scale that is not zero"),
        ('<mesh filename="block.step"/>', "block.step of link 'arm' must be of a kind of .*'step'"),
        ('<mesh filename="empty.stl"/>', "empty.stl of link 'arm' must have triangles"),
        ('<mesh filename="noise.obj"/>', "noise.obj of link 'arm'"),
        ('<mesh filename="package:///block.stl"/>', "link 'arm', .* must name a package"),
        ('<mesh filename="http://a/block.stl"/>', "link 'arm', .* is no name of a file"),
        ('<mesh filename="$(find a)/block.stl"/>', "link 'arm', .* expand the file with xacro"),
        ('<mesh filename="${path}/block.stl"/>', "link 'arm', .* expand the file with xacro"),
        ("<mesh/>", "link 'arm', mesh, names the mesh '', which is no name"),
        ('<mesh filename="../out.stl"/>', "link 'arm', .* lies outside of the folders"),
        (
            '<box size="90 90 90"/>',
            "box of link 'arm', 90 x 90 x 90 m, .* choose a larger overshoot",
        ),
        (
            '<mesh filename="block.stl" scale="1000 1000 1000"/>',
            "mesh of link 'arm', 100 x 100 x 100 m, .* millimetres",
        ),
    ],
)
def test_shapes_without_size_or_file_are_named(tmp_path, block, geometry, message):
    folder = tmp_path / "urdf"
    folder.mkdir()
    for name in ("block.stl", "block.step", "../out.stl"):
        (folder / name).write_bytes(block)
    (folder / "empty.stl").touch()
    (folder / "noise.obj").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match=message):
        one(folder, geometry)


@pytest.mark.parametrize("overshoot", [0.0, -1.0, float("nan"), "0.1", 1e-5])
def test_the_overshoot_is_checked(tmp_path, overshoot):
    with pytest.raises(ValueError, match="overshoot"):
        one(tmp_path, overshoot=overshoot)
    assert MOST_SPHERES > len(one(tmp_path, overshoot=0.01).model.radius) > 8


@pytest.mark.parametrize("name", ["block.stl", "with%20blank.stl", "with blank.stl"])
def test_meshes_are_found_by_their_names(tmp_path, block, name):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / name.replace("%20", " ")).write_bytes(block)
    boxes = one(tmp_path / "urdf").model
    stated = {"parts": tmp_path / "meshes"}
    for prefix in ("../meshes/", f"file://{tmp_path}/meshes/", "package://parts/"):
        mesh = f'<mesh filename="{prefix}{name}"/>'
        found = one(tmp_path / "urdf", mesh, packages=stated).model
        assert len(found.radius) == len(boxes.radius)
    with pytest.raises(FileNotFoundError, match="names the mesh 'package://parts"):
        one(tmp_path / "urdf", f'<mesh filename="package://parts/{name}"/>')


@pytest.mark.parametrize(
    ("given", "range_", "velocity"),
    [
        ({"kind": "continuous", "limit": '<limit effort="9" velocity="1.2"/>'}, 25.1, 1.2),
        ({"kind": "continuous", "limit": "", "velocities": {"j": 3}}, 25.1, 3.0),
        (
            {"kind": "continuous", "limit": "", "velocities": {"j": 1}, "limits": {"j": (0, 1)}},
            1,
            1,
        ),
        ({"kind": "continuous", "limit": '<limit lower="0" upper="0" velocity="1"/>'}, 25.1, 1.0),
        ({"limit": '<limit lower="-1" upper="1" velocity="0"/>', "velocities": {"j": 0.5}}, 2, 0.5),
        ({"limits": {"j": [-0.5, 0.5]}}, 1.0, 2.0),
    ],
)
def test_limits_come_from_the_file_or_are_given(tmp_path, given, range_, velocity):
    made = one(tmp_path, **given)
    assert made.model.upper[0] - made.model.lower[0] == pytest.approx(range_, abs=0.05)
    assert made.model.velocity[0] == velocity
    assert made.continuous == (given.get("kind") == "continuous",)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"limit": ""}, r"'j' must have a range .* limits=\{'j': \(lower, upper\)\}"),
        ({"kind": "continuous", "limit": ""}, r"'j' must have .* velocities=\{'j': velocity\}"),
        ({"limit": '<limit lower="1" upper="-1" velocity="1"/>'}, "'j' must have a range"),
        ({"limit": '<limit lower="-1" upper="inf" velocity="1"/>'}, "'j' must have a range"),
        ({"limit": '<limit lower="a" upper="1" velocity="1"/>'}, "'j', limit, must have 1 number"),
        ({"limit": '<limit lower="${-pi}" upper="1"/>'}, "'j', limit, has lower=.* xacro"),
        ({"axis": "0, 0, 1"}, "'j', axis, must have 3 numbers as xyz"),
        ({"axis": "0 1"}, "'j', axis, must have 3 numbers as xyz"),
        ({"kind": "hinge"}, "'j' must be of a type of revolute, .* got 'hinge'"),
        ({"limits": {"k": (0, 1)}}, "limits names joints that the URDF lacks: k"),
        ({"limits": {"j": (1, 0)}}, r"limits\['j'\] must be \(lower, upper\)"),
        ({"limits": ["j"]}, "limits must map names of joints"),
        ({"velocities": {"j": 0}}, r"velocities\['j'\] must be a finite number above"),
        ({"held": ["j"]}, "held must map names of joints to numbers, got"),
        ({"held": {"j": 1.1}}, r"held\['j'\] must be within .* \[-1.0, 1.0\], got 1.1"),
        ({"held": {"j": float("nan")}}, r"held\['j'\] must be a finite number"),
    ],
)
def test_joints_without_limits_are_named(tmp_path, given, message):
    with pytest.raises(ValueError, match=message):
        one(tmp_path, **given)


def test_doubled_names_and_circles_are_named(tmp_path):
    base, arm = link("base"), link("arm", shape(BOX))
    up = joint("j", "base", "arm")
    for parts, message in (
        ((base, base, arm, up), "name each link once, but a link 'base' stands there 2 times"),
        ((base, arm, link(""), up), "name each link once, but a link has no name"),
        ((base, arm, link("a"), up, joint("j", "arm", "a")), "each joint once, but a joint 'j'"),
        ((base, arm, up, joint("k", "base", "arm")), "'arm' must have one joint above it"),
        (
            (base, arm, up, link("a"), link("b"), joint("k", "a", "b"), joint("l", "b", "a")),
            "not joined to its root",
        ),
        (('<!DOCTYPE x [<!ENTITY a "b">]>', base, arm, up), "is not a URDF"),
        (
            (base, arm, up, '<xacro:macro xmlns:xacro="http://www.ros.org/wiki/xacro"/>'),
            "holds <xacro:macro>: expand it",
        ),
        ((base, arm, joint("j", "base", "arm", more='<mimic joint="k"/>')), "mimics 'k', which is"),
    ):
        with pytest.raises(ValueError, match=message):
            robot(tmp_path, *parts)


def test_links_that_move_have_bodies(tmp_path):
    seen = link("arm", shape(BOX, "visual"))
    up = link("base"), joint("j", "base", "arm")
    for arm in (seen, link("arm")):
        with pytest.raises(ValueError, match=r"arm have none: .* bodiless=\('arm',\)"):
            robot(tmp_path, *up, arm)
        assert len(robot(tmp_path, *up, arm, bodiless=["arm"]).model.radius) == 0
    flange = joint("f", "arm", "flange", kind="fixed")
    whole = link("arm", shape(BOX))
    # A frame beside a body needs none; what is seen does.
    robot(tmp_path, *up, whole, flange, link("flange"))
    with pytest.raises(ValueError, match=r"but flange have none"):
        robot(tmp_path, *up, whole, flange, link("flange", shape(BOX, "visual")))
    for names, message in (
        ("arm", "names of links"),
        (["a"], "got 'a'"),
        (["base", "arm"], "arm"),
        ([["arm"]], r"got \['arm'\]"),
        ([3], "got 3"),
    ):
        with pytest.raises(ValueError, match=message):
            robot(tmp_path, *up, whole, bodiless=names)


@pytest.mark.parametrize("tip", [None, ["arm"], 3, "Arm"])
def test_a_tip_is_the_name_of_a_link(tmp_path, tip):
    with pytest.raises(ValueError, match="tip must be one of base, arm; got"):
        one(tmp_path, tip=tip)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joints_of_several_coordinates_are_held_at_their_origin(tmp_path, kind):
    parts = (
        link("base"),
        joint("free", "base", "root", "", kind),
        link("root"),
        joint("j", "root", "arm"),
        link("arm", shape(BOX)),
    )
    with pytest.raises(ValueError, match=f"'free' in the chain to 'arm' is {kind}; .* be held"):
        robot(tmp_path, *parts)
    made = robot(tmp_path, *parts, held={"free": 0.0})
    np.testing.assert_allclose(made.tool_positions(np.zeros(1)), 0.0, atol=1e-12)
    with pytest.raises(ValueError, match=rf"held\['free'\] must be 0 for a {kind} joint.* got 0.5"):
        robot(tmp_path, *parts, held={"free": 0.5})


@pytest.mark.parametrize("scale", ["0.001 0.001 0.001", "1e-6 1e-6 1e-6", "-1e-4 1e-4 1e-4"])
def test_meshes_scaled_twice_are_warned_of(tmp_path, block, caplog, scale):
    (tmp_path / "block.stl").write_bytes(block)
    one(tmp_path, f'<mesh filename="block.stl" scale="{scale}"/>')
    (record,) = caplog.records
    assert "block.stl of link 'arm' is only" in record.getMessage()
    caplog.clear()
    one(tmp_path, '<mesh filename="block.stl" scale="0.1 0.1 0.1"/>')
    assert not caplog.records


def test_a_robot_without_any_body_is_warned_of(tmp_path, caplog):
    ways = [np.linspace((0.0,), (end,), 20) for end in (0.5, 0.6)]
    for base, spheres in ((link("base"), False), (link("base", shape(BOX)), True)):
        made = robot(tmp_path, base, joint("j", "base", "arm"), link("arm"), bodiless=["arm"])
        assert bool(len(made.model.radius)) == spheres
        caplog.clear()
        SMP.fit(ways, robot=made)
        (record,) = caplog.records
        assert "no link that moves has a body" in record.getMessage()
    caplog.clear()
    SMP.fit(ways, robot=one(tmp_path))
    assert not caplog.records


def test_mimic_joints_follow_what_they_mimic(tmp_path):
    def hand(more_right, **options):
        parts = [
            link("base"),
            joint("j", "base", "arm"),
            link("arm", shape(BOX)),
            joint("left", "arm", "a", kind="prismatic", axis="1 0 0"),
            joint("right", "arm", "b", kind="prismatic", axis="1 0 0", more=more_right),
            joint("last", "arm", "c", "", "prismatic", "1 0 0", '<mimic joint="right"/>'),
            *(link(name, shape(BOX)) for name in "abc"),
        ]
        return robot(tmp_path, *parts, **options).model.center[:, 0]

    mimic = '<mimic joint="left" multiplier="-2" offset="0.1"/>'
    still = hand("", held={"left": 0.0})
    moved = hand(mimic, held={"left": 0.3}) - still
    each = len(still) // 4
    # 0.3 m of its own, and twice -2 * 0.3 + 0.1 m.
    np.testing.assert_allclose(sorted(moved[::each]), [-0.5, -0.5, 0.0, 0.3], atol=1e-12)
    with pytest.raises(ValueError, match="joint 'right' is a mimic of 'j', which moves"):
        hand('<mimic joint="j"/>')
    with pytest.raises(ValueError, match="mimics itself"):
        hand('<mimic joint="last"/>')
    assert len(hand('<mimic joint="j"/>', held={"right": 0.1})) == len(still)
