"""Write `envs_assets/jaco`: the URDF, the visual meshes and the link spheres of the JACO j2s6s200.

Everything is made from tables: here the vendor's kinematic constants and inertias, and a few boxes
and cylinders per link that cover the vendor's meshes; in `jaco_visuals` the cross-sections for the
pictures. Given the folder of the vendor's meshes (`robots/kinova_description/meshes` of
example-robot-data) it also prints how tightly they are covered.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated
from xml.etree import ElementTree as ET

import numpy as np
import typer
from jaco_shapes import AXES, Box, Cylinder, Shape, Vector, clipped, enclosing_ball
from jaco_visuals import BODIES, obj
from rich.console import Console
from rich.table import Table

from smp_gym.robot.kinematics import PEN_END, PEN_RADIUS, PEN_TIP

DEFAULT_OUT = Path(__file__).parents[1] / "envs_assets" / "jaco"

PREFIX = "j2s6s200_"
_AXIS_RPY = {"x": (0.0, np.pi / 2, 0.0), "y": (-np.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}


# The table of links


@dataclass(frozen=True)
class Joint:
    """How a link hangs on its parent; the axis of a moving joint is its z.

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


def _slabs(axis: str, *cuts: float) -> tuple[Box, ...]:
    """Return the cells between cuts along one axis, unbounded in the others."""
    along = AXES.index(axis)
    cells = []
    for start, end in pairwise(cuts):
        lower, upper = [-1.0] * 3, [1.0] * 3
        lower[along], upper[along] = start, end
        cells.append(Box((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])))
    return tuple(cells)


def _halves(axis: str, cut: float, cells: tuple[Box, ...]) -> tuple[Box, ...]:
    """Return cells cut in two across an axis."""
    along = AXES.index(axis)
    halves = []
    for cell in cells:
        lower, upper = list(cell.lower), list(cell.upper)
        lower[along] = upper[along] = cut
        halves.append(Box(cell.lower, (upper[0], upper[1], upper[2])))
        halves.append(Box((lower[0], lower[1], lower[2]), cell.upper))
    return tuple(halves)


_TURN = 6.28318530718
_FAST, _SLOW = 0.837758040957, 0.628318530718
_PI, _HALF_PI = 3.14159265359, 1.57079632679


def _arm_joint(
    index: int,
    parent: str,
    xyz: Vector,
    rpy: Vector,
    limits: tuple[float, float] | None,
    effort: float,
) -> Joint:
    lower, upper = limits or (-_TURN, _TURN)
    return Joint(
        f"joint_{index}",
        "revolute" if limits else "continuous",
        parent,
        xyz,
        rpy,
        lower,
        upper,
        effort,
        _SLOW if index <= 3 else _FAST,
    )


_PAD_TURN = -0.05
"""rad; the pads of both fingertips are then parallel on a box of 5 cm, as wide as the tasks'."""


def _finger(side: int) -> tuple[Link, Link]:
    """Return the proximal link and the tip of finger 1 or 2.

    The masses are not the vendor's (0.01 kg, 8e-7 kg m^2): with those, PyBullet's solver builds up
    the force of the finger motors too slowly to hold anything by friction.
    """
    sign = 1.0 if side == 1 else -1.0
    inertia = (1e-3, 1e-3, 1e-3)
    proximal = Link(
        f"link_finger_{side}",
        Joint(
            f"joint_finger_{side}",
            "revolute",
            "link_6",
            (-0.0025, sign * 0.03095, -0.11482),
            (-_HALF_PI, 0.649262481663582, sign * _HALF_PI),
            0.0,
            1.51,
            2.0,
            1.0,
        ),
        0.03,
        (0.022, 0.0, 0.0),
        inertia,
        (
            Cylinder("z", (0.0, 0.0), 0.0069, -0.0116, 0.0116),
            Box((-0.0076, -0.0109, -0.0116), (0.0, 0.0037, 0.0116)),
            Box((-0.0032, -0.0216, -0.0118), (0.0386, 0.0027, 0.0118)),
            Box((0.0386, -0.0195, -0.0116), (0.0509, 0.0027, 0.0116)),
        ),
        _slabs("x", -0.008, 0.022, 0.051),
        (("finger", "finger"),),
        ("finger_proximal",),
    )
    tip = Link(
        f"link_finger_tip_{side}",
        Joint(
            f"joint_finger_tip_{side}",
            "revolute",
            f"link_finger_{side}",
            (0.044, -0.003, 0.0),
            (0.0, 0.0, 0.0),
            0.0,
            2.0,
            2.0,
            1.0,
        ),
        0.03,
        (0.022, 0.0, 0.0),
        inertia,
        (
            # One box and no more: each further shape that touches the object slows the solver.
            Box((-0.0101, -0.0154, -0.0115), (0.0442, 0.0069, 0.0115), _PAD_TURN),
        ),
        _slabs("x", -0.01, 0.014, 0.045),
        (("fingertip", "finger"),),
        ("finger_distal",),
    )
    return proximal, tip


LINKS: tuple[Link, ...] = (
    Link(
        "link_base",
        Joint(
            "jaco_mounting_block_to_j2s6s200_link_base",
            "fixed",
            "base",
            (0.0, 0.0, 0.0),
            (0.0, 0.0, _HALF_PI),
        ),
        0.46784,
        (0.0, 0.0, 0.1255),
        (0.000951270861568, 0.000951270861568, 0.000374272),
        (
            Cylinder("z", (0.0, 0.0), 0.0415, 0.0, 0.157),
            Box((-0.0386, 0.0164, 0.064), (0.0386, 0.0357, 0.1253)),
        ),
        _slabs("z", 0.0, 0.056, 0.102, 0.157),
        (("base", "carbon"),),
        ("base",),
    ),
    Link(
        "link_1",
        _arm_joint(1, "link_base", (0.0, 0.0, 0.15675), (0.0, _PI, 0.0), None, 40.0),
        0.7477,
        (0.0, -0.002, -0.0605),
        (0.00152031725204, 0.00152031725204, 0.00059816),
        (
            Cylinder("z", (0.0, 0.0), 0.0449, -0.0118, 0.0118),
            Cylinder("z", (0.0, 0.0), 0.0415, -0.051, 0.0),
            Box((-0.041, -0.0359, -0.1113), (0.041, 0.0059, -0.0488)),
            Box((-0.0282, -0.0405, -0.11), (0.0282, 0.0156, -0.05)),
            Cylinder("y", (0.0, -0.11875), 0.0415, -0.0416, 0.0019),
        ),
        _slabs("z", -0.161, -0.102, -0.07, -0.038, 0.012),
        (("shoulder", "carbon"), ("ring_big", "ring")),
        ("shoulder", "ring_big"),
    ),
    Link(
        "link_2",
        _arm_joint(
            2,
            "link_1",
            (0.0, 0.0016, -0.11875),
            (-_HALF_PI, 0.0, _PI),
            (0.820304748437, 5.46288055874),
            80.0,
        ),
        0.99,
        (0.0, -0.2065, -0.01),
        (0.010502207991, 0.000792, 0.010502207991),
        (
            Cylinder("z", (0.0, 0.0), 0.0449, -0.0118, 0.0118),
            Cylinder("z", (0.0, 0.0), 0.0415, -0.0433, 0.0),
            Box((-0.0413, -0.1, -0.0391), (0.0413, -0.0065, -0.0151)),
            Box((-0.0286, -0.1, -0.0433), (0.0286, -0.025, -0.0092)),
            Box((-0.0369, -0.31, -0.0366), (0.0369, -0.1, -0.0089)),
            Box((-0.0263, -0.31, -0.0414), (0.0263, -0.1, -0.0022)),
            Box((-0.0413, -0.4035, -0.0391), (0.0413, -0.31, -0.0151)),
            Box((-0.0286, -0.385, -0.0433), (0.0286, -0.31, -0.0092)),
            Cylinder("z", (0.0, -0.41), 0.0415, -0.0433, 0.0003),
        ),
        _slabs("y", -0.452, -0.386, -0.334, -0.286, -0.232, -0.176, -0.117, -0.065, -0.022, 0.045),
        (("arm", "carbon"), ("ring_big", "ring")),
        ("arm", "ring_big"),
    ),
    Link(
        "link_3",
        _arm_joint(
            3,
            "link_2",
            (0.0, -0.41, 0.0),
            (0.0, _PI, 0.0),
            (0.331612557879, 5.9515727493),
            40.0,
        ),
        0.6763,
        (0.0, 0.081, -0.0086),
        (0.00142022431908, 0.000304335, 0.00142022431908),
        (
            Cylinder("z", (0.0, 0.0), 0.0449, -0.0118, 0.0118),
            Cylinder("z", (0.0, 0.0), 0.0415, -0.0433, 0.0),
            Box((-0.0415, 0.0048, -0.037), (0.0415, 0.09, -0.0192)),
            Box((-0.0308, 0.02, -0.0403), (0.0308, 0.09, -0.0092)),
            Box((-0.0308, 0.09, -0.0314), (0.0308, 0.153, 0.0017)),
            Box((-0.0217, 0.09, -0.0389), (0.0217, 0.153, 0.0107)),
            Cylinder("y", (0.0, -0.0114), 0.0318, 0.1525, 0.2075),
        ),
        _slabs("y", -0.045, 0.02, 0.055, 0.097, 0.132, 0.162, 0.208),
        (("forearm", "carbon"), ("ring_big", "ring")),
        ("forearm", "ring_big"),
    ),
    Link(
        "link_4",
        _arm_joint(4, "link_3", (0.0, 0.2073, -0.0114), (-_HALF_PI, 0.0, _PI), None, 20.0),
        0.463,
        (0.0, 0.0028848942, -0.0541932613),
        (0.0004321316048, 0.0004321316048, 9.26e-05),
        (
            Cylinder("z", (0.0, 0.0), 0.0343, -0.01, 0.01),
            Cylinder("z", (0.0, 0.0), 0.0328, -0.041, 0.0),
            Box((-0.0302, -0.0122, -0.1), (0.0302, 0.0402, -0.04)),
            Box((-0.0223, -0.0219, -0.1), (0.0223, 0.0434, -0.04)),
            Cylinder("y", (0.0, -0.10375), 0.0318, -0.0002, 0.0478),
        ),
        _slabs("z", -0.136, -0.093, -0.065, -0.034, 0.011),
        (("wrist_1", "carbon"), ("ring_small", "ring")),
        ("wrist_spherical_1", "ring_small"),
    ),
    Link(
        "link_5",
        _arm_joint(
            5,
            "link_4",
            (0.0, 0.0, -0.10375),
            (_HALF_PI, 0.0, _PI),
            (0.523598775598, 5.75958653158),
            20.0,
        ),
        0.463,
        (0.0, 0.0497208855, -0.0028562765),
        (0.0004321316048, 9.26e-05, 0.0004321316048),
        (
            Cylinder("z", (0.0, 0.0), 0.0343, -0.01, 0.01),
            Cylinder("z", (0.0, 0.0), 0.0318, -0.0477, 0.0),
            Box((-0.0302, 0.0, -0.0399), (0.0302, 0.063, 0.0116)),
            Box((-0.0227, 0.0, -0.0432), (0.0227, 0.063, 0.022)),
            Cylinder("y", (0.0, 0.0), 0.0328, 0.0627, 0.1039),
        ),
        _slabs("y", -0.035, 0.011, 0.038, 0.066, 0.105),
        (("wrist_2", "carbon"), ("ring_small", "ring")),
        ("wrist_spherical_2", "ring_small"),
    ),
    Link(
        "link_6",
        _arm_joint(6, "link_5", (0.0, 0.10375, 0.0), (-_HALF_PI, 0.0, _PI), None, 20.0),
        0.99,
        (0.0, 0.0, -0.06),
        (0.0003453236187, 0.0003453236187, 0.0005816),
        (
            Cylinder("z", (0.0, 0.0), 0.0347, -0.0298, 0.01),
            Box((-0.0256, -0.0422, -0.0448), (0.0216, 0.0422, -0.0296)),
            Box((-0.0256, -0.0493, -0.06), (0.0216, 0.0493, -0.0448)),
            Box((-0.03, -0.0259, -0.06), (0.0293, 0.0259, -0.0296)),
            Box((-0.0268, -0.0546, -0.0958), (0.0212, 0.0546, -0.06)),
            Box((-0.0268, -0.0478, -0.1034), (0.0212, 0.0478, -0.0958)),
            Box((-0.0295, -0.0217, -0.1205), (0.0223, 0.0217, -0.06)),
            Box((-0.0254, -0.0375, -0.1205), (0.0208, 0.0375, -0.1)),
        ),
        (
            *_slabs("z", -0.03, 0.01),
            *_halves("y", 0.0, _slabs("z", -0.121, -0.09, -0.06, -0.03)),
        ),
        (("hand", "carbon"), ("ring_small", "ring")),
        ("hand_2finger", "ring_small"),
    ),
    Link(
        "end_effector",
        Joint(
            "joint_end_effector",
            "fixed",
            "link_6",
            (0.0, 0.0, -0.16),
            (_PI, _HALF_PI, 0.0),
        ),
    ),
    *_finger(1),
    *_finger(2),
)
"""All links in the order of the URDF. Joints, masses and inertias are the vendor's, except for
the fingers."""


SELF_COLLISION_LINKS: tuple[tuple[str, str], ...] = (
    ("link_base", "link_4"),
    ("link_base", "link_5"),
    ("link_base", "link_6"),
    ("link_1", "link_4"),
    ("link_1", "link_5"),
    ("link_1", "link_6"),
    ("link_2", "link_5"),
    ("link_2", "link_6"),
    ("link_3", "link_5"),
    ("link_3", "link_6"),
    ("link_4", "link_6"),
)
"""Pairs of links that may not touch, the palm standing for the hand. All others are neighbours, or
out of each other's reach within the joint limits."""


PEN = Link(
    "pen",
    Joint("joint_pen", "fixed", "link_6", (0.0, 0.0, -0.16), (_PI, _HALF_PI, 0.0)),
    mass=0.02,
    center_of_mass=((PEN_TIP[0] + PEN_END) / 2, 0.0, 0.0),
    inertia=(1e-5, 5e-5, 5e-5),
    shapes=(Cylinder("x", (0.0, 0.0), PEN_RADIUS, PEN_END, PEN_TIP[0]),),
    color="pen",
)
"""The rod that the hand draws with, in the end-effector frame."""


MATERIALS = {
    "pen": (0.85, 0.18, 0.16, 1.0),
    "carbon": (0.2, 0.2, 0.22, 1.0),
    "ring": (0.78, 0.79, 0.81, 1.0),
    "finger": (0.55, 0.57, 0.62, 1.0),
}
"""Colours, red, green, blue and opacity, by material name."""


def full_name(name: str) -> str:
    """Return the vendor's name of a link or joint."""
    return name if name in ("base", "pen") or name.startswith("jaco_") else PREFIX + name


# Spheres


def link_spheres(link: Link) -> list[list[float]]:
    """Return the spheres [x, y, z, radius] that contain the shapes of a link."""
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
        for link in LINKS
        if link.cells
    ]
    pairs = [json.dumps([full_name(name) for name in pair]) for pair in SELF_COLLISION_LINKS]
    return (
        '{\n  "format": "smp_gym.spheres",\n  "version": 1,\n  "links": {\n'
        + ",\n".join(lines)
        + '\n  },\n  "self_collision_links": [\n    '
        + ",\n    ".join(pairs)
        + "\n  ]\n}\n"
    )


# URDF


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
    links = (*LINKS, PEN) if pen else LINKS
    used = {material for link in links for _, material in link.visuals} | {
        link.color for link in links
    }
    for name in (name for name in MATERIALS if name in used):
        rgba = MATERIALS[name]
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
    (directory / "jaco.urdf").write_text(urdf(), encoding="utf-8")
    (directory / "jaco_pen.urdf").write_text(urdf(pen=True), encoding="utf-8")
    (directory / "spheres.json").write_text(spheres_json(), encoding="utf-8")
    for name, body in BODIES.items():
        (visuals / f"{name}.obj").write_text(obj(body), encoding="utf-8")


def coverage_table(meshes: Path) -> Table:
    """Return how each link's shapes and spheres cover the vendor's meshes.

    Args:
        meshes: folder of the vendor's meshes.
    """
    from jaco_coverage import measure, mesh_points

    table = Table(title="Coverage of the vendor's meshes: mean / greatest distance, mm")
    for column in ("link", "surface outside", "shapes", "overshoot", "spheres", "overshoot "):
        table.add_column(column, justify="left" if column == "link" else "right", no_wrap=True)
    for link in LINKS:
        if not link.shapes:
            continue
        spheres = np.array(link_spheres(link))
        found = measure(mesh_points(meshes, link.meshes), link.shapes, spheres)
        mean, greatest = (1e3 * value for value in found.shape_overshoot)
        sphere_mean, sphere_greatest = (1e3 * value for value in found.sphere_overshoot)
        table.add_row(
            link.name,
            f"{found.outside:.2%}, {1e3 * found.gap:.2f} mm",
            str(len(link.shapes)),
            f"{mean:.1f} / {greatest:.1f}",
            str(len(spheres)),
            f"{sphere_mean:.1f} / {sphere_greatest:.1f}",
        )
    return table


def main(
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = DEFAULT_OUT,
    meshes: Annotated[
        Path | None, typer.Option(help="The vendor's meshes (.dae), to measure coverage against.")
    ] = None,
) -> None:
    """Write URDF, visuals and spheres of the arm, and measure them if meshes are given."""
    console = Console()
    write(out)
    console.print(f"wrote {out}")
    if meshes is not None:
        console.print(coverage_table(meshes))


if __name__ == "__main__":
    typer.run(main)
