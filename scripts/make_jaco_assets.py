"""Write `envs_assets/jaco`: the URDF, the visual meshes and the link spheres of the JACO j2s6s200.

Everything is made from the tables in this file: the vendor's kinematic constants and inertias, and
a few boxes and cylinders per link that cover the vendor's meshes. Run again it writes the same
bytes. With the `meshes` extra installed it also prints how tightly the shapes cover.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]

PREFIX = "j2s6s200_"
_AXES = "xyz"
_AXIS_RPY = {"x": (0.0, np.pi / 2, 0.0), "y": (-np.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}
_CORNERS = 64
"""Corners of the prism that stands for a cylinder where spheres are fitted; it contains it."""
_SPHERE_DIGITS = 4
"""Spheres are rounded to 0.1 mm, radii upwards."""


# Shapes


@dataclass(frozen=True)
class Box:
    """A box in the frame of its link.

    Attributes:
        lower: corner, m, in the turned frame.
        upper: the opposite corner.
        turn: angle by which the frame of the corners is turned about the link's z, rad.
    """

    lower: Vector
    upper: Vector
    turn: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) from the turned frame to the link's."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def hull(self) -> FloatArray:
        """Return the (8, 3) corners."""
        sides = np.array([self.lower, self.upper])
        picks = np.indices((2, 2, 2)).reshape(3, -1)
        corners = np.stack([sides[picks[axis], axis] for axis in range(3)], axis=1)
        return corners @ self.rotation.T


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along an axis of the frame of its link, m.

    Attributes:
        axis: "x", "y" or "z".
        center: where its axis crosses the plane through the origin: the coordinate along `axis`
            is left out.
        radius: m.
        start: lower end along the axis, m.
        end: upper end.
    """

    axis: str
    center: tuple[float, float]
    radius: float
    start: float
    end: float

    def hull(self) -> FloatArray:
        """Return (2 * 64, 3) corners of a prism around the cylinder."""
        angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
        radius = self.radius / np.cos(np.pi / _CORNERS)
        along = _AXES.index(self.axis)
        across = [axis for axis in range(3) if axis != along]
        points = np.empty((2, _CORNERS, 3))
        points[..., across[0]] = self.center[0] + radius * np.cos(angle)
        points[..., across[1]] = self.center[1] + radius * np.sin(angle)
        points[..., along] = np.array([self.start, self.end])[:, None]
        return points.reshape(-1, 3)


Shape = Box | Cylinder


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
        meshes: names of the vendor's meshes.
    """

    name: str
    joint: Joint
    mass: float = 0.0
    center_of_mass: Vector = (0.0, 0.0, 0.0)
    inertia: Vector = (0.0, 0.0, 0.0)
    shapes: tuple[Shape, ...] = ()
    cells: tuple[Box, ...] = ()
    meshes: tuple[str, ...] = ()


def _slabs(axis: str, *cuts: float) -> tuple[Box, ...]:
    """Return the cells between cuts along one axis, unbounded in the others."""
    along = _AXES.index(axis)
    cells = []
    for start, end in pairwise(cuts):
        lower, upper = [-1.0] * 3, [1.0] * 3
        lower[along], upper[along] = start, end
        cells.append(Box((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])))
    return tuple(cells)


def _halves(axis: str, cut: float, cells: tuple[Box, ...]) -> tuple[Box, ...]:
    """Return cells cut in two across an axis."""
    along = _AXES.index(axis)
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


_PAD_TURN = -0.3
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
            Box((-0.0098, -0.0149, -0.0115), (0.0099, 0.0058, 0.0115)),
            Box((0.0076, -0.0091, -0.0115), (0.0434, 0.0099, 0.0115), _PAD_TURN),
        ),
        _slabs("x", -0.01, 0.014, 0.045),
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
            Box((-0.0256, -0.0491, -0.06), (0.0216, 0.0491, -0.0296)),
            Box((-0.03, -0.0259, -0.06), (0.0293, 0.0259, -0.0296)),
            Box((-0.0268, -0.0546, -0.1), (0.0212, 0.0546, -0.06)),
            Box((-0.0295, -0.0217, -0.1205), (0.0223, 0.0217, -0.06)),
            Box((-0.0254, -0.0538, -0.1205), (0.0208, 0.0538, -0.1)),
        ),
        (
            *_slabs("z", -0.03, 0.01),
            *_halves("y", 0.0, _slabs("z", -0.121, -0.09, -0.06, -0.03)),
        ),
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
    ("link_base", "link_3"),
    ("link_base", "link_4"),
    ("link_base", "link_5"),
    ("link_base", "link_6"),
    ("link_1", "link_3"),
    ("link_1", "link_4"),
    ("link_1", "link_5"),
    ("link_1", "link_6"),
    ("link_2", "link_4"),
    ("link_2", "link_5"),
    ("link_2", "link_6"),
    ("link_3", "link_6"),
)
"""Pairs of links that may not touch, palm for hand; the rest are neighbours or out of reach."""


def full_name(name: str) -> str:
    """Return the vendor's name of a link or joint."""
    return name if name == "base" or name.startswith("jaco_") else PREFIX + name


# Spheres


def _clipped(points: FloatArray, cell: Box) -> FloatArray:
    """Return corners of the part of a convex body that lies in a cell, (N, 3); N may be 0."""
    for axis in range(3):
        for bound, sign in ((cell.lower[axis], 1.0), (cell.upper[axis], -1.0)):
            height = sign * (points[:, axis] - bound)
            above, below = points[height >= 0], points[height < 0]
            if not len(below):
                continue
            if not len(above):
                return np.empty((0, 3))
            rise = height[height >= 0][:, None, None]
            fall = -height[height < 0][None, :, None]
            crossings = (above[:, None] * fall + below[None] * rise) / (rise + fall)
            points = np.concatenate([above, crossings.reshape(-1, 3)])
            hull = ConvexHull(points, qhull_options="QJ Pp")
            points = points[np.sort(hull.vertices)]
    return points


def enclosing_ball(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of a ball around points, (N, 3), that is minimal to 0.1 mm.

    Badoiu & Clarkson 2003: step towards the farthest point, ever more shortly. The result is
    rounded so that it still contains all points.
    """
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    for step in range(1, 3000):
        farthest = points[np.argmax(np.linalg.norm(points - center, axis=1))]
        center = center + (farthest - center) / (step + 1)
    center = np.round(center, _SPHERE_DIGITS) + 0.0
    radius = float(np.linalg.norm(points - center, axis=1).max())
    scale = 10.0**_SPHERE_DIGITS
    return center, float(np.ceil(radius * scale) / scale)


def link_spheres(link: Link) -> list[list[float]]:
    """Return the spheres [x, y, z, radius] that contain the shapes of a link."""
    spheres = []
    for cell in link.cells:
        parts = [_clipped(shape.hull(), cell) for shape in link.shapes]
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


def _numbers(values: Vector) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in values)


def _add_shape(parent: ET.Element, shape: Shape) -> None:
    if isinstance(shape, Box):
        lower, upper = np.array(shape.lower), np.array(shape.upper)
        center, rpy = shape.rotation @ (lower + upper) / 2, (0.0, 0.0, shape.turn)
        element = ET.Element("box", size=_numbers(tuple((upper - lower).tolist())))
    else:
        center = np.insert(shape.center, _AXES.index(shape.axis), (shape.start + shape.end) / 2)
        rpy = _AXIS_RPY[shape.axis]
        element = ET.Element(
            "cylinder", radius=f"{shape.radius:.12g}", length=f"{shape.end - shape.start:.12g}"
        )
    ET.SubElement(parent, "origin", xyz=_numbers(tuple(center.tolist())), rpy=_numbers(rpy))
    ET.SubElement(parent, "geometry").append(element)


def _add_inertial(parent: ET.Element, link: Link) -> None:
    inertial = ET.SubElement(parent, "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(link.center_of_mass), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{link.mass:.12g}")
    ixx, iyy, izz = (f"{value:.12g}" for value in link.inertia)
    ET.SubElement(inertial, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)


def urdf() -> str:
    """Return the text of `jaco.urdf`."""
    robot = ET.Element("robot", name="j2s6s200")
    base = ET.SubElement(robot, "link", name="base")
    _add_inertial(base, Link("base", Joint("", "fixed", "", (0, 0, 0), (0, 0, 0))))
    for link in LINKS:
        element = ET.SubElement(robot, "link", name=full_name(link.name))
        _add_inertial(element, link)
        for kind in ("visual", "collision"):
            for shape in link.shapes:
                _add_shape(ET.SubElement(element, kind), shape)
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
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "jaco.urdf").write_text(urdf(), encoding="utf-8")
    (directory / "spheres.json").write_text(spheres_json(), encoding="utf-8")


if __name__ == "__main__":
    write(Path(__file__).resolve().parent.parent / "envs_assets" / "jaco")
