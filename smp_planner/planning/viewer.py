"""A page in the browser that shows plans in three dimensions, to be turned and played.

    page = show(exhibit_of(plan), port=8080)

Shown are obstacles, points of clouds, demonstrations, the particles in the colours of their
homotopy classes, on a slider those on their way (`Plan.history`), and the robot by its links or as
the spheres that the planner checks, moved by another slider along one of several trajectories.
The page is served by viser (extra ``viewer``), to this machine alone unless another host is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, checked_array
from smp_gym.geometry.faces import body_faces
from smp_gym.optional_packages import require
from smp_gym.scene import TABLE, Obstacle
from smp_planner.planning.link_mesh import LinkMesh
from smp_planner.planning.particle_groups import (
    CHOSEN,
    DEMONSTRATED,
    EXECUTED,
    OBSTACLE,
    groups_on_the_way,
    particle_groups,
)
from smp_planner.planning.robot_body import RobotBody

if TYPE_CHECKING:
    from viser import ViserServer

    from smp_planner.collision.robot_model import RobotModel
    from smp_planner.planning.plan import Plan
    from smp_planner.planning.problem import Problem

__all__ = ["Exhibit", "Lines", "Motion", "Page", "exhibit_of", "motion_of", "show"]

_ROBOT, _GOAL, _CLOUD = "#7f8c9b", "#c9a227", "#7b2d8b"
_STEPS = 200
"""Most places of the slider."""

_SINGLE_POINT = 0.01
"""Size of a point that has no neighbour, m."""

_SETTLED = "After the last iteration."


@dataclass(frozen=True, eq=False)
class Lines:
    """Paths that are shown and hidden together.

    Attributes:
        paths: (T_j, 3) m each.
        color: "#rrggbb".
        width: of the lines, pixels.
        settled: whether they are particles after the last iteration, which are not shown while
            those on their way are.
    """

    paths: FloatArray | Sequence[FloatArray]
    color: str
    width: float = 1.5
    settled: bool = False


@dataclass(frozen=True, eq=False)
class Motion:
    """A trajectory of a robot's spheres and links.

    Attributes:
        centers: (T, S, 3) m.
        radii: (S,) m.
        poses: (T, L, 4, 4) of its links; None if only the spheres are known.
    """

    centers: FloatArray
    radii: FloatArray
    poses: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Exhibit:
    """The content of a page: bodies and paths in space, and trajectories of a robot.

    Attributes:
        title: Markdown, above the controls.
        lines: by label.
        obstacles: bodies.
        goals: bodies in another colour.
        clouds: points (N, 3) m each; those without points are left out.
        motions: by name; the first is shown when the page opens.
        meshes: of the links that `Motion.poses` are of, shown in place of the spheres.
        on_the_way: particles before an iteration, lines by label, by the number of iterations
            behind them; at equal distances from 0 on.
    """

    title: str
    lines: Mapping[str, Lines]
    obstacles: Sequence[Obstacle] = ()
    goals: Sequence[Obstacle] = ()
    clouds: Sequence[FloatArray] = ()
    motions: Mapping[str, Motion] = field(default_factory=dict)
    meshes: Sequence[LinkMesh] = ()
    on_the_way: Mapping[int, Mapping[str, Lines]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Page:
    """A page that is served.

    Attributes:
        server: of viser; to it more can be added.
        nodes: viser's handles of what is shown, by name: "obstacles/0", "goals/0", "clouds/0",
            "lines/LABEL", "robot/0" for the first sphere, "links/0" for the first mesh,
            "iterations/20/LABEL" for particles after 20 iterations, and so on.
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


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """What there is to show beside the particles of a plan.

    Attributes:
        model: of the robot; None for paths in space.
        obstacles: bodies.
        goals: bodies that the task brings, but for the table.
        clouds: points (N, 3) m each.
    """

    model: RobotModel | None
    obstacles: Sequence[Obstacle]
    goals: Sequence[Obstacle] = ()
    clouds: Sequence[FloatArray] = ()

    @classmethod
    def of(cls, plan: Plan) -> _Surroundings:
        """Return those of a plan."""
        problem: Problem | None = plan.display.get("problem")
        if problem is None:
            given = plan.display.get("obstacles", ())
            return cls(
                plan.display.get("model"),
                [body for body in given if isinstance(body, Obstacle)],
                clouds=[body.points for body in given if hasattr(body, "points")],
            )
        model = problem.body.model if isinstance(problem.body, RobotBody) else None
        solid = dict.fromkeys(body for stage in problem.stages for body in stage.obstacles)
        goals = [body for body in solid if body not in problem.movable and body != TABLE]
        maps = {id(stage.cloud): stage.cloud for stage in problem.stages if stage.cloud is not None}
        clouds = [known.seen for known in maps.values() if known.seen is not None]
        return cls(model, problem.movable, goals, clouds)


def motion_of(model: RobotModel, trajectory: FloatArray) -> Motion:
    """Return the motion of a robot along a trajectory (T, n) rad."""
    configurations = torch.as_tensor(np.array(trajectory, np.float64))
    return Motion(
        model.sphere_centers(configurations).numpy(),
        model.radius,
        model.link_transforms(configurations).numpy(),
    )


def exhibit_of(plan: Plan, executed: Any = None, point: FloatArray | None = None) -> Exhibit:
    """Return the content of a page for a plan of paths in space or of a robot.

    Obstacles that move are where they were seen first.

    Args:
        plan: of `smp_planner.SMP`, or of a planner or policy in an environment.
        executed: (T, D) trajectory that was executed; None for none.
        point: (3,) m, fixed in the end-effector frame of a robot, whose paths are shown; by default
            the frame's origin, the tool.

    Raises:
        ValueError: its paths are not in space, nor of a robot; or `executed` is not finite, or of
            another dimension.
    """
    beside = _Surroundings.of(plan)
    model, dimension = beside.model, plan.trajectories.shape[-1]
    if model is None and dimension != 3:
        raise ValueError(
            "only paths in space and of robots can be shown in three dimensions, got "
            f"D = {dimension}; plot draws paths in the plane"
        )

    def path(trajectories: FloatArray) -> FloatArray:
        if model is None:
            return np.asarray(trajectories)
        return model.carried_points(trajectories, np.zeros(3) if point is None else point)[0]

    demonstrated = plan.display.get("tool_demonstrations")
    if demonstrated is None:
        demonstrated = [path(each) for each in plan.display.get("demonstrations", ())]
    paths = path(plan.trajectories)
    lines = {f"demonstrations: {len(demonstrated)}": Lines(demonstrated, DEMONSTRATED)}
    for each in particle_groups(plan):
        lines[each.label] = Lines(paths[each.members], each.color, settled=True)
    lines["chosen particle"] = Lines(paths[[plan.chosen]], CHOSEN, 5.0, settled=True)
    trajectories = {"chosen particle": plan.best}
    if executed is not None:
        trajectories["executed"] = checked_array("executed", executed, (None, dimension))
        lines["executed"] = Lines([path(trajectories["executed"])], EXECUTED, 5.0)
    motions = {}
    if model is not None:
        motions = {name: motion_of(model, each) for name, each in trajectories.items()}
    good = int(plan.good.sum())
    return Exhibit(
        title=f"{good} of {len(paths)} particles are good, in {plan.modes.count} classes.",
        lines=lines,
        obstacles=beside.obstacles,
        goals=beside.goals,
        clouds=beside.clouds,
        motions=motions,
        meshes=plan.display["meshes"]() if "meshes" in plan.display else (),
        on_the_way={
            iteration: {
                each.label: Lines(path(earlier.trajectories[each.members]), each.color)
                for each in groups_on_the_way(plan, earlier)
            }
            for iteration, earlier in plan.history.items()
        },
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
    for number, points in enumerate(each for each in exhibit.clouds if len(each)):
        name = f"clouds/{number}"
        nodes[name] = scene.add_point_cloud(
            name,
            points.astype(np.float32),
            _rgb(_CLOUD),
            point_size=_point_size(points),
            precision="float32",
            point_shape="circle",
        )
        label = f"points: {len(points)}" if number == 0 else f"points: {len(points)} ({number + 1})"
        controls[label] = _shows(server, label, [nodes[name]], True)
    _look_at(server, [path for lines in exhibit.lines.values() for path in lines.paths])
    server.gui.add_markdown(exhibit.title)
    for label, lines in exhibit.lines.items():
        if len(lines.paths):
            # A slash in a name would make a node of its own.
            name = f"lines/{label.replace('/', '-')}"
            nodes[name], controls[label] = _add_lines(server, name, label, lines)
    if exhibit.on_the_way:
        _add_iterations(server, exhibit, nodes, controls)
    if exhibit.motions:
        _add_robot(server, exhibit, nodes, controls)
    return Page(server, nodes, controls)


def _point_size(points: FloatArray) -> float:
    """Return a size, in the unit of points (N, 3), with which these cover about half of a surface.

    It is half of what lies between neighbours, and from 0.2 % to 2 % of the cloud's extent.
    """
    extent = float(np.ptp(points, axis=0).max())
    if extent == 0.0:
        return _SINGLE_POINT
    gap = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
    return float(np.clip(0.5 * gap, 0.002 * extent, 0.02 * extent))


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
    node = _segments(server, name, lines)
    box = server.gui.add_checkbox(label, initial_value=True)

    @box.on_update
    def _(_: Any) -> None:
        node.visible = box.value

    return node, box


def _segments(server: ViserServer, name: str, lines: Lines) -> Any:
    pieces = [np.stack([path[:-1], path[1:]], axis=1) for path in lines.paths]
    return server.scene.add_line_segments(
        name,
        np.concatenate(pieces).astype(np.float32),
        colors=_rgb(lines.color),
        thickness=lines.width,
        thickness_units="screen",
    )


def _add_iterations(
    server: ViserServer, exhibit: Exhibit, nodes: dict[str, Any], controls: dict[str, Any]
) -> None:
    """Add particles on their way, and a slider that shows them in place of the settled ones."""
    stops: list[list[Any]] = []
    titles = {}
    for iteration, each in exhibit.on_the_way.items():
        shown = []
        for label, lines in each.items():
            name = f"iterations/{iteration}/{label.replace('/', '-')}"
            nodes[name] = _segments(server, name, lines)
            nodes[name].visible = False
            shown.append(nodes[name])
        stops.append(shown)
        titles[iteration] = f"After {iteration} iterations: {', '.join(each)}."
    settled = [
        (nodes[f"lines/{label.replace('/', '-')}"], controls[label])
        for label, lines in exhibit.lines.items()
        if lines.settled and label in controls
    ]
    numbers = list(exhibit.on_the_way)
    step = max(numbers[-1] - numbers[-2], 1) if len(numbers) > 1 else 1
    last = numbers[-1] + step
    slider = server.gui.add_slider("iterations", 0, last, step=step, initial_value=last)
    text = server.gui.add_markdown(_SETTLED)

    def move(_: Any) -> None:
        with server.atomic():
            for number, shown in zip(numbers, stops, strict=True):
                for node in shown:
                    node.visible = number == slider.value
            for node, box in settled:
                node.visible = box.value and slider.value == last
        text.content = titles.get(slider.value, _SETTLED)

    slider.on_update(move)
    for _, box in settled:
        box.on_update(move)
    controls.update({"iterations": slider, "of iterations": text})


def _add_robot(
    server: ViserServer, exhibit: Exhibit, nodes: dict[str, Any], controls: dict[str, Any]
) -> None:
    """Add spheres and links, and controls that move them along a trajectory."""
    motions = exhibit.motions
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
    meshes = exhibit.meshes if all(each.poses is not None for each in motions.values()) else ()
    links = [
        server.scene.add_mesh_simple(
            f"links/{number}",
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.uint32),
            color=_rgb(_ROBOT),
            flat_shading=True,
        )
        for number, mesh in enumerate(meshes)
    ]

    def move(_: Any) -> None:
        motion = motions[choice.value]
        now = round(slider.value * (len(motion.centers) - 1))
        with server.atomic():
            for sphere, center in zip(spheres, motion.centers[now], strict=True):
                sphere.position = tuple(center)
            for link, mesh in zip(links, meshes, strict=True):
                assert motion.poses is not None
                pose = motion.poses[now, mesh.link]
                link.position = tuple(pose[:3, 3])
                link.wxyz = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)

    slider.on_update(move)
    choice.on_update(move)
    controls.update({"trajectory": choice, "phase": slider})
    nodes.update({f"robot/{number}": sphere for number, sphere in enumerate(spheres)})
    nodes.update({f"links/{number}": link for number, link in enumerate(links)})
    if links:
        move(None)
        controls["links"] = _shows(server, "links", links, True)
        controls["spheres"] = _shows(server, "spheres", spheres, False)


def _shows(server: ViserServer, label: str, nodes: Sequence[Any], at_first: bool) -> Any:
    """Add a box that shows and hides nodes; return its handle."""
    box = server.gui.add_checkbox(label, initial_value=at_first)

    def apply(_: Any) -> None:
        with server.atomic():
            for node in nodes:
                node.visible = box.value

    apply(None)
    box.on_update(apply)
    return box


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
