"""The packaged arm against the vendor's model, the physics engine and its own description."""

import json
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pybullet
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from smp_gym.assets import asset_path, jaco_urdf
from smp_gym.jaco_assets.description import Link, description, link_spheres, write
from smp_gym.jaco_assets.solids import Box

ARM = ("j2s6s200_link_base", *(f"j2s6s200_link_{i}" for i in range(1, 7)))
FINGERS = tuple(f"j2s6s200_link_finger_{part}" for part in ("1", "tip_1", "2", "tip_2"))
MESHES = {
    "j2s6s200_link_base": ("base",),
    "j2s6s200_link_1": ("shoulder", "ring_big"),
    "j2s6s200_link_2": ("arm", "ring_big"),
    "j2s6s200_link_3": ("forearm", "ring_big"),
    "j2s6s200_link_4": ("wrist_spherical_1", "ring_small"),
    "j2s6s200_link_5": ("wrist_spherical_2", "ring_small"),
    "j2s6s200_link_6": ("hand_2finger", "ring_small"),
    "j2s6s200_link_finger_1": ("finger_proximal",),
    "j2s6s200_link_finger_tip_1": ("finger_distal",),
    "j2s6s200_link_finger_2": ("finger_proximal",),
    "j2s6s200_link_finger_tip_2": ("finger_distal",),
}
"""Which of the vendor's meshes each link wears, as the vendor's URDF has it."""


def _vendor() -> Path:
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("needs the meshes extra")
    share = "cmeel.prefix/share/example-robot-data/robots/kinova_description"
    return Path(str(package.locate_file(share)))


def _numbers(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()])


class Solid:
    """A collision shape as the URDF has it."""

    def __init__(self, collision: ET.Element) -> None:
        origin = collision.find("origin")
        self.position = _numbers(origin.get("xyz"))
        self.rotation = Rotation.from_euler("xyz", _numbers(origin.get("rpy"))).as_matrix()
        shape = collision.find("geometry")[0]
        if shape.tag == "box":
            self.mesh = trimesh.creation.box(_numbers(shape.get("size")))
        else:
            radius, length = float(shape.get("radius")), float(shape.get("length"))
            self.mesh = trimesh.creation.cylinder(radius, length, sections=256)
        self.size = shape

    def local(self, points: np.ndarray) -> np.ndarray:
        return (points - self.position) @ self.rotation

    def excess(self, points: np.ndarray) -> np.ndarray:
        """How far points are beyond the farthest face, m; at most 0 inside."""
        local = np.abs(self.local(points))
        if self.size.tag == "box":
            return (local - _numbers(self.size.get("size")) / 2).max(axis=1)
        across = np.linalg.norm(local[:, :2], axis=1) - float(self.size.get("radius"))
        return np.maximum(across, local[:, 2] - float(self.size.get("length")) / 2)

    def surface(self, count: int) -> np.ndarray:
        points = trimesh.sample.sample_surface(self.mesh, count, seed=0)[0]
        points = np.concatenate([self.mesh.vertices, points])
        return points @ self.rotation.T + self.position

    def volume(self, count: int) -> np.ndarray:
        half = self.mesh.extents / 2
        points = np.random.default_rng(0).uniform(-half, half, (count, 3))
        points = points @ self.rotation.T + self.position
        return points[self.excess(points) <= 0]


def _solids() -> dict[str, list[Solid]]:
    links = ET.parse(jaco_urdf()).getroot().iter("link")
    return {link.get("name"): [Solid(c) for c in link.iter("collision")] for link in links}


def _spheres() -> dict[str, np.ndarray]:
    data = json.loads(asset_path("jaco", "spheres.json").read_text())
    return {name: np.array(rows) for name, rows in data["links"].items()}


def _beyond_spheres(points: np.ndarray, spheres: np.ndarray) -> np.ndarray:
    reach = np.linalg.norm(points[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
    return reach.min(axis=1)


def _mesh_points(directory: Path, names: tuple[str, ...]) -> np.ndarray:
    pytest.importorskip("collada", reason="needs the meshes extra")
    points = []
    for name in names:
        mesh = trimesh.load_mesh(directory / "meshes" / f"{name}.dae")
        points += [mesh.vertices, trimesh.sample.sample_surface(mesh, 20_000, seed=1)[0]]
    return np.concatenate(points)


class Arm:
    """A URDF in a physics world of its own."""

    def __init__(self, path: Path) -> None:
        self.client = pybullet.connect(pybullet.DIRECT)
        self.body = pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=self.client)
        count = pybullet.getNumJoints(self.body, physicsClientId=self.client)
        self.info = [
            pybullet.getJointInfo(self.body, joint, physicsClientId=self.client)
            for joint in range(count)
        ]
        self.joints = {info[1].decode(): info[0] for info in self.info}
        self.links = {info[12].decode(): info[0] for info in self.info}

    def set(self, configuration: np.ndarray) -> None:
        for index, angle in enumerate(configuration, 1):
            joint = self.joints[f"j2s6s200_joint_{index}"]
            pybullet.resetJointState(self.body, joint, angle, physicsClientId=self.client)

    def pose(self, link: str) -> tuple[np.ndarray, np.ndarray]:
        state = pybullet.getLinkState(
            self.body,
            self.links[link],
            computeForwardKinematics=True,
            physicsClientId=self.client,
        )
        return np.array(state[4]), Rotation.from_quat(state[5]).as_matrix()

    def distance(self, first: str, second: str) -> float:
        points = pybullet.getClosestPoints(
            self.body,
            self.body,
            1.0,
            self.links[first],
            self.links[second],
            physicsClientId=self.client,
        )
        return min(point[8] for point in points)

    def limits(self) -> np.ndarray:
        joints = [self.joints[f"j2s6s200_joint_{index}"] for index in range(1, 7)]
        return np.array([self.info[joint][8:10] for joint in joints])


@pytest.fixture
def arm():
    arm = Arm(jaco_urdf())
    yield arm
    pybullet.disconnect(arm.client)


def test_joints_and_inertias_are_the_vendors():
    vendor = ET.parse(_vendor() / "robots" / "kinova.urdf").getroot()
    ours = ET.parse(jaco_urdf()).getroot()
    for kind in ("link", "joint"):
        assert {e.get("name") for e in ours.iter(kind)} == {
            e.get("name") for e in vendor.findall(kind)
        }
    for joint in ours.iter("joint"):
        other = vendor.find(f"joint[@name='{joint.get('name')}']")
        assert joint.find("parent").attrib == other.find("parent").attrib
        assert joint.find("child").attrib == other.find("child").attrib
        for key in ("xyz", "rpy"):
            np.testing.assert_allclose(
                _numbers(joint.find("origin").get(key)),
                _numbers(other.find("origin").get(key)),
                atol=1e-9,
            )
        if joint.get("type") != "fixed":
            assert joint.find("axis").attrib == other.find("axis").attrib
            for key, value in joint.find("limit").attrib.items():
                assert float(value) == pytest.approx(float(other.find("limit").get(key)))
            finger = "finger" in joint.get("name")
            assert joint.get("type") == ("revolute" if finger else other.get("type"))
    for link in ours.iter("link"):
        if "finger" in link.get("name"):
            continue
        inertial = link.find("inertial")
        other = vendor.find(f"link[@name='{link.get('name')}']").find("inertial")
        for tag, keys in (("mass", ("value",)), ("inertia", ("ixx", "iyy", "izz"))):
            for key in keys:
                expected = pytest.approx(float(other.find(tag).get(key)))
                assert float(inertial.find(tag).get(key)) == expected
        np.testing.assert_allclose(
            _numbers(inertial.find("origin").get("xyz")),
            _numbers(other.find("origin").get("xyz")),
        )


def test_links_are_where_the_vendors_model_puts_them(arm, tmp_path):
    tree = ET.parse(_vendor() / "robots" / "kinova.urdf")
    for link in tree.getroot().iter("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                link.remove(element)
    tree.write(tmp_path / "bare.urdf")
    vendor = Arm(tmp_path / "bare.urdf")
    try:
        for configuration in np.random.default_rng(0).uniform(-6, 6, (50, 6)):
            for model in (arm, vendor):
                model.set(configuration)
            for link in (*ARM, *FINGERS, "j2s6s200_end_effector"):
                (position, rotation), (expected, expected_rotation) = (
                    model.pose(link) for model in (arm, vendor)
                )
                np.testing.assert_allclose(position, expected, atol=1e-6)
                np.testing.assert_allclose(rotation, expected_rotation, atol=1e-5)
    finally:
        pybullet.disconnect(vendor.client)


@pytest.mark.parametrize("link", MESHES)
def test_shapes_contain_the_vendors_meshes(link):
    points = _mesh_points(_vendor(), MESHES[link])
    excess = np.min([solid.excess(points) for solid in _solids()[link]], axis=0)
    assert excess.max() <= 1e-4
    surface = np.concatenate([solid.surface(2000) for solid in _solids()[link]])
    overshoot = cKDTree(points).query(surface)[0]
    # The inner faces of shapes that overlap are counted too, so this is an upper bound.
    assert overshoot.mean() < 0.013
    assert overshoot.max() < 0.033


@pytest.mark.parametrize("link", MESHES)
def test_spheres_contain_the_shapes(link):
    solids, spheres = _solids()[link], _spheres()[link]
    surface = np.concatenate([solid.surface(2000) for solid in solids])
    volume = np.concatenate([solid.volume(2000) for solid in solids])
    assert _beyond_spheres(np.concatenate([surface, volume]), spheres).max() <= 1e-6

    rng = np.random.default_rng(0)
    direction = rng.normal(size=(5000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    index = rng.integers(len(spheres), size=5000)
    outermost = spheres[index, :3] + direction * spheres[index, 3:]
    outermost = outermost[_beyond_spheres(outermost, spheres) > -1e-9]
    overshoot = cKDTree(surface).query(outermost)[0]
    assert overshoot.mean() < 0.016
    assert overshoot.max() < 0.035


def test_there_are_few_spheres():
    spheres = _spheres()
    assert set(spheres) == set(MESHES)
    assert 30 <= sum(len(spheres[link]) for link in ARM) <= 40
    assert all(2 <= len(spheres[link]) <= 3 for link in FINGERS)
    assert all((rows[:, 3] > 0).all() for rows in spheres.values())


def test_only_listed_pairs_of_links_can_touch(arm):
    data = json.loads(asset_path("jaco", "spheres.json").read_text())
    listed = {tuple(pair) for pair in data["self_collision_links"]}
    assert len(listed) == len(data["self_collision_links"])
    apart = {(ARM[i], ARM[k]) for i in range(7) for k in range(i + 2, 7)}
    assert listed < apart
    lower, upper = arm.limits().T
    rng = np.random.default_rng(0)
    for configuration in rng.uniform(lower, upper, (200, 6)):
        # Folded as far as the joints go is where links come closest.
        for joint in (1, 2, 4):
            if rng.random() < 0.5:
                configuration[joint] = rng.choice([lower[joint], upper[joint]])
        arm.set(configuration)
        for first, second in apart - listed:
            assert arm.distance(first, second) > 0, (first, second, configuration)


def test_every_listed_pair_of_links_can_touch_and_can_part(arm):
    data = json.loads(asset_path("jaco", "spheres.json").read_text())
    touched, parted = set(), set()
    lower, upper = arm.limits().T
    rng = np.random.default_rng(0)
    for configuration in rng.uniform(lower, upper, (1500, 6)):
        arm.set(configuration)
        for first, second in data["self_collision_links"]:
            far = arm.distance(first, second) > 0
            (parted if far else touched).add((first, second))
    assert touched == parted == {tuple(pair) for pair in data["self_collision_links"]}


def test_arm_of_the_demonstrations_does_not_touch_itself(arm):
    data = json.loads(asset_path("jaco", "spheres.json").read_text())
    spheres = _spheres()
    with np.load(asset_path("demonstrations", "Placement.npz"), allow_pickle=False) as file:
        configurations = file["configurations"][:, ::20].reshape(-1, 6)
    for configuration in configurations:
        arm.set(configuration)
        for first, second in data["self_collision_links"]:
            assert arm.distance(first, second) > 0.02
            centers = []
            for link in (first, second):
                position, rotation = arm.pose(link)
                centers.append(spheres[link][:, :3] @ rotation.T + position)
            between = np.linalg.norm(centers[0][:, None] - centers[1], axis=-1)
            reach = spheres[first][:, 3][:, None] + spheres[second][:, 3]
            assert (between > reach).all()


def test_pads_are_parallel_on_the_object_they_grip(arm):
    pads = _solids()["j2s6s200_link_finger_tip_1"]
    turned = [solid for solid in pads if not np.allclose(solid.rotation, np.eye(3))]
    assert len(turned) == 1
    half = turned[0].mesh.extents / 2
    face = np.array([(-half[0], half[1], 0), (half[0], half[1], 0)])
    face = face @ turned[0].rotation.T + turned[0].position
    for angle in np.linspace(0.7, 1.2, 101):
        ends = []
        for side in ("1", "2"):
            joint = arm.joints[f"j2s6s200_joint_finger_{side}"]
            pybullet.resetJointState(arm.body, joint, angle, physicsClientId=arm.client)
            position, rotation = arm.pose(f"j2s6s200_link_finger_tip_{side}")
            ends.append(face @ rotation.T + position)
        apart = np.linalg.norm(ends[0] - ends[1], axis=1)
        if apart.min() < 0.05:
            break
    assert apart.max() < 0.052


def test_visuals_are_light_and_follow_the_shapes():
    links = ET.parse(jaco_urdf()).getroot().iter("link")
    solids = _solids()
    files = set()
    for link in links:
        for visual in link.iter("visual"):
            path = jaco_urdf().parent / visual.find("geometry/mesh").get("filename")
            files.add(path)
            mesh = trimesh.load_mesh(path, process=False)
            excess = np.min([s.excess(mesh.vertices) for s in solids[link.get("name")]], axis=0)
            assert excess.max() < 0.005
            merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
            merged.merge_vertices(merge_norm=True, digits_vertex=4)
            assert merged.is_watertight
            assert merged.volume > 0
    assert sum(path.stat().st_size for path in files) < 300_000


def test_materials_have_one_colour_each():
    root = ET.parse(jaco_urdf()).getroot()
    named = [material.get("name") for material in root.findall("material")]
    assert len(named) == len(set(named))
    assert {m.get("name") for m in root.iter("material")} == set(named)


def test_files_are_what_is_written_from_the_description(tmp_path):
    write(tmp_path)
    packaged = jaco_urdf().parent
    written = {path.relative_to(tmp_path) for path in tmp_path.rglob("*.*")}
    assert written == {path.relative_to(packaged) for path in packaged.rglob("*.*")}
    assert (tmp_path / "jaco.urdf").read_text() == jaco_urdf().read_text()
    for path in written - {Path("jaco.urdf")}:
        texts = [(folder / path).read_text() for folder in (tmp_path, packaged)]
        words = [text.replace("[", " ").replace("]", " ").split() for text in texts]
        assert len(words[0]) == len(words[1])
        for ours, theirs in zip(*words, strict=True):
            # Another machine may round the last digit differently.
            if ours != theirs:
                assert float(ours.strip(",")) == pytest.approx(float(theirs.strip(",")), abs=0.011)


def test_cell_without_content_is_an_error():
    link = next(link for link in description().links if link.name == "link_1")
    cell = Box((1.0, 1.0, 1.0), (2.0, 2.0, 2.0))
    empty = Link(link.name, link.joint, shapes=link.shapes, cells=(cell,))
    with pytest.raises(ValueError, match="link_1"):
        link_spheres(empty)
