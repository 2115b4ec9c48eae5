"""The elements of a URDF, checked: an error names joint or link, attribute and value.

Metres and radians.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, shown
from smp_gym.untrusted_files import read_file

__all__ = ["CONTINUOUS_LIMIT", "Description", "Joint", "Link", "Shape", "read_description"]

CONTINUOUS_LIMIT = 4.0 * math.pi
"""rad in either direction, limits of a continuous joint for which the URDF names none."""

_LARGEST_FILE = 64 * 2**20
"""Bytes."""

_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF, as far as geometry and limits go.

    Attributes:
        name: of the joint.
        kind: one of those that URDF knows.
        parent: name of a link.
        child: name of a link.
        origin: (4, 4) pose of the joint in its parent.
        axis: (3,) unit vector in the frame of the joint.
        lower: rad or m; NaN where none is named.
        upper: likewise.
        velocity: rad/s or m/s; NaN where none is named.
        follows: of a mimic joint the joint that it follows, multiplier and offset.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: FloatArray
    axis: FloatArray
    lower: float
    upper: float
    velocity: float
    follows: tuple[str, float, float] | None

    @property
    def is_fixed(self) -> bool:
        """Whether it does not move."""
        return self.kind == "fixed"

    @property
    def nearest_to_zero(self) -> float:
        """The position within the limits that is nearest to 0, rad or m."""
        if math.isnan(self.lower) or math.isnan(self.upper):
            return 0.0
        return min(max(0.0, self.lower), self.upper)

    def held_at(self, position: float) -> FloatArray:
        """Return the pose (4, 4) of the child in the parent at a position, rad or m."""
        pose = np.eye(4)
        if self.kind in ("revolute", "continuous"):
            pose[:3, :3] = Rotation.from_rotvec(position * self.axis).as_matrix()
        elif self.kind == "prismatic":
            pose[:3, 3] = position * self.axis
        return np.asarray(self.origin @ pose)


@dataclass(frozen=True)
class Shape:
    """A collision or visual shape of a link.

    Attributes:
        kind: "box", "cylinder", "capsule", "sphere" or "mesh".
        origin: (4, 4) pose in the link.
        size: m: lengths of a box, length and radius of a cylinder or a capsule, whose length is
            that of its axis between the centres of its round ends; radius of a sphere; the scale of
            a mesh.
        mesh: file of a mesh.
    """

    kind: str
    origin: FloatArray
    size: FloatArray
    mesh: Path | None = None


@dataclass(frozen=True)
class Link:
    """A link of a URDF.

    Attributes:
        name: of the link.
        shapes: collision shapes.
        visible: whether it has a visual shape.
        visuals: visual shapes; none where one of them cannot be read or is not there, for planning
            needs none.
    """

    name: str
    shapes: tuple[Shape, ...]
    visible: bool
    visuals: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Description:
    """What a URDF holds.

    Attributes:
        file: where it was read.
        links: by name.
        joints: in their order.
    """

    file: Path
    links: Mapping[str, Link]
    joints: tuple[Joint, ...]


def read_description(path: str | Path, packages: Mapping[str, str | Path] | None) -> Description:
    """Return what a URDF holds.

    Args:
        path: of the file.
        packages: see `Robot.from_urdf`.

    Raises:
        FileNotFoundError: no such file, or a mesh is missing.
        ValueError: not a URDF, or an element of it is wrong.
    """
    file = Path(path)
    root = robot_element(file)
    elements, named = root.findall("link"), root.findall("joint")
    for tag, found in (("link", elements), ("joint", named)):
        names = Counter(element.get("name", "") for element in found)
        for name, count in names.items():
            if not name or count > 1:
                how = "has no name" if not name else f"{name!r} stands there {count} times"
                raise ValueError(f"{file} must name each {tag} once, but a {tag} {how}")
    joints = tuple(_joint(element) for element in named)
    _check_tree(file, [element.get("name", "") for element in elements], joints)
    folders = _Folders(file, packages)
    links = [_link(element, folders) for element in elements]
    return Description(file, {link.name: link for link in links}, joints)


def robot_element(file: Path, kind: str = "a URDF") -> ET.Element:
    """Return the element ``robot`` that a file holds.

    Args:
        file: to be read.
        kind: of the file, "a URDF" or "an SRDF".

    Raises:
        FileNotFoundError: no such file.
        ValueError: not of this kind, or one that xacro has not expanded.
    """
    content = read_file(file, _LARGEST_FILE)
    if b"<!ENTITY" in content:
        raise ValueError(f"{file} is not {kind} that can be read: it declares entities")
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise ValueError(f"{file} is not {kind}: {error}") from error
    if root.tag != "robot":
        raise ValueError(f"{file} is not {kind}: its root is <{root.tag}>, not <robot>")
    left = next((e.tag for e in root.iter() if "xacro" in str(e.tag).rpartition("}")[0]), None)
    if left is not None:
        name = left.rpartition("}")[2]
        raise ValueError(f"{file} holds <xacro:{name}>: expand it with xacro first")
    return root


def _check_tree(file: Path, links: Sequence[str], joints: Sequence[Joint]) -> None:
    above: dict[str, Joint] = {}
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ValueError(f"joint {joint.name!r} names the link {end!r}, which is not there")
        if joint.child in above:
            raise ValueError(
                f"link {joint.child!r} must have one joint above it, got "
                f"{above[joint.child].name!r} and {joint.name!r}"
            )
        above[joint.child] = joint
        if joint.follows is not None and joint.follows[0] not in {j.name for j in joints}:
            raise ValueError(
                f"joint {joint.name!r} mimics {joint.follows[0]!r}, which is not there"
            )
    roots = [name for name in links if name not in above]
    if len(roots) != 1:
        raise ValueError(f"{file} must have one root link, got {roots}")
    for link in links:
        passed = {link}
        while link in above:
            link = above[link].parent
            if link in passed:
                raise ValueError(f"{file} has links that are not joined to its root: {link}")
            passed.add(link)


def _numbers(
    element: ET.Element | None, attribute: str, default: str | None, count: int, where: str
) -> FloatArray:
    """Return the numbers (count,) of an attribute; infinite ones pass."""
    text = default if element is None else element.get(attribute, default)
    if text is None:
        raise ValueError(f"{where} must have the attribute {attribute!r}")
    if "${" in text or "$(" in text:
        raise ValueError(f"{where} has {attribute}={text!r}: expand the file with xacro first")
    words = text.split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.array([])
    if len(numbers) != count or np.isnan(numbers).any():
        raise ValueError(
            f"{where} must have {count} number{'s' * (count > 1)} as {attribute}, got {text!r}"
        )
    return numbers


def _finite(
    element: ET.Element | None, attribute: str, default: str | None, count: int, where: str
) -> FloatArray:
    numbers = _numbers(element, attribute, default, count, where)
    if not np.isfinite(numbers).all():
        raise ValueError(f"{where} must have a finite {attribute}, got {numbers.tolist()}")
    return numbers


def _positive(element: ET.Element, attribute: str, count: int, where: str) -> FloatArray:
    numbers = _finite(element, attribute, None, count, where)
    if not (numbers > 0.0).all():
        given = element.get(attribute)
        raise ValueError(f"{where} must have a positive {attribute}, got {given!r}")
    return numbers


def _pose(element: ET.Element, where: str) -> FloatArray:
    origin = element.find("origin")
    pose = np.eye(4)
    turn = _finite(origin, "rpy", "0 0 0", 3, f"{where}, origin,")
    pose[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
    pose[:3, 3] = _finite(origin, "xyz", "0 0 0", 3, f"{where}, origin,")
    return pose


def _joint(element: ET.Element) -> Joint:
    name = element.get("name", "")
    where = f"joint {name!r}"
    kind = element.get("type", "")
    if kind not in _KINDS:
        raise ValueError(f"{where} must be of a type of {', '.join(_KINDS)}; got {kind!r}")

    def link(tag: str) -> str:
        found = element.find(tag)
        return "" if found is None else found.get("link", "")

    axis, limit = element.find("axis"), element.find("limit")
    direction = _finite(axis, "xyz", "1 0 0", 3, f"{where}, axis,")
    length = float(np.linalg.norm(direction))
    if kind != "fixed" and not length > 0.0:
        raise ValueError(f"{where} must have an axis that is not zero, got {direction.tolist()}")
    limits = [math.nan] * 3
    if limit is not None and kind != "fixed":
        # Exporters write zeros where nothing is known.
        limits = [
            float(_numbers(limit, attribute, "0", 1, f"{where}, limit,")[0])
            for attribute in ("lower", "upper", "velocity")
        ]
    lower, upper, velocity = limits
    if kind == "continuous" and not (math.isfinite(upper - lower) and lower < upper):
        lower, upper = -CONTINUOUS_LIMIT, CONTINUOUS_LIMIT
    mimic, follows = element.find("mimic"), None
    if mimic is not None:
        factors = [
            float(_finite(mimic, attribute, default, 1, f"{where}, mimic,")[0])
            for attribute, default in (("multiplier", "1"), ("offset", "0"))
        ]
        follows = (mimic.get("joint", ""), factors[0], factors[1])
    return Joint(
        name=name,
        kind=kind,
        parent=link("parent"),
        child=link("child"),
        origin=_pose(element, where),
        axis=direction / (length or 1.0),
        lower=lower,
        upper=upper,
        velocity=velocity,
        follows=follows,
    )


def _link(element: ET.Element, folders: _Folders) -> Link:
    name = element.get("name", "")
    shapes = tuple(
        _shape(collision, f"a collision of link {name!r}", folders)
        for collision in element.findall("collision")
    )
    visible = element.find("visual/geometry/*") is not None
    return Link(name, shapes, visible, _visuals(element, name, folders))


def _visuals(element: ET.Element, name: str, folders: _Folders) -> tuple[Shape, ...]:
    try:
        return tuple(
            _shape(visual, f"a visual of link {name!r}", folders)
            for visual in element.findall("visual")
        )
    except (OSError, ValueError):
        return ()


def _shape(collision: ET.Element, where: str, folders: _Folders) -> Shape:
    geometry = collision.find("geometry")
    if geometry is None or not len(geometry):
        raise ValueError(f"{where} has no geometry")
    shape, origin = geometry[0], _pose(collision, where)
    where = f"{where}, {shape.tag},"
    if shape.tag == "mesh":
        scale = _finite(shape, "scale", "1 1 1", 3, where)
        if (scale == 0.0).any():
            raise ValueError(f"{where} must have a scale that is not zero, got {scale.tolist()}")
        return Shape("mesh", origin, scale, folders.mesh(shape.get("filename", ""), where))
    sizes = {
        "box": (("size", 3),),
        "cylinder": (("length", 1), ("radius", 1)),
        "capsule": (("length", 1), ("radius", 1)),
        "sphere": (("radius", 1),),
    }
    if shape.tag not in sizes:
        raise ValueError(
            f"{where} must be box, cylinder, capsule, sphere or mesh, got <{shape.tag}>"
        )
    given = [_positive(shape, attribute, count, where) for attribute, count in sizes[shape.tag]]
    return Shape(shape.tag, origin, np.concatenate(given))


class _Folders:
    """The folders that the meshes of a URDF may lie in.

    Args:
        file: of the URDF.
        packages: folders by the name of a package.
    """

    def __init__(self, file: Path, packages: Mapping[str, str | Path] | None) -> None:
        self._file = file.resolve()
        if packages is not None and not isinstance(packages, Mapping):
            raise ValueError(f"packages must map names to folders, got {shown(packages)}")
        self._packages = {name: Path(folder) for name, folder in (packages or {}).items()}
        for name, folder in self._packages.items():
            if not folder.is_dir():
                raise FileNotFoundError(f"packages names {str(folder)!r} for {name!r}: no folder")
        own = next(
            (up for up in self._file.parents if (up / "package.xml").is_file()), self._file.parent
        )
        self._own = (self._file.parent, own, *self._packages.values())

    def mesh(self, name: str, where: str) -> Path:
        """Return where a mesh is, by its name in the URDF."""
        where = f"{where} names the mesh {name!r}, which"
        if "${" in name or "$(" in name:
            raise ValueError(f"{where} is no name yet: expand the file with xacro first")
        scheme, separator, within = name.partition("://")
        if not separator:
            scheme, within = "", name
        if scheme not in ("", "file", "package") or not within.strip("/"):
            raise ValueError(f"{where} is no name of a file or of package://NAME/FILE")
        if scheme == "package":
            package, _, within = within.partition("/")
            if package in ("", ".", "..") or not within:
                raise ValueError(f"{where} must name a package and a file in it")
            bases = allowed = self._of_package(package)
        else:
            bases, allowed = (self._file.parent,), self._own
        candidates = [base / text for base in bases for text in (within, unquote(within))]
        found = next((path.resolve() for path in candidates if path.is_file()), None)
        if found is None:
            raise FileNotFoundError(
                f"{where} is not found: meshes lie in the URDF's folder, or in a package above or "
                "beside it; other folders must be given as packages={NAME: FOLDER}"
            )
        if not any(found.is_relative_to(folder.resolve()) for folder in allowed):
            raise ValueError(
                f"{where} lies outside of the folders that may be read, "
                f"{', '.join(sorted({str(folder) for folder in allowed}))}: give its own as "
                "packages={NAME: FOLDER}"
            )
        return found

    def _of_package(self, name: str) -> tuple[Path, ...]:
        """Return the folder of a package: given, one above the URDF, or beside such."""
        if name in self._packages:
            return (self._packages[name],)
        above = [folder for folder in self._file.parents if folder.name == name]
        beside = [
            folder / name
            for folder in self._file.parents
            if (folder / name / "package.xml").is_file()
        ]
        return (*above, *beside)
