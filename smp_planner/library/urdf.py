"""A robot from its URDF: the chain of moving joints to a tip, its limits, spheres around its links.

The joints of `RobotModel` turn about the z axes of its frames or, prismatic ones, slide along them;
a joint with another axis gets a frame that is turned so. The base frame, in which obstacles and
places of the tool are, is that of the URDF's root link, unless a pose of that in another is given.
Metres and radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from smp_gym.arrays import BoolArray, FloatArray, checked_array, checked_number, shown
from smp_gym.geometry.pose import checked_pose
from smp_gym.robot.kinematics import SphereSet
from smp_gym.scene import Obstacle
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import LIMIT_TOLERANCE
from smp_planner.library.covering import MOST_SPHERES, cover_link, cover_obstacle
from smp_planner.library.moving_chain import MovingChain, moving_chain
from smp_planner.library.semantic_description import LinkPair, checked_pairs, read_touching
from smp_planner.library.timed_trajectory import TimedTrajectory, timed
from smp_planner.library.timing_settings import TimingSettings
from smp_planner.library.urdf_reading import Description, Joint, Link, Shape, read_description

__all__ = ["Robot"]

_STANDING = 1e-3
"""rad or m: files round positions to three digits."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial chain of revolute and prismatic joints with spheres around its links.

    Made by `Robot.from_urdf`.

    Attributes:
        model: the chain; its `collision_pairs` are left to `SMP.fit`, which sees from the
            demonstrations what may come near to what.
        joints: (n) names of its joints, in the order of a configuration's coordinates, which are
            rad, or m of a prismatic joint (`units`).
        continuous: (n) whether a turn of 2 pi changes nothing about a joint; none by default.
        standing: where other joints stand, rad or m, by name: those held, those that mimic them,
            and those beside the chain. Fixed ones are left out.
        base_links: (4, 4) poses in the base frame of all links that do not move, by name.
        visuals: what is seen of it, shapes with the number of the link of `model` that each is
            fixed to; of links without visual shapes, or with one that cannot be read, it is the
            collision shapes. Files of `SMP.save` do not hold them.
        tip_links: (4, 4) poses in the tip's frame of all links that move as the tip does, it among
            them, by name.
        bodies: (S) names of the links that its spheres cover; none where that is not known.
        touching: pairs of names of links, or of bodies that it holds, that may touch.
        held: names of the bodies that it holds, which `bodies` has, too.
    """

    model: RobotModel
    joints: tuple[str, ...]
    continuous: tuple[bool, ...] = ()
    standing: Mapping[str, float] = field(default_factory=dict)
    base_links: Mapping[str, FloatArray] = field(default_factory=dict)
    visuals: tuple[tuple[int, Shape], ...] = ()
    tip_links: Mapping[str, FloatArray] = field(default_factory=dict)
    bodies: tuple[str, ...] = ()
    touching: frozenset[LinkPair] = frozenset()
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "continuous", self.continuous or (False,) * len(self.joints))
        for name in ("joints", "continuous"):
            if len(getattr(self, name)) != self.model.joints:
                raise ValueError(
                    f"Robot.{name} must have {self.model.joints} entries, got {getattr(self, name)}"
                )
        if self.bodies and len(self.bodies) != len(self.model.link):
            raise ValueError(
                f"Robot.bodies must name the links of {len(self.model.link)} spheres, got "
                f"{len(self.bodies)} names"
            )

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        return f"Robot({self.dimension} joints, {len(self.model.link)} spheres)"

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        tip: str,
        *,
        held: Mapping[str, float] | None = None,
        overshoot: float = 0.02,
        limits: Mapping[str, tuple[float, float]] | None = None,
        velocities: Mapping[str, float] | None = None,
        bodiless: Iterable[str] = (),
        packages: Mapping[str, str | Path] | None = None,
        srdf: str | Path | None = None,
        touching: Iterable[tuple[str, str]] = (),
        base: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> Robot:
        """Read the chain from the root link to a tip.

        What hangs on the chain beside it, such as fingers, moves with the link that it hangs on.

        Args:
            path: the file. A mesh named without a package lies in the file's folder or in the
                package (`package.xml`) around it, that of a package in the folder of its name
                above the file, or beside such a one.
            tip: link whose origin is the tool.
            held: joints that stand still, and where (rad or m; 0, the origin, for floating and
                planar ones). Mimic joints follow what they mimic. Joints beside the chain that are
                not named stand at 0, or at the limit that is nearest to it.
            overshoot: m, largest distance of a point of a sphere from the collision shape that it
                covers. The smaller, the more spheres: half of it asks for about three times as
                many.
            limits: (lower, upper), rad or m, by joint, in place of those of the file. The soft
                limits of a `safety_controller` are not read.
            velocities: limits of velocity, rad/s or m/s, by joint, likewise.
            bodiless: links that move and are known to have no body. Others that have a visual
                shape must have a collision shape, and each joint must move at least one.
            packages: folders by the name of the package, in which meshes may lie, too.
            srdf: semantic description, whose disabled collisions are pairs of links that may touch.
            touching: more such pairs, by their names.
            base: position (3,) m and quaternion (4,) x, y, z, w of the root link in the frame in
                which obstacles, clouds, goals of the tool and planning scenes are, such as that of
                the room; None takes the root link's own.

        Raises:
            FileNotFoundError: no such file, or a mesh is missing.
            ValueError: not a URDF, no such link or joint, no moving joint on the chain, a joint of
                the chain that is neither revolute, continuous, prismatic, fixed nor held or has no
                limits, a link without body, or more than `covering.MOST_SPHERES` spheres; the
                message names joint or link, and attribute.
        """
        overshoot = checked_number("overshoot", overshoot, above=0.0)
        description = read_description(path, packages)
        links = description.links
        if not isinstance(tip, str) or tip not in links:
            raise ValueError(f"tip must be one of {', '.join(links)}; got {tip!r}")
        chain = moving_chain(description.joints, tip, held, limits, velocities)
        allowed = checked_pairs(touching, links.keys())
        if srdf is not None:
            allowed |= read_touching(srdf, links.keys())
        pose = _checked_base(base)
        robot = _assembled(description, chain, tip, overshoot, bodiless, pose)
        return replace(robot, touching=allowed)

    @property
    def dimension(self) -> int:
        """Number of joints n."""
        return len(self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """(n) units of a configuration's coordinates, "rad" or "m"."""
        return self.model.units

    @property
    def links(self) -> frozenset[str]:
        """Names of the links that are known: all but those without spheres between base and tip."""
        return frozenset({*self.bodies, *self.base_links, *self.tip_links} - set(self.held))

    def holding(
        self,
        bodies: Iterable[Obstacle] | Obstacle,
        *,
        overshoot: float = 0.01,
        name: str = "what it holds",
        touching: Iterable[str] = (),
    ) -> Robot:
        """Return the robot with bodies in its tool, which collide as its links do.

        They stay clear of obstacles, and of all links that move against the tool unless these may
        touch them or come near them in a demonstration (`PAIR_GAP`). Primitives of the robot are
        learned anew, from the same demonstrations.

        Args:
            bodies: at least one, standing still; their positions and quaternions are in the tip's
                frame.
            overshoot: m, by which spheres stand out of a body at most.
            name: of the bodies together, for warnings and `touching`; one that the robot does not
                have yet.
            touching: names of links that may touch them.

        Raises:
            ValueError: not such bodies or names, one too large for the overshoot, or more than
                `covering.MOST_SPHERES` spheres.
        """
        overshoot = checked_number("overshoot", overshoot, above=0.0)
        allowed = self._touching_held(name, touching)
        if not isinstance(bodies, Iterable | Obstacle):
            raise ValueError(f"bodies must be Obstacles, got {shown(bodies)}")
        given = (bodies,) if isinstance(bodies, Obstacle) else tuple(bodies)
        for index, body in enumerate(given):
            if not isinstance(body, Obstacle) or any(body.velocity):
                raise ValueError(
                    f"bodies[{index}] must be an Obstacle that stands still, got {shown(body)}"
                )
        if not given:
            raise ValueError("bodies must hold at least one Obstacle, got none")
        covers = [
            cover_obstacle(body, overshoot, f"bodies[{index}]") for index, body in enumerate(given)
        ]
        balls, tool, own = np.concatenate(covers), self.model.end_effector, self.model.spheres
        if len(balls) + len(own) > MOST_SPHERES:
            raise ValueError(
                f"bodies would need {len(balls)} spheres beside {len(own)}, beyond the "
                f"{MOST_SPHERES} that a robot may have: choose a larger overshoot"
            )
        spheres = SphereSet(
            np.append(own.link, np.full(len(balls), self.dimension)),
            np.concatenate([own.center, balls[:, :3] @ tool[:3, :3].T + tool[:3, 3]]),
            np.append(own.radius, balls[:, 3]),
        )
        none = np.empty((0, 2), np.int64)
        model = replace(self.model, spheres=spheres, collision_pairs=none)
        names = self.bodies and (*self.bodies, *([name] * len(balls)))
        return replace(
            self,
            model=model,
            bodies=names,
            touching=self.touching | allowed,
            held=(*self.held, name),
        )

    def _touching_held(self, name: Any, touching: Any) -> frozenset[LinkPair]:
        """Return the pairs of what is held with the links that may touch it."""
        if not isinstance(name, str) or not name:
            raise ValueError(f"name must be a text, got {shown(name)}")
        if name in self.links or name in self.held:
            raise ValueError(
                f"name must be none of the robot's links, nor of what it holds, got {name!r}"
            )
        if isinstance(touching, str) or not isinstance(touching, Iterable):
            raise ValueError(f"touching must be names of links, got {shown(touching)}")
        given = tuple(touching)
        if given and not self.bodies:
            raise ValueError("touching needs a robot that knows the links of its spheres (bodies)")
        for other in given:
            if not isinstance(other, str) or other not in self.links:
                raise ValueError(
                    f"touching must be names of links of the robot, got {shown(other)}"
                )
        return frozenset(frozenset((name, other)) for other in given)

    def may_touch(self) -> BoolArray:
        """Return a mask (S, S) of pairs of spheres whose links are `touching`."""
        count = len(self.model.link)
        mask = np.zeros((count, count), np.bool_)
        bodies = np.array(self.bodies)
        for pair in self.touching if self.bodies else ():
            first, last = (bodies == name for name in (min(pair), max(pair)))
            mask |= first[:, None] & last | last[:, None] & first
        return mask

    def tool_positions(self, configurations: FloatArray) -> FloatArray:
        """Return where the tool is, (..., 3) m, in configurations (..., n) rad or m."""
        return self.model.carried_points(configurations, np.zeros(3))[0]

    def tool_quaternions(self, configurations: FloatArray) -> FloatArray:
        """Return how the tool is turned, x, y, z, w (..., 4), in configurations (..., n) rad or m.

        From the tip's frame to the base frame.
        """
        rotations = self.model.tool_rotations(configurations)[0]
        flat = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat()
        return np.asarray(flat.reshape(*rotations.shape[:-2], 4))

    def configuration(
        self, positions: Mapping[str, float], *, ignored: Iterable[str] = ()
    ) -> FloatArray:
        """Return the configuration (n,) rad or m of joints that are given by name, in any order.

        Args:
            positions: rad or m. Those of joints that do not move must be where these stand, up to
                1e-3, for the robot's shape depends on them.
            ignored: joints in it that are not this robot's, or matter for nothing.

        Raises:
            ValueError: a joint is missing, is not of this robot, or stands elsewhere; the message
                names all such joints.
        """
        if not isinstance(positions, Mapping):
            raise ValueError(
                f"positions must map names of joints to numbers, got {shown(positions)}"
            )
        if isinstance(ignored, str) or not isinstance(ignored, Iterable):
            raise ValueError(f"ignored must be names of joints, got {shown(ignored)}")
        left = set(ignored)
        given = {
            name: checked_number(f"positions[{name!r}]", position)
            for name, position in positions.items()
            if name not in left
        }
        for what, names in (
            ("must give all joints, but lack", [n for n in self.joints if n not in given]),
            (
                "name joints that the robot lacks (ignored= leaves them out):",
                [str(n) for n in given if n not in self.joints and n not in self.standing],
            ),
        ):
            if names:
                raise ValueError(f"positions {what} {', '.join(names)}")
        elsewhere = {
            name: position
            for name, position in given.items()
            if name in self.standing and abs(position - self.standing[name]) > _STANDING
        }
        if elsewhere:
            stands = {name: self.standing[name] for name in elsewhere}
            raise ValueError(
                f"positions must be where the robot's other joints stand, {stands}, got "
                f"{elsewhere}: make the robot with held={elsewhere}"
            )
        return np.array([given[name] for name in self.joints])

    def timed(self, path: FloatArray, acceleration: Any, **settings: Any) -> TimedTrajectory:
        """Return the fastest motion along a path, see `timed_trajectory.timed`.

        Args:
            path: (T, n) rad or m, T ≥ 2, within the limits of the joints, such as `Plan.best`.
            acceleration: rad/s² or m/s², limit of all joints or of each (n,); of each, if some
                joints are revolute and others prismatic.
            **settings: see `TimingSettings`.

        Raises:
            ModuleNotFoundError: see there.
            ValueError: see there; or the path leaves the limits by more than 1e-6 rad or m.
        """
        samples = checked_array("path", path, (None, self.dimension))
        model = self.model
        beyond = np.maximum(model.lower - samples, samples - model.upper)
        if beyond.max(initial=0.0) > LIMIT_TOLERANCE:
            sample, joint = np.unravel_index(beyond.argmax(), beyond.shape)
            raise ValueError(
                f"path must keep the limits of joint {self.joints[joint]!r}, "
                f"[{model.lower[joint]:.6g}, {model.upper[joint]:.6g}] {model.units[joint]}, got "
                f"{samples[sample, joint]:.9g} at sample {sample}"
            )
        return timed(
            self.joints,
            self.model.velocity,
            samples,
            acceleration,
            TimingSettings(**settings),
            self.units,
        )


def _checked_base(base: Any) -> FloatArray:
    """Return the pose (4, 4) of the root link."""
    pose = np.eye(4)
    if base is None:
        return pose
    if not isinstance(base, tuple | list) or len(base) != 2:
        raise ValueError(f"base must be a position and a quaternion, got {shown(base)}")
    given = checked_pose(*base, where="base: ")
    pose[:3, :3], pose[:3, 3] = given.rotation.as_matrix(), given.position
    return pose


def _check_bodies(
    links: Mapping[str, Link], indices: Mapping[str, int], count: int, bodiless: Any
) -> None:
    """Raise a ValueError if a link moves of which no collision shape is known."""
    if isinstance(bodiless, str) or not isinstance(bodiless, Iterable):
        raise ValueError(f"bodiless must be names of links, got {shown(bodiless)}")
    named = tuple(bodiless)
    for name in named:
        if not isinstance(name, str) or name not in links or links[name].shapes:
            raise ValueError(f"bodiless must be links without collision shapes, got {shown(name)}")
    bare = [
        name
        for name, link in links.items()
        if indices[name] > 0 and link.visible and not link.shapes
    ]
    for index in range(1, count + 1):
        group = [name for name in links if indices[name] == index]
        if not any(links[name].shapes or name in bare for name in group):
            bare += group
    missing = [name for name in bare if name not in named]
    if missing:
        raise ValueError(
            f"links that move must have collision shapes, but {', '.join(missing)} "
            "have none: nothing could be said of their collisions; if they have no body, say so by "
            f"bodiless={tuple(missing)!r}"
        )


def _assembled(
    description: Description,
    chain: MovingChain,
    tip: str,
    overshoot: float,
    bodiless: Any,
    base: FloatArray,
) -> Robot:
    links, moving = description.links, chain.moving
    children: dict[str, list[Joint]] = {name: [] for name in links}
    for joint in chain.joints.values():
        children[joint.parent].append(joint)
    below = {joint.child for joint in chain.joints.values()}
    root = next(name for name in links if name not in below)
    # Of each link, the moving one that it is fixed to, and its pose there.
    placed: dict[str, tuple[int, FloatArray]] = {root: (0, np.eye(4))}
    origins = np.empty((len(moving), 4, 4))
    waiting = [root]
    while waiting:
        parent = waiting.pop()
        index, pose = placed[parent]
        for joint in children[parent]:
            position = chain.positions[joint.name]
            if position is None:
                number = moving.index(joint)
                turn = np.eye(4)
                turn[:3, :3] = _turning_z_to(joint.axis)
                origins[number] = pose @ joint.origin @ turn
                placed[joint.child] = number + 1, turn.T
            else:
                placed[joint.child] = index, pose @ joint.held_at(position)
            waiting.append(joint.child)
    _check_bodies(
        links, {name: index for name, (index, _) in placed.items()}, len(moving), bodiless
    )
    link: list[int] = []
    bodies: list[str] = []
    spheres = [np.empty((0, 4))]
    for name, (index, pose) in placed.items():
        cover = cover_link(links[name], overshoot, MOST_SPHERES - len(link))
        link += [index] * len(cover)
        bodies += [name] * len(cover)
        centers = cover[:, :3] @ pose[:3, :3].T + pose[:3, 3]
        spheres.append(np.column_stack([centers, cover[:, 3]]))
    data = np.concatenate(spheres)
    model = RobotModel(
        base=base,
        joint_origins=origins,
        end_effector=placed[tip][1],
        lower=np.array([joint.lower for joint in moving]),
        upper=np.array([joint.upper for joint in moving]),
        velocity=np.array([joint.velocity for joint in moving]),
        spheres=SphereSet(np.array(link, np.int64), data[:, :3], data[:, 3]),
        collision_pairs=np.empty((0, 2), np.int64),
        prismatic=np.array([joint.kind == "prismatic" for joint in moving]),
    )
    names = tuple(joint.name for joint in moving)
    standing = {
        name: position
        for name, position in chain.positions.items()
        if position is not None and not chain.joints[name].is_fixed
    }
    base_links = {name: base @ pose for name, (index, pose) in placed.items() if index == 0}
    continuous = tuple(joint.kind == "continuous" for joint in moving)
    visuals = tuple(
        (index, replace(shape, origin=pose @ shape.origin))
        for name, (index, pose) in placed.items()
        for shape in links[name].visuals or links[name].shapes
    )
    last, tool = placed[tip]
    tip_links = {
        name: np.linalg.inv(tool) @ pose for name, (index, pose) in placed.items() if index == last
    }
    return Robot(model, names, continuous, standing, base_links, visuals, tip_links, tuple(bodies))


def _turning_z_to(axis: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes the z axis to a unit vector."""
    return np.asarray(Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0].as_matrix())
