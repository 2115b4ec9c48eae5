"""The workcell: arm, table, bin, object and obstacles of one scene, moved and judged."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from smp_gym import assets
from smp_gym.arrays import FloatArray
from smp_gym.observation import CONTROL_PERIOD, MAX_EPISODE_STEPS, ObjectState, RobotState
from smp_gym.physics.jaco import ARM, HAND_LINKS, Jaco, set_grip_friction
from smp_gym.physics.lines import Line, wire_box
from smp_gym.physics.world import PHYSICS_PERIOD, BulletWorld, Contact
from smp_gym.robot.kinematics import LINKS, PEN_RADIUS, PEN_TIP
from smp_gym.robot.pen import PEN_CONFIGURATION
from smp_gym.scene import (
    TABLE,
    ManipulatedObject,
    Obstacle,
    Scene,
    goal_bodies,
    goal_boxes,
    goal_kind,
)
from smp_gym.tasks import Status, Task
from smp_gym.tasks.status import CALM_SPEED

__all__ = ["CLEARANCE_LIMIT", "SUBSTEPS", "Workcell"]

SUBSTEPS = round(CONTROL_PERIOD / PHYSICS_PERIOD)
"""Physics steps per environment step."""

CLEARANCE_LIMIT = 0.05
"""m; larger clearances are not told apart."""

_TABLE_COLOR = (0.86, 0.84, 0.80, 1.0)
_OBJECT_COLOR = (0.96, 0.80, 0.20, 1.0)
_TRACE_COLOR = (0.11, 0.25, 0.67)
_TARGET_COLOR = (0.0, 0.55, 0.25)
_TRACE_WIDTH = 0.008
_TARGET_WIDTH = 0.004
_ORIGIN = (0.0, 0.0, 0.0)
# Where bodies of goals wait, so deep and so far apart that they are near nothing.
_PARKING = ((0.0, 0.0, -10.0), (0.0, 5.0, -10.0))
_FAR_AWAY = (0.0, 0.0, 10.0)
_IDENTITY = (0.0, 0.0, 0.0, 1.0)

# The weight of the arm goes over to the wrist's joints in turn: with the engine's 50 iterations the
# last one sags by up to 3 mrad, with these by 0.1 mrad. Without an object they cost little.
_PEN_ITERATIONS = 150

_GRASP_STEPS = 30
_SETTLING_STEPS = 20
_STANDING_STEPS = 4
_GRASP_TOLERANCE = 0.01
# PyBullet never frees the shapes of bodies that were removed, a few kilobytes each.
_SCENES_PER_WORLD = 500
_DISPERSALS = 10

_HAND_PARTS = frozenset(HAND_LINKS)


@cache
def _group(part: str) -> str:
    """Return the group of a part, as `Task.permitted_contacts` names them."""
    if part in _HAND_PARTS:
        return "hand"
    if part in LINKS:
        return "arm"
    return part.split("_")[0]


@cache
def _groups(pair: Contact) -> tuple[str, str]:
    a, b = sorted((_group(pair[0]), _group(pair[1])))
    return a, b


class Workcell:
    """Plays scenes of one task.

    The start of an episode, the hand closed on the object, is settled once and restored from then
    on, as long as scenes begin in the same configuration with the same object. Where the object
    stands on the table, it is set down there for each scene anew.

    Args:
        task: whose scenes are played; it says which contacts they need.
        gui: open a window.
        seen: whether pictures will be taken, or the window be looked at.

    Attributes:
        world: the physics.
        arm: the arm in it, once a scene was loaded.
        robot: measured state of the arm.
        manipulated: measured state of the object, or of the pen's tip.
        status: what the task is told.
        collision: names of the two parts of the first forbidden contact, or None.
        collision_point: (3,) m, where they touched, or None.
        clearance: m, the least distance so far of arm or held object to an obstacle, at most
            `CLEARANCE_LIMIT`.
        time: s since the episode began, at which moving obstacles stand. A step that ends early, at
            a collision, adds only the part that was simulated.
    """

    arm: Jaco
    robot: RobotState
    manipulated: ObjectState
    status: Status

    def __init__(self, task: Task, *, gui: bool = False, seen: bool = True) -> None:
        self.world = BulletWorld(gui=gui, seen=seen)
        self._task = task
        self._grasp: tuple[tuple[float, ...], ManipulatedObject | None] | None = None
        self._settled = -1
        self._scenes = 0

    def load(self, scene: Scene) -> None:
        """Set up a scene and stand at its start.

        Raises:
            ValueError: the hand cannot hold the object, or the scene begins with a collision.
        """
        manipulated = scene.manipulated
        grasp = _grasp(scene)
        if grasp != self._grasp or self._scenes >= _SCENES_PER_WORLD:
            self._grasp = None
            self._furnish(scene, manipulated)
            if manipulated is None or manipulated.position is None:
                self._settle(scene, manipulated)
            self._settled = self.world.snapshot()
            self._grasp, self._scenes = grasp, 0
        self._scenes += 1
        self._disperse(scene)
        self.world.restore(self._settled)
        if manipulated is None:
            self.arm.put(scene.start)
        standing = manipulated is not None and manipulated.position is not None
        self.arm.set_reference(scene.start, 0.0 if standing else 1.0)
        if manipulated is not None and standing:
            self._set_down(scene, manipulated)
        for name, goal in goal_bodies(scene).items():
            self.world.place(name, goal.position)
        for name, obstacle in zip(self.world.obstacles, scene.obstacles, strict=True):
            self.world.place(name, obstacle.position, obstacle.quaternion)
        self._moving = {
            name: obstacle
            for name, obstacle in zip(self.world.obstacles, scene.obstacles, strict=True)
            if obstacle.motion is not None
        }
        self._moved = {name: obstacle.position for name, obstacle in self._moving.items()}
        self._substeps, self._present = 0, scene.obstacles
        self.world.detect_contacts()
        self.collision: Contact | None = None
        self.collision_point: FloatArray | None = None
        self.clearance = CLEARANCE_LIMIT
        self._pen = manipulated is None
        self._size = np.array(manipulated.size if manipulated else (PEN_RADIUS,) * 3)
        self._trace, self._traced = np.empty((0, 3)), 0
        self._scene = scene
        self._calm_steps = 0
        self._squeezing = True
        self._contacts: frozenset[Contact] = frozenset()
        if self._collides():
            raise ValueError(f"the scene begins with a collision: {self.collision}")
        for name in self._moving:
            # The engine sees no contact between two bodies that forces do not move.
            for place in goal_bodies(scene):
                if self.world.clearance((name,), (place,), CLEARANCE_LIMIT) <= 0.0:
                    raise ValueError(f"the motion of {name} begins in the {place} of the scene")
        self._measure()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The scene's obstacles as they stand now; the same tuple for as long as they stand so.

        Those that move have their present position and velocity, and no motion.
        """
        if self._moving:
            now = tuple(obstacle.moved(self.time) for obstacle in self._scene.obstacles)
            self._present = self._present if now == self._present else now
        return self._present

    @property
    def time(self) -> float:
        """Seconds of physics since the episode began."""
        return self._substeps * PHYSICS_PERIOD

    @property
    def lines(self) -> tuple[Line, ...]:
        """Lines that show what has no body: goals without one, and the pen's trace over them."""
        shown = _bodiless_goals(self._scene)
        targets = (Line(points, _TARGET_COLOR, _TARGET_WIDTH) for points in shown)
        return (*targets, Line(self.status.trace, _TRACE_COLOR, _TRACE_WIDTH))

    def _disperse(self, scene: Scene) -> None:
        """Exchange the obstacles and take all bodies apart.

        The solver works through pairs of near bodies in the order in which they came near, which a
        snapshot does not hold. So the last episode's pairs must be gone before the next begins.
        """
        self.world.set_obstacles(scene.obstacles)
        for name, parking in zip(goal_bodies(scene), _PARKING, strict=False):
            self.world.place(name, parking)
        if scene.manipulated is not None:
            self.world.place("object", _FAR_AWAY)
        self.arm.stretch()
        # The engine drops pairs that have come apart a few at a time.
        for _ in range(_DISPERSALS):
            self.world.detect_contacts()

    def advance(self, action: FloatArray) -> None:
        """Move for one environment step, or up to the physics step that collides.

        Args:
            action: (7,) see `Jaco.integrate`.
        """
        self.arm.integrate(action)
        self.arm.track()
        self._squeezing = self.arm.squeezes(self.robot)
        self.arm.release(self.robot)
        self._contacts = frozenset()
        for _ in range(SUBSTEPS):
            self._substeps += 1
            self._move_obstacles()
            self.world.step()
            if self._collides():
                break
        self._measure()

    def _move_obstacles(self) -> None:
        """Put moving obstacles where they are at the present time; no force moves them."""
        for name, obstacle in self._moving.items():
            x, y, z = obstacle.at(self.time)[0].tolist()
            if self._moved[name] != (x, y, z):
                self._moved[name] = x, y, z
                self.world.place(name, (x, y, z), obstacle.quaternion)

    def _furnish(self, scene: Scene, manipulated: ManipulatedObject | None) -> None:
        """Fill an empty world: hand open, the object in it, or far away if it is set down later."""
        world = self.world
        world.clear()
        world.add_body("table", (TABLE,), color=_TABLE_COLOR)
        for (name, goal), parking in zip(goal_bodies(scene).items(), _PARKING, strict=False):
            boxes = goal_boxes(goal.model_copy(update={"position": _ORIGIN}))
            world.add_body(name, boxes, color=goal_kind(goal.kind).color, position=parking)
        if manipulated is None:
            world.set_solver_iterations(_PEN_ITERATIONS)
            self.arm = Jaco(world, assets.jaco_urdf(pen=True), PEN_CONFIGURATION)
            world.reserve_obstacles()
            return
        self.arm = Jaco(world, assets.jaco_urdf(), scene.start)
        block = Obstacle(shape="box", position=_ORIGIN, size=manipulated.size)
        position, quaternion = np.array(_FAR_AWAY), np.array(_IDENTITY)
        if manipulated.position is None:
            position, quaternion = self.arm.carried(self._task.object_in_hand)
        world.add_body(
            "object",
            (block,),
            color=_OBJECT_COLOR,
            mass=manipulated.mass,
            position=position.tolist(),
            quaternion=quaternion.tolist(),
        )
        set_grip_friction(world, world.body("object"), -1)
        world.reserve_obstacles()

    def _set_down(self, scene: Scene, manipulated: ManipulatedObject) -> None:
        """Put the arm into its start and the object on the table, and let it come to rest."""
        assert manipulated.position is not None
        self.arm.put(scene.start)
        half = manipulated.yaw / 2
        quaternion = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
        self.world.place("object", manipulated.position, quaternion)
        for _ in range(_STANDING_STEPS):
            self.arm.track()
            for _ in range(SUBSTEPS):
                self.world.step()

    def _settle(self, scene: Scene, manipulated: ManipulatedObject | None) -> None:
        """Let the hand close on the object or the pen."""
        self.arm.set_reference(scene.start if manipulated else PEN_CONFIGURATION, 1.0)
        self._close_hand()
        if manipulated is None:
            return
        expected, _ = self.arm.carried(self._task.object_in_hand)
        slip = float(np.linalg.norm(self.world.pose("object")[0] - expected))
        if slip > _GRASP_TOLERANCE:
            raise ValueError(
                f"the hand cannot hold an object of half-extents {manipulated.size} m and "
                f"{manipulated.mass} kg in the configuration {scene.start}"
            )

    def _close_hand(self) -> None:
        # Weightless until the fingers have closed on what they hold, then let it hang.
        for gravity, steps in ((False, _GRASP_STEPS), (True, _SETTLING_STEPS)):
            self.world.set_gravity(gravity)
            for _ in range(steps):
                self.arm.track()
                for _ in range(SUBSTEPS):
                    self.world.step()

    def _collides(self) -> bool:
        """Look for a forbidden contact, remember the first, and return whether there is one."""
        contacts = self.world.contacts()
        # Within a step the verdict depends on the contacts alone, and they seldom change.
        if contacts == self._contacts:
            return False
        self._contacts = contacts
        permitted = self._task.permitted_contacts(self._held())
        forbidden = [pair for pair in contacts if _groups(pair) not in permitted]
        if forbidden and self.collision is None:
            self.collision = min(forbidden)
            self.collision_point = self.world.contact_point(self.collision)
        return bool(forbidden)

    def _touching_object(self) -> frozenset[str]:
        """Return the groups that touch the object."""
        return frozenset(
            _group(b if a == "object" else a) for a, b in self._contacts if "object" in (a, b)
        )

    def _held(self) -> bool:
        """Return whether the hand grips the object: touches it and is not opening."""
        return self._squeezing and "hand" in self._touching_object()

    def _measure(self) -> None:
        world = self.world
        self.robot = self.arm.state()
        if self._pen:
            position, quaternion, linear, angular = self.arm.motion(PEN_TIP)
            self._mark(position)
        else:
            position, quaternion = world.pose("object")
            linear, angular = world.velocity("object")
        self.manipulated = ObjectState(position, quaternion, linear, angular, self._size)
        touching, held = self._touching_object(), self._held()
        still = math.sqrt(linear @ linear) < CALM_SPEED and "hand" not in touching
        self._calm_steps = self._calm_steps + 1 if still else 0
        movers = (ARM, "object") if held else (ARM,)
        self.clearance = world.clearance(movers, world.obstacles, self.clearance)
        self.status = Status(
            object_position=position,
            object_contacts=touching,
            held=held,
            calm_steps=self._calm_steps,
            collided=self.collision is not None,
            trace=self._trace[: self._traced],
        )

    def _mark(self, point: FloatArray) -> None:
        """Append a point to the trace; what was handed out of it keeps its values."""
        if self._traced == len(self._trace):
            room = max(MAX_EPISODE_STEPS + 1, 2 * self._traced)
            self._trace = np.concatenate([self._trace, np.empty((room - self._traced, 3))])
        self._trace[self._traced] = point
        self._traced += 1


def _bodiless_goals(scene: Scene) -> list[FloatArray]:
    """Return lines (M, 3) m that show strokes, and the goal poses of objects or tips."""
    size = scene.manipulated.size if scene.manipulated else (PEN_RADIUS,) * 3
    return [
        np.array(goal.checkpoints) if goal.checkpoints else wire_box(goal.position, size)
        for goal in scene.goals
        if not goal_boxes(goal)
    ]


def _grasp(scene: Scene) -> tuple[tuple[float, ...], ManipulatedObject | None]:
    """Return the part of a scene that its snapshot depends on.

    A pen, being fixed to the hand, is held alike wherever the episode begins; an object on the
    table is set down later.
    """
    manipulated = scene.manipulated
    if manipulated is None:
        return PEN_CONFIGURATION, None
    if manipulated.position is None:
        return scene.start, manipulated
    return (), manipulated.model_copy(update={"position": _ORIGIN, "yaw": 0.0})
