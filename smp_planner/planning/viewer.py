"""A page in the browser that shows plans in three dimensions, to be turned and played.

    page = show(exhibit_of(plan), port=8080)

Shown are obstacles, demonstrations, the particles in the colours of their homotopy classes, and the
robot as the spheres that the planner checks, moved by a slider along one of several trajectories.
The page is served by viser (extra ``viewer``), to this machine alone unless another host is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_gym.geometry.faces import body_faces
from smp_gym.optional_packages import require
from smp_gym.scene import Obstacle
from smp_planner.planning.particle_groups import (
    CHOSEN,
    DEMONSTRATED,
    OBSTACLE,
    particle_groups,
)

if TYPE_CHECKING:
    from viser import ViserServer

    from smp_planner.planning.plan import Plan

__all__ = ["Exhibit", "Lines", "Motion", "Page", "exhibit_of", "lines_of", "show"]

_ROBOT, _GOAL = "#7f8c9b", "#c9a227"
_STEPS = 200
"""Most places of the slider."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Paths that are shown and hidden together.

    Attributes:
        paths: (T_j, 3) m each.
        color: "#rrggbb".
        width: of the lines, pixels.
    """

    paths: FloatArray | Sequence[FloatArray]
    color: str
    width: float = 1.5


@dataclass(frozen=True, eq=False)
class Motion:
    """A trajectory of a robot's spheres.

    Attributes:
        centers: (T, S, 3) m.
        radii: (S,) m.
    """

    centers: FloatArray
    radii: FloatArray


@dataclass(frozen=True, eq=False)
class Exhibit:
    """The content of a page: bodies and paths in space, and trajectories of a robot.

    Attributes:
        title: Markdown, above the controls.
        lines: by label.
        obstacles: bodies.
        goals: bodies in another colour.
        clouds: points (N, 3) m each.
        motions: by name; the first is shown when the page opens.
    """

    title: str
    lines: Mapping[str, Lines]
    obstacles: Sequence[Obstacle] = ()
    goals: Sequence[Obstacle] = ()
    clouds: Sequence[FloatArray] = ()
    motions: Mapping[str, Motion] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Page:
    """A page that is served.

    Attributes:
        server: of viser; to it more can be added.
        nodes: viser's handles of what is shown, by name: "obstacles/0", "goals/0", "clouds/0",
            "lines/LABEL", "robot/0" for the first sphere, and so on.
        controls: its handles of the controls, by label.
    """

    server: ViserServer
    nodes: Mapping[str, Any]
    controls: Mapping[str, Any]

    @property
    def address(self) -> str:
        """Address for the browser."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def close(self) -> None:
        """Serve it no longer."""
        self.server.stop()


def lines_of(
    plan: Plan, paths: FloatArray, demonstrations: FloatArray | Sequence[FloatArray]
) -> dict[str, Lines]:
    """Return lines of demonstrations, of particles by homotopy class, and of the chosen one.

    Args:
        plan: whose particles they are.
        paths: (P, T, 3) m, the path of each that is shown.
        demonstrations: (T_j, 3) m each.
    """
    lines = {f"demonstrations: {len(demonstrations)}": Lines(demonstrations, DEMONSTRATED)}
    for group in particle_groups(plan):
        lines[group.label] = Lines(paths[group.members], group.color)
    lines["chosen particle"] = Lines(paths[[plan.chosen]], CHOSEN, 5.0)
    return lines


def exhibit_of(plan: Plan) -> Exhibit:
    """Return the content of a page for a plan of the user's own paths in space or robot.

    Args:
        plan: of `smp_planner.SMP`.

    Raises:
        ValueError: its paths are not in space, nor of a robot.
    """
    paths, demonstrated = plan.tool_paths, "tool_demonstrations"
    if paths is None:
        paths, demonstrated = plan.trajectories, "demonstrations"
    if paths.shape[-1] != 3:
        raise ValueError(
            "only paths in space and of robots can be shown in three dimensions, got "
            f"D = {paths.shape[-1]}; plot draws paths in the plane"
        )
    obstacles = plan.display.get("obstacles", ())
    motions = {}
    if (model := plan.display.get("model")) is not None:
        centers = model.sphere_centers(torch.as_tensor(plan.best)).numpy()
        motions["chosen particle"] = Motion(centers, model.radius)
    good = int(plan.good.sum())
    return Exhibit(
        title=f"{good} of {len(paths)} particles are good, in {plan.modes.count} classes.",
        lines=lines_of(plan, paths, plan.display.get(demonstrated, ())),
        obstacles=[body for body in obstacles if isinstance(body, Obstacle)],
        clouds=[body.points for body in obstacles if not isinstance(body, Obstacle)],
        motions=motions,
    )


def show(exhibit: Exhibit, *, host: str = "127.0.0.1", port: int = 8080) -> Page:
    """Serve a page until it is closed, or the process ends.

    Args:
        exhibit: its content.
        host: address that is listened on; "0.0.0.0" lets other machines see the page.
        port: if it is taken, the next free one is; the page's `address` says which.

    Raises:
        ModuleNotFoundError: viser is not installed.
    """
    require("viewer", "watching a plan", "viser")
    import viser

    server = viser.ViserServer(host=host, port=port, verbose=False)
    nodes: dict[str, Any] = {}
    controls: dict[str, Any] = {}
    scene = server.scene
    scene.set_up_direction("+z")
    scene.add_grid("table", width=2.0, height=2.0, cell_size=0.1)
    for kind, bodies, color in (
        ("obstacles", exhibit.obstacles, OBSTACLE),
        ("goals", exhibit.goals, _GOAL),
    ):
        for number, body in enumerate(bodies):
            name = f"{kind}/{number}"
            vertices, faces = _triangles(body_faces(body))
            nodes[name] = scene.add_mesh_simple(
                name, vertices, faces, color=_rgb(color), opacity=0.6, side="double"
            )
    for number, points in enumerate(exhibit.clouds):
        name = f"clouds/{number}"
        nodes[name] = scene.add_point_cloud(name, points, _rgb(OBSTACLE), point_size=0.005)
    _look_at(server, [path for lines in exhibit.lines.values() for path in lines.paths])
    server.gui.add_markdown(exhibit.title)
    for label, lines in exhibit.lines.items():
        if len(lines.paths):
            # A slash in a name would make a node of its own.
            name = f"lines/{label.replace('/', '-')}"
            nodes[name], controls[label] = _add_lines(server, name, label, lines)
    if exhibit.motions:
        _add_robot(server, exhibit.motions, nodes, controls)
    return Page(server, nodes, controls)


def _look_at(server: ViserServer, paths: Sequence[FloatArray]) -> None:
    """Let pages open with a view of paths from the front, above."""
    points = np.concatenate([np.reshape(path, (-1, 3)) for path in paths] or [np.zeros((1, 3))])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    extent = max(float(np.ptp(points, axis=0).max()), 0.5)

    @server.on_client_connect
    def _(client: Any) -> None:
        # To set the position takes the point that is looked at along.
        client.camera.position = tuple(middle + extent * np.array([1.2, 0.7, 0.7]))
        client.camera.up_direction = (0.0, 0.0, 1.0)
        client.camera.look_at = tuple(middle)


def _add_lines(server: ViserServer, name: str, label: str, lines: Lines) -> tuple[Any, Any]:
    """Add lines, and a box that shows and hides them; return the handles of both."""
    pieces = [np.stack([path[:-1], path[1:]], axis=1) for path in lines.paths]
    node = server.scene.add_line_segments(
        name,
        np.concatenate(pieces).astype(np.float32),
        colors=_rgb(lines.color),
        thickness=lines.width,
        thickness_units="screen",
    )
    box = server.gui.add_checkbox(label, initial_value=True)

    @box.on_update
    def _(_: Any) -> None:
        node.visible = box.value

    return node, box


def _add_robot(
    server: ViserServer,
    motions: Mapping[str, Motion],
    nodes: dict[str, Any],
    controls: dict[str, Any],
) -> None:
    """Add spheres, and controls that move them along a trajectory."""
    names = list(motions)
    choice = server.gui.add_dropdown("trajectory", names, initial_value=names[0])
    slider = server.gui.add_slider("phase", 0.0, 1.0, step=1.0 / _STEPS, initial_value=0.0)
    first = motions[names[0]]
    spheres = [
        server.scene.add_icosphere(
            f"robot/{number}", float(radius), color=_rgb(_ROBOT), position=tuple(center)
        )
        for number, (radius, center) in enumerate(zip(first.radii, first.centers[0], strict=True))
    ]

    def move(_: Any) -> None:
        centers = motions[choice.value].centers
        now = centers[round(slider.value * (len(centers) - 1))]
        with server.atomic():
            for sphere, center in zip(spheres, now, strict=True):
                sphere.position = tuple(center)

    slider.on_update(move)
    choice.on_update(move)
    nodes.update({f"robot/{number}": sphere for number, sphere in enumerate(spheres)})
    controls.update({"trajectory": choice, "phase": slider})


def _rgb(color: str) -> tuple[int, int, int]:
    """Return "#rrggbb" as numbers from 0 to 255."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue


def _triangles(faces: Sequence[FloatArray]) -> tuple[FloatArray, Any]:
    """Return vertices (V, 3) and triangles (F, 3) of convex polygons."""
    vertices, triangles, count = [], [], 0
    for face in faces:
        fan = np.arange(1, len(face) - 1)
        triangles.append(count + np.stack([np.zeros_like(fan), fan, fan + 1], axis=1))
        vertices.append(face)
        count += len(face)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(triangles).astype(np.uint32)
