"""One physics world: named bodies, contacts, clearances, snapshots and cameras.

Everything that speaks to PyBullet does so through a `BulletWorld` or the arm that lives in it.
Bodies and links are called by name; a contact is a pair of names.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_gym.geometry.registry import REGISTRY
from smp_gym.geometry.shape import SolidArguments
from smp_gym.physics.capacity import Places
from smp_gym.physics.display import check_display
from smp_gym.physics.hangers import hangers
from smp_gym.physics.lines import Line, draw_lines
from smp_gym.scene import MAX_OBSTACLES, Obstacle

__all__ = ["PHYSICS_PERIOD", "BulletWorld", "Camera", "Contact"]

PHYSICS_PERIOD = 1.0 / 120.0
"""Seconds per physics step."""

GRAVITY = 9.81
"""m/s^2, downwards."""

Contact = tuple[str, str]
"""Names of two touching parts (a link of the arm, or a body), in alphabetical order."""
Color = tuple[float, float, float, float]

OBSTACLE_COLORS: tuple[Color, ...] = (
    (0.84, 0.37, 0.30, 1.0),
    (0.95, 0.62, 0.29, 1.0),
    (0.35, 0.60, 0.76, 1.0),
    (0.55, 0.45, 0.70, 1.0),
    (0.40, 0.66, 0.50, 1.0),
    (0.85, 0.53, 0.62, 1.0),
)
"""Obstacles take these in turn, so that neighbours can be told apart."""

_ORIGIN = (0.0, 0.0, 0.0)
_IDENTITY = (0.0, 0.0, 0.0, 1.0)
_WINDOW_LINE_WIDTH = 3.0
"""Pixels."""

_RAYS_IN_A_BATCH = 8192
"""Half of what the engine takes at once."""

_FARTHEST = 100.0
"""Metres of a camera from its target."""

_PLACES = Places()
"""Of the worlds that are open in this process, by PyBullet's numbers."""

_PARKING_HEIGHT = -20.0
_SPECK = Obstacle(shape="sphere", position=_ORIGIN, size=(0.01, 0.01, 0.01))
_SKY_COLOR = (
    "--background_color_red=0.93 --background_color_green=0.95 --background_color_blue=0.97"
)


@dataclass(frozen=True)
class Camera:
    """The viewpoint of a picture.

    Attributes:
        target: point in the middle of the picture, m.
        distance: from the target, m.
        yaw: degrees about the vertical; 0 looks along +y, 90 along -x.
        pitch: degrees above the horizontal, negative looking down.
        field_of_view: vertical opening, degrees.
    """

    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance: float = 1.5
    yaw: float = 0.0
    pitch: float = -30.0
    field_of_view: float = 45.0

    def __post_init__(self) -> None:
        target = tuple(checked_array("camera.target", self.target, (3,)).tolist())
        object.__setattr__(self, "target", target)
        for name, bounds in (
            ("distance", {"above": 0.0, "most": _FARTHEST}),
            ("yaw", {}),
            ("pitch", {"least": -90.0, "most": 90.0}),
            ("field_of_view", {"least": 1.0, "most": 170.0}),
        ):
            value = checked_number(f"camera.{name}", getattr(self, name), **bounds)
            object.__setattr__(self, name, value)


def _solid(part: Obstacle) -> SolidArguments:
    return REGISTRY[part.shape].solid(part.size)


def _geometry(solid: SolidArguments) -> int:
    return int(getattr(pybullet, f"GEOM_{solid.geometry}"))


def _disconnect(client: int) -> None:
    _PLACES.give_back(client)
    if pybullet.isConnected(client):
        pybullet.disconnect(client)


def _connect(gui: bool) -> int:
    if not gui:
        return int(pybullet.connect(pybullet.DIRECT))
    # PyBullet ends the whole process when it finds no X server, so ask before it does.
    check_display()
    client = int(pybullet.connect(pybullet.GUI, options=_SKY_COLOR))
    if client < 0:
        raise RuntimeError("PyBullet could not open its window; it allows one window per process")
    pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=client)
    return client


class BulletWorld:
    """A physics world of its own, independent of any other in the process.

    What happens in it is a function of the calls made since `clear`: bit for bit the same in
    another process, and after `restore` whatever happened in between. Bodies of varying shape are
    therefore confined to a pool of obstacles whose size never changes (`set_obstacles`).

    Args:
        gui: open PyBullet's window instead of computing without one.
        seen: whether pictures show single shapes, as obstacles are. The engine works out hulls
            for the looks of a cylinder or sphere, which takes longer than all else of its body.

    Raises:
        RuntimeError: a window was asked for and there is no display for it, or as many worlds are
            open as PyBullet allows.
        MemoryError: there is too little memory left.
    """

    def __init__(self, *, gui: bool = False, seen: bool = True) -> None:
        _PLACES.check()
        self.client = _connect(gui)
        _PLACES.take(self.client)
        self.gui = gui
        self._seen = seen
        self._finalizer = weakref.finalize(self, _disconnect, self.client)
        self.clear()

    def clear(self) -> None:
        """Remove all bodies and forget all snapshots."""
        pybullet.resetSimulation(physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=PHYSICS_PERIOD,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )
        self.set_gravity(True)
        self._bodies: dict[str, int] = {}
        self._parts: dict[tuple[int, int], str] = {}
        self._touching: set[tuple[int, int, int, int]] = set()
        self._contacts: frozenset[Contact] = frozenset()
        self._obstacles: list[str] = []
        self._shown: dict[int, int] = {}
        # A body without looks of its own would be given those of its collision shape.
        self._unseen = int(
            pybullet.createVisualShape(
                pybullet.GEOM_BOX, halfExtents=_SPECK.size, physicsClientId=self.client
            )
        )

    def set_gravity(self, on: bool) -> None:
        """Switch gravity on or off."""
        pybullet.setGravity(0.0, 0.0, -GRAVITY if on else 0.0, physicsClientId=self.client)

    def set_solver_iterations(self, count: int) -> None:
        """Set how often the solver goes through joints and contacts in a step, until `clear`."""
        pybullet.setPhysicsEngineParameter(numSolverIterations=count, physicsClientId=self.client)

    def close(self) -> None:
        """End the world; closing again does nothing."""
        self._finalizer()

    @property
    def closed(self) -> bool:
        """True once `close` was called."""
        return not self._finalizer.alive

    # Bodies

    def add_body(
        self,
        name: str,
        parts: Sequence[Obstacle],
        *,
        color: Color,
        position: Sequence[float] = _ORIGIN,
        quaternion: Sequence[float] = _IDENTITY,
        mass: float = 0.0,
        seen_only: Sequence[Obstacle] = (),
    ) -> None:
        """Add a rigid body made of primitive shapes.

        Args:
            name: what contacts and `pose` call it.
            parts: shapes with their poses in the body's frame.
            color: red, green, blue, opacity, each 0 to 1.
            position: of the body's frame, m.
            quaternion: of the body's frame, (x, y, z, w).
            mass: kg; 0 makes it immovable.
            seen_only: further shapes in the body's frame, in pictures only.
        """
        collision, visual = self._shapes(parts, seen_only, color)
        body = pybullet.createMultiBody(
            baseMass=mass,
            baseCollisionShapeIndex=collision,
            baseVisualShapeIndex=visual,
            basePosition=position,
            baseOrientation=quaternion,
            physicsClientId=self.client,
        )
        # Nothing here moves fast enough for air to matter.
        pybullet.changeDynamics(
            body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=self.client
        )
        self._name(name, int(body))

    def load_urdf(self, name: str, path: Path, flags: int = 0) -> int:
        """Load a robot fixed to the world; its links go by the names that the file gives them.

        Returns:
            PyBullet's number of the body.
        """
        body = int(
            pybullet.loadURDF(
                str(path), useFixedBase=True, flags=flags, physicsClientId=self.client
            )
        )
        self._name(name, body)
        base, _ = pybullet.getBodyInfo(body, physicsClientId=self.client)
        self._parts[body, -1] = base.decode()
        for joint in range(pybullet.getNumJoints(body, physicsClientId=self.client)):
            info = pybullet.getJointInfo(body, joint, physicsClientId=self.client)
            self._parts[body, joint] = info[12].decode()
        return body

    def reserve_obstacles(self) -> None:
        """Make the pool of `MAX_OBSTACLES` obstacles, all parked far off; call it last.

        Removing a body moves the engine's last body into the gap, and a snapshot knows bodies by
        their order only: what is exchanged must stand behind all that stays.
        """
        for slot in range(MAX_OBSTACLES):
            self._park(slot, _SPECK)

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Replace all obstacles by bodies of these shapes, parked far off until they are placed.

        They are called ``obstacle_0``, ``obstacle_1``, …, as `obstacles` says.
        """
        # Bodies are always renewed in the order of their slots: the solver works in the order of
        # creation, so an obstacle kept from an earlier episode would carry that episode's order on.
        renewed = range(max(len(obstacles), len(self._obstacles)))
        for slot in renewed:
            self._remove(f"obstacle_{slot}")
        rods = hangers(obstacles) if self._seen else [[] for _ in obstacles]
        for slot in renewed:
            if slot < len(obstacles):
                self._park(slot, obstacles[slot], rods[slot])
            else:
                self._park(slot, _SPECK)
        self._obstacles = [f"obstacle_{slot}" for slot in range(len(obstacles))]

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of the obstacles in the world."""
        return tuple(self._obstacles)

    def body(self, name: str) -> int:
        """Return PyBullet's number of a body."""
        return self._bodies[name]

    def part(self, body: int, link: int) -> str:
        """Return the name of a body's link, -1 being its base, by PyBullet's numbers."""
        return self._parts[body, link]

    def place(
        self,
        name: str,
        position: Sequence[float],
        quaternion: Sequence[float] = _IDENTITY,
    ) -> None:
        """Put a body somewhere, at rest; nothing may touch it where it is."""
        pybullet.resetBasePositionAndOrientation(
            self._bodies[name], position, quaternion, physicsClientId=self.client
        )

    def pose(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) m and quaternion (4,) of a body."""
        position, quaternion = pybullet.getBasePositionAndOrientation(
            self._bodies[name], physicsClientId=self.client
        )
        return np.array(position), np.array(quaternion)

    def velocity(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return linear (3,) m/s and angular (3,) rad/s velocity of a body."""
        linear, angular = pybullet.getBaseVelocity(self._bodies[name], physicsClientId=self.client)
        return np.array(linear), np.array(angular)

    # Time

    def step(self) -> None:
        """Advance by `PHYSICS_PERIOD`."""
        pybullet.stepSimulation(physicsClientId=self.client)

    def detect_contacts(self) -> None:
        """Bring `contacts` up to date without advancing time."""
        pybullet.performCollisionDetection(physicsClientId=self.client)

    def contacts(self) -> frozenset[Contact]:
        """Return the pairs of parts that touch: that press on each other or overlap."""
        touching = {
            point[1:5]
            for point in pybullet.getContactPoints(physicsClientId=self.client)
            # The engine also reports points that are merely near (distance > 0, no force).
            if point[9] > 0.0 or point[8] < 0.0
        }
        if touching != self._touching:
            self._touching = touching
            self._contacts = frozenset(self._pair(*key) for key in touching)
        return self._contacts

    def contact_point(self, contact: Contact) -> FloatArray | None:
        """Return where two parts touch, (3,) m, the middle of their points of contact.

        None where they do not touch.
        """
        points = [
            (*point[5], *point[6])
            for point in pybullet.getContactPoints(physicsClientId=self.client)
            if (point[9] > 0.0 or point[8] < 0.0) and self._pair(*point[1:5]) == contact
        ]
        if not points:
            return None
        middle: FloatArray = np.array(points).reshape(-1, 3).mean(axis=0)
        return middle

    def clearance(self, names: Iterable[str], others: Iterable[str], limit: float) -> float:
        """Return the least distance between two groups of bodies, m.

        Args:
            names: bodies of the first group.
            others: bodies of the second group.
            limit: distances are not looked for beyond this, m.

        Returns:
            The distance, negative where bodies overlap, at most `limit`.
        """
        others = tuple(others)
        least = limit
        for name in names:
            for other in others:
                points = pybullet.getClosestPoints(
                    self._bodies[name], self._bodies[other], least, physicsClientId=self.client
                )
                least = min((point[8] for point in points), default=least)
        return float(min(least, limit))

    def cast_rays(
        self, origin: Sequence[float], ends: FloatArray
    ) -> tuple[tuple[str, ...], FloatArray]:
        """Return what rays from one point meet first.

        Args:
            origin: (3,) m, where all rays begin, outside of all bodies.
            ends: (N, 3) m.

        Returns:
            The names of the parts, "" where a ray meets none, and the shares (N,) of the rays up to
            there, 1 where they meet none.
        """
        names: list[str] = []
        shares: list[float] = []
        for first in range(0, len(ends), _RAYS_IN_A_BATCH):
            batch = ends[first : first + _RAYS_IN_A_BATCH].tolist()
            hits = pybullet.rayTestBatch([origin] * len(batch), batch, physicsClientId=self.client)
            names += [self._parts[hit[:2]] if hit[0] >= 0 else "" for hit in hits]
            shares += [hit[2] for hit in hits]
        return tuple(names), np.array(shares)

    # Snapshots

    def snapshot(self) -> int:
        """Keep the present state of all bodies in memory and return its number."""
        return int(pybullet.saveState(physicsClientId=self.client))

    def restore(self, snapshot: int) -> None:
        """Return to a state; bodies must be the same as then, obstacles excepted."""
        pybullet.restoreState(stateId=snapshot, physicsClientId=self.client)

    # Pictures

    def picture(
        self, camera: Camera, width: int, height: int, lines: Sequence[Line] = ()
    ) -> NDArray[np.uint8]:
        """Return a picture of the world, (height, width, 3), computed without a graphics card.

        Args:
            camera: where it is taken from.
            width: pixels.
            height: pixels.
            lines: drawn into the picture where no body hides them.
        """
        view = pybullet.computeViewMatrixFromYawPitchRoll(
            camera.target, camera.distance, camera.yaw, camera.pitch, 0.0, 2
        )
        projection = pybullet.computeProjectionMatrixFOV(
            camera.field_of_view, width / height, 0.05, 10.0
        )
        _, _, pixels, depth, _ = pybullet.getCameraImage(
            width,
            height,
            view,
            projection,
            shadow=1,
            lightDirection=(1.0, -1.2, 3.0),
            lightDistance=3.0,
            lightAmbientCoeff=0.6,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.15,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            physicsClientId=self.client,
        )
        image = np.array(pixels, np.uint8).reshape(height, width, 4)
        matrix = np.array(projection).reshape(4, 4).T @ np.array(view).reshape(4, 4).T
        draw_lines(image, np.asarray(depth).reshape(height, width), matrix, lines)
        return np.ascontiguousarray(image[:, :, :3])

    def look(self, camera: Camera) -> None:
        """Turn the window's camera."""
        pybullet.resetDebugVisualizerCamera(
            camera.distance,
            camera.yaw,
            camera.pitch,
            camera.target,
            physicsClientId=self.client,
        )

    def show_lines(self, lines: Sequence[Line]) -> None:
        """Show lines in the window: those of the last call, as far as they have grown, or others.

        Args:
            lines: none of them takes away what was shown of it; for that, show none first.
        """
        if not lines:
            pybullet.removeAllUserDebugItems(physicsClientId=self.client)
            self._shown = {}
        for number, line in enumerate(lines):
            shown = self._shown.get(number, 1)
            for begin, end in zip(line.points[shown - 1 :], line.points[shown:], strict=False):
                pybullet.addUserDebugLine(
                    begin.tolist(),
                    end.tolist(),
                    lineColorRGB=line.color,
                    lineWidth=_WINDOW_LINE_WIDTH,
                    physicsClientId=self.client,
                )
            self._shown[number] = max(shown, len(line.points))

    # Internals

    def _name(self, name: str, body: int) -> None:
        self._bodies[name] = body
        self._parts[body, -1] = name

    def _pair(self, body_a: int, body_b: int, link_a: int, link_b: int) -> Contact:
        a, b = sorted((self._parts[body_a, link_a], self._parts[body_b, link_b]))
        return a, b

    def _remove(self, name: str) -> None:
        body = self._bodies.pop(name)
        del self._parts[body, -1]
        # PyBullet gives the numbers of removed bodies to new ones.
        self._touching, self._contacts = set(), frozenset()
        pybullet.removeBody(body, physicsClientId=self.client)

    def _park(self, slot: int, obstacle: Obstacle, seen_only: Sequence[Obstacle] = ()) -> None:
        shape = Obstacle(shape=obstacle.shape, position=_ORIGIN, size=obstacle.size)
        color = OBSTACLE_COLORS[slot % len(OBSTACLE_COLORS)]
        self.add_body(
            f"obstacle_{slot}",
            (shape,),
            color=color,
            position=(float(slot), 0.0, _PARKING_HEIGHT),
            seen_only=seen_only,
        )

    def _shapes(
        self, parts: Sequence[Obstacle], seen_only: Sequence[Obstacle], color: Color
    ) -> tuple[int, int]:
        if len(parts) == 1 and (parts[0].position, parts[0].quaternion) == (_ORIGIN, _IDENTITY):
            return self._single_shape(parts[0], seen_only, color)
        collision = pybullet.createCollisionShapeArray(
            collisionFramePositions=[list(part.position) for part in parts],
            collisionFrameOrientations=[list(part.quaternion) for part in parts],
            **self._geometries(parts),
        )
        return int(collision), self._visual([*parts, *seen_only], color)

    def _visual(self, parts: Sequence[Obstacle], color: Color) -> int:
        visual = pybullet.createVisualShapeArray(
            visualFramePositions=[list(part.position) for part in parts],
            visualFrameOrientations=[list(part.quaternion) for part in parts],
            rgbaColors=[list(color)] * len(parts),
            **self._geometries(parts),
        )
        return int(visual)

    def _geometries(self, parts: Sequence[Obstacle]) -> dict[str, Any]:
        solids = [_solid(part) for part in parts]
        return {
            "shapeTypes": [_geometry(solid) for solid in solids],
            "radii": [solid.radius for solid in solids],
            "halfExtents": [list(solid.half_extents) for solid in solids],
            "lengths": [solid.length for solid in solids],
            "physicsClientId": self.client,
        }

    def _single_shape(
        self, part: Obstacle, seen_only: Sequence[Obstacle], color: Color
    ) -> tuple[int, int]:
        """Return shapes without a compound around them, which contacts are cheaper with."""
        solid = _solid(part)
        common: dict[str, Any] = {
            "shapeType": _geometry(solid),
            "radius": solid.radius,
            "halfExtents": solid.half_extents,
            "physicsClientId": self.client,
        }
        length = solid.length
        collision = pybullet.createCollisionShape(height=length, **common)
        if not self._seen:
            return int(collision), self._unseen
        if seen_only:
            return int(collision), self._visual([part, *seen_only], color)
        visual = pybullet.createVisualShape(length=length, rgbaColor=color, **common)
        return int(collision), int(visual)
