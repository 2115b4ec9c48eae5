"""The arm as its files have it: links and joints, covering spheres, and the URDF.

Links come from `envs_assets/jaco_description/links.json`. Joints, masses and inertias are those of
the vendor's model (Kinova's `kinova_description`), except for the fingers: with the vendor's
0.01 kg and 8e-7 kg m^2, PyBullet's solver builds up the force of the finger motors too slowly to
hold anything by friction. A fingertip is one box and no more, for each further shape that touches
the object slows the solver; it is turned by -0.05 rad, so that the pads are parallel on a box of
5 cm, as wide as the tasks'. The boxes and cylinders of a link contain the vendor's meshes.
`self_collision_links` are the pairs of links that may not touch, the palm standing for the hand;
all others are neighbours, or out of each other's reach within the joint limits.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from pydantic import TypeAdapter

from smp_gym.assets import asset_path
from smp_gym.atomic_files import write_text
from smp_gym.jaco_assets.solids import Box, Cylinder, Shape, Vector, clipped, enclosing_ball
from smp_gym.jaco_assets.visuals import obj, visual_bodies
from smp_gym.robot.kinematics import PEN_END, PEN_RADIUS, PEN_TIP

__all__ = [
    "PEN",
    "PREFIX",
    "Description",
    "Joint",
    "Link",
    "description",
    "full_name",
    "link_spheres",
    "spheres_json",
    "urdf",
    "write",
]

PREFIX = "j2s6s200_"
"""Prefix of the vendor's names of links and joints."""

_AXIS_RPY = {"x": (0.0, np.pi / 2, 0.0), "y": (-np.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}


@dataclass(frozen=True)
class Joint:
    """The joint between a link and its parent; the axis of a moving joint is its z.

    Attributes:
        name: without the prefix.
        kind: "fixed", "continuous" or "revolute".
        parent: name of the parent link, without the prefix.
        xyz: origin in the parent's frame, m.
        rpy: fixed-axis angles in the parent's frame, rad.
        lower: least angle, rad.
        upper: greatest angle, rad.
        effort: N m.
        velocity: rad/s.
    """

    name: str
    kind: str
    parent: str
    xyz: Vector
    rpy: Vector
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0
    velocity: float = 0.0


@dataclass(frozen=True)
class Link:
    """One link: its joint, its mass, and the shapes that stand for its body.

    Attributes:
        name: without the prefix.
        joint: what it hangs on.
        mass: kg.
        center_of_mass: m.
        inertia: ixx, iyy, izz about the centre of mass, kg m^2.
        shapes: what may touch; together they contain the vendor's mesh.
        cells: boxes that together contain the shapes; what is in one gets one sphere.
        visuals: names of the visual bodies and of their materials.
        meshes: names of the vendor's meshes.
        color: material of the shapes themselves, where they are what is seen.
    """

    name: str
    joint: Joint
    mass: float = 0.0
    center_of_mass: Vector = (0.0, 0.0, 0.0)
    inertia: Vector = (0.0, 0.0, 0.0)
    shapes: tuple[Shape, ...] = ()
    cells: tuple[Box, ...] = ()
    visuals: tuple[tuple[str, str], ...] = ()
    meshes: tuple[str, ...] = ()
    color: str = ""


@dataclass(frozen=True)
class Description:
    """The packaged description of the arm.

    Attributes:
        links: in the order of the URDF, the base excepted.
        self_collision_links: pairs of names that may not touch.
        materials: colours, red, green, blue and opacity, by name.
    """

    links: tuple[Link, ...]
    self_collision_links: tuple[tuple[str, str], ...]
    materials: dict[str, tuple[float, float, float, float]]


@cache
def description() -> Description:
    """Return the packaged description, read once.

    Raises:
        ValidationError: of pydantic; the file's entries are not those of these classes.
    """
    text = asset_path("jaco_description", "links.json").read_text()
    return TypeAdapter(Description).validate_json(text)


PEN = Link(
    "pen",
    Joint("joint_pen", "fixed", "link_6", (0.0, 0.0, -0.16), (3.14159265359, 1.57079632679, 0.0)),
    mass=0.02,
    center_of_mass=((PEN_TIP[0] + PEN_END) / 2, 0.0, 0.0),
    inertia=(1e-5, 5e-5, 5e-5),
    shapes=(Cylinder("x", (0.0, 0.0), PEN_RADIUS, PEN_END, PEN_TIP[0]),),
    color="pen",
)
"""The rod that the hand draws with, in the end-effector frame."""


def full_name(name: str) -> str:
    """Return the vendor's name of a link or joint."""
    return name if name in ("base", "pen") or name.startswith("jaco_") else PREFIX + name


def link_spheres(link: Link) -> list[list[float]]:
    """Return the spheres [x, y, z, radius] m that contain the shapes of a link, one for each cell.

    Raises:
        ValueError: a cell holds nothing of the link.
    """
    spheres = []
    for cell in link.cells:
        parts = [clipped(shape.hull(), cell) for shape in link.shapes]
        points = np.concatenate(parts)
        if not len(points):
            raise ValueError(f"cell {cell} of {link.name} holds nothing")
        center, radius = enclosing_ball(points)
        spheres.append([*center.tolist(), radius])
    return spheres


def spheres_json() -> str:
    """Return the text of `spheres.json`."""
    lines = [
        f"    {json.dumps(full_name(link.name))}: [\n      "
        + ",\n      ".join(json.dumps(sphere) for sphere in link_spheres(link))
        + "\n    ]"
        for link in description().links
        if link.cells
    ]
    listed = description().self_collision_links
    pairs = [json.dumps([full_name(name) for name in pair]) for pair in listed]
    return (
        '{\n  "format": "smp_gym.spheres",\n  "version": 1,\n  "links": {\n'
        + ",\n".join(lines)
        + '\n  },\n  "self_collision_links": [\n    '
        + ",\n    ".join(pairs)
        + "\n  ]\n}\n"
    )


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in values)


def _add_shape(parent: ET.Element, shape: Shape) -> None:
    if isinstance(shape, Box):
        rpy = (0.0, 0.0, shape.turn)
        size = np.array(shape.upper) - shape.lower
        element = ET.Element("box", size=_numbers(size.tolist()))
    else:
        rpy = _AXIS_RPY[shape.axis]
        element = ET.Element(
            "cylinder", radius=f"{shape.radius:.12g}", length=f"{shape.end - shape.start:.12g}"
        )
    ET.SubElement(parent, "origin", xyz=_numbers(shape.center.tolist()), rpy=_numbers(rpy))
    ET.SubElement(parent, "geometry").append(element)


def _add_inertial(parent: ET.Element, link: Link) -> None:
    inertial = ET.SubElement(parent, "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(link.center_of_mass), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{link.mass:.12g}")
    ixx, iyy, izz = (f"{value:.12g}" for value in link.inertia)
    ET.SubElement(inertial, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)


def urdf(*, pen: bool = False) -> str:
    """Return the text of `jaco.urdf`, or with a pen of `jaco_pen.urdf`."""
    robot = ET.Element("robot", name="j2s6s200")
    links = (*description().links, PEN) if pen else description().links
    used = {material for link in links for _, material in link.visuals} | {
        link.color for link in links
    }
    for name, rgba in description().materials.items():
        if name not in used:
            continue
        colored = ET.SubElement(robot, "material", name=name)
        ET.SubElement(colored, "color", rgba=_numbers(rgba))
    base = ET.SubElement(robot, "link", name="base")
    _add_inertial(base, Link("base", Joint("", "fixed", "", (0, 0, 0), (0, 0, 0))))
    for link in links:
        element = ET.SubElement(robot, "link", name=full_name(link.name))
        _add_inertial(element, link)
        for body, material in link.visuals:
            visual = ET.SubElement(element, "visual")
            geometry = ET.SubElement(visual, "geometry")
            ET.SubElement(geometry, "mesh", filename=f"visuals/{body}.obj")
            ET.SubElement(visual, "material", name=material)
        for shape in link.shapes:
            _add_shape(ET.SubElement(element, "collision"), shape)
            if link.color:
                visual = ET.SubElement(element, "visual")
                _add_shape(visual, shape)
                ET.SubElement(visual, "material", name=link.color)
        joint = link.joint
        element = ET.SubElement(robot, "joint", name=full_name(joint.name), type=joint.kind)
        ET.SubElement(element, "parent", link=full_name(joint.parent))
        ET.SubElement(element, "child", link=full_name(link.name))
        ET.SubElement(element, "origin", xyz=_numbers(joint.xyz), rpy=_numbers(joint.rpy))
        if joint.kind != "fixed":
            ET.SubElement(element, "axis", xyz="0 0 1")
            ET.SubElement(
                element,
                "limit",
                lower=f"{joint.lower:.12g}",
                upper=f"{joint.upper:.12g}",
                effort=f"{joint.effort:.12g}",
                velocity=f"{joint.velocity:.12g}",
            )
    ET.indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(robot, "unicode") + "\n"


def write(directory: Path) -> None:
    """Write all files into a directory."""
    visuals = directory / "visuals"
    visuals.mkdir(parents=True, exist_ok=True)
    write_text(directory / "jaco.urdf", urdf())
    write_text(directory / "jaco_pen.urdf", urdf(pen=True))
    write_text(directory / "spheres.json", spheres_json())
    for name, body in visual_bodies().items():
        write_text(visuals / f"{name}.obj", obj(body))
