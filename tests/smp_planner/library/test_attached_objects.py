"""Objects that the robot of a MoveIt scene holds, against PyBullet's forward kinematics."""

import json

import numpy as np
import pybullet
import pybullet_data
import pytest
from kuka_swings import KUKA, LINKS, swings
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from smp_planner import SMP, PlanningScene, Robot

pytest.importorskip("yaml", reason="PyYAML is not installed")

PANDA = f"{pybullet_data.getDataPath()}/franka_panda/panda.urdf"
HAND, FINGERS = "panda_hand", ("panda_leftfinger", "panda_rightfinger")
OVERSHOOT = 0.015
HERE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
BOX, BALL, TUBE = ("box", (0.1, 0.04, 0.16)), ("sphere", (0.05,)), ("cylinder", (0.2, 0.03))
STATE = {
    f"panda_joint{number + 1}": q for number, q in enumerate((0.3, 0.2, -0.4, -1.9, 0.1, 2, 0.8))
}


def posed(pose):
    return {"position": list(pose[0]), "orientation": list(pose[1])}


def attached(name, link, frame, shapes, *, own=None, touch=()):
    """Return an attached object: shapes are ((kind, dimensions), pose)."""
    held = {
        "id": name,
        "header": {"frame_id": frame},
        "primitives": [{"type": kind, "dimensions": size} for (kind, size), _ in shapes],
        "primitive_poses": [posed(pose) for _, pose in shapes],
    }
    if own is not None:
        held["pose"] = posed(own)
    return {"link_name": link, "object": held, "touch_links": list(touch)}


def scene_of(*held, world=(), joints=None, **fields):
    joints = joints or {}
    state = {
        "joint_state": {"name": list(joints), "position": list(joints.values())},
        "attached_collision_objects": list(held),
    }
    return {"world": {"collision_objects": list(world)}, "robot_state": state, **fields}


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a message, as JSON, which is YAML, too."""

    def to_file(content, name="scene.yaml"):
        path = tmp_path / name
        path.write_text(json.dumps(content))
        return path

    return to_file


@pytest.fixture(scope="module")
def panda():
    meshes = {"meshes": f"{pybullet_data.getDataPath()}/franka_panda/meshes"}
    return Robot.from_urdf(PANDA, HAND, packages=meshes, overshoot=0.05)


@pytest.fixture(scope="module")
def kuka():
    return Robot.from_urdf(KUKA, LINKS[7], overshoot=0.04)


class Physics:
    """A robot in PyBullet that is moved by its joints' names."""

    def __init__(self, file):
        self.client = BulletClient(pybullet.DIRECT)
        self.body = self.client.loadURDF(file, useFixedBase=True)
        count = self.client.getNumJoints(self.body)
        infos = [self.client.getJointInfo(self.body, index) for index in range(count)]
        self.joints = {info[1].decode(): info[0] for info in infos}
        self.links = {info[12].decode(): info[0] for info in infos}

    def stand(self, joints):
        for name, angle in joints.items():
            self.client.resetJointState(self.body, self.joints[name], angle)

    def pose(self, link):
        state = self.client.getLinkState(self.body, self.links[link], computeForwardKinematics=1)
        return state[4], state[5]

    def chained(self, *poses):
        position, turn = poses[0]
        for inner in poses[1:]:
            position, turn = self.client.multiplyTransforms(position, turn, *inner)
        return position, turn

    def shape(self, kind, size):
        client = self.client
        if kind == "box":
            made = client.createCollisionShape(client.GEOM_BOX, halfExtents=np.divide(size, 2.0))
        elif kind == "sphere":
            made = client.createCollisionShape(client.GEOM_SPHERE, radius=size[0])
        else:
            made = client.createCollisionShape(client.GEOM_CYLINDER, height=size[0], radius=size[1])
        return client.createMultiBody(0.0, made)

    def put(self, body, pose):
        self.client.resetBasePositionAndOrientation(body, *pose)


@pytest.fixture
def physics():
    made = []

    def start(file):
        made.append(Physics(file))
        return made[-1]

    yield start
    for each in made:
        each.client.disconnect()


def poses(seed, count):
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=seed).as_quat().tolist()
    return list(zip(rng.normal(0.0, 0.15, (count, 3)).tolist(), turns, strict=True))


def signed(shape, points):
    """Return the distances (N,) m of points in a shape's frame to it, negative inside."""
    kind, size = shape
    if kind == "sphere":
        return np.linalg.norm(points, axis=1) - size[0]
    if kind == "box":
        beyond = np.abs(points) - np.divide(size, 2.0)
    else:
        radial = np.hypot(points[:, 0], points[:, 1])
        beyond = np.stack([radial - size[1], np.abs(points[:, 2]) - size[0] / 2], axis=1)
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return outside + np.minimum(beyond.max(axis=1), 0.0)


def spheres(robot, name, configuration):
    """Return the spheres (S, 4) m of a body in a configuration."""
    kinematics = robot.model
    of_body = np.array(robot.bodies) == name
    assert (kinematics.link[of_body] == robot.dimension).all()
    tool = kinematics.end_effector
    in_tip = (kinematics.center[of_body] - tool[:3, 3]) @ tool[:3, :3]
    turn = Rotation.from_quat(robot.tool_quaternions(configuration))
    centers = turn.apply(in_tip) + robot.tool_positions(configuration)
    return np.column_stack([centers, kinematics.radius[of_body]])


def test_objects_are_where_pybullet_puts_them(write, panda, physics):
    """In the link, in another one, in frames of the file, in the world by the state of joints."""
    own, first, second, third, fourth, shift, world = poses(0, 7)
    frame = {
        "header": {"frame_id": FINGERS[0]},
        "child_frame_id": "grasp",
        "transform": {"translation": list(shift[0]), "rotation": list(shift[1])},
    }
    message = scene_of(
        attached("pair", HAND, HAND, [(BOX, first), (BALL, second)], own=own),
        attached("by finger", HAND, FINGERS[1], [(TUBE, third)]),
        attached("by frame", FINGERS[0], "grasp", [(BOX, fourth)]),
        attached("by world", HAND, "world", [(TUBE, world)]),
        joints=STATE,
        fixed_frame_transforms=[frame],
    )
    scene = PlanningScene.load(write(message), robot=panda, held_overshoot=OVERSHOOT)
    assert scene.robot.held == ("pair", "by finger", "by frame", "by world")
    assert "holding pair, by finger" in repr(scene)
    assert scene.obstacles == ()
    bullet = physics(PANDA)
    bullet.stand(STATE)
    hand = bullet.pose(HAND)
    inverse = bullet.client.invertTransform(*hand)
    in_hand = bullet.chained(inverse, world)
    rng = np.random.default_rng(1)
    for _ in range(3):
        q = rng.uniform(panda.model.lower, panda.model.upper)
        bullet.stand(dict(zip(panda.joints, q, strict=True)))
        hand, left, right = (bullet.pose(link) for link in (HAND, *FINGERS))
        true = {
            "pair": [
                (BOX, bullet.chained(hand, own, first)),
                (BALL, bullet.chained(hand, own, second)),
            ],
            "by finger": [(TUBE, bullet.chained(right, third))],
            "by frame": [(BOX, bullet.chained(left, shift, fourth))],
            "by world": [(TUBE, bullet.chained(hand, in_hand))],
        }
        for name, shapes in true.items():
            balls = spheres(scene.robot, name, q)
            directions = rng.normal(size=(200, 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            surface = (balls[:, None, :3] + balls[:, None, 3:] * directions).reshape(-1, 3)
            beyond = np.full(len(surface), np.inf)
            for shape, (position, turn) in shapes:
                back = Rotation.from_quat(turn).inv()
                beyond = np.minimum(beyond, signed(shape, back.apply(surface - position)))
                inside = rng.uniform(-0.12, 0.12, (3000, 3))
                inside = inside[signed(shape, inside) < -1e-5]
                placed = Rotation.from_quat(turn).apply(inside) + position
                away = np.linalg.norm(placed[:, None] - balls[:, :3], axis=-1) - balls[:, 3]
                assert len(inside) > 30
                assert away.min(axis=1).max() < 1e-5
            # Links stand where the numbers of a URDF say, up to single precision.
            assert beyond.max() < OVERSHOOT + 1e-4


ROD = ("cylinder", (0.3, 0.02))
ON_HAND = ((0.0, 0.0, 0.24), (0.0, 0.0, 0.0, 1.0))


def test_plans_keep_what_is_held_clear(write, kuka, physics):
    """Of an obstacle and of all links but those that may touch it, along the whole motion."""
    middle = swings()[0][40]
    end = kuka.model.carried_points(middle, np.array([0.0, 0.0, 0.3]))[0].tolist()
    ball = {"id": "ball", "primitives": [{"type": "sphere", "dimensions": [0.04]}]}
    ball["primitive_poses"] = [posed((end, (0.0, 0.0, 0.0, 1.0)))]
    message = scene_of(attached("rod", LINKS[7], LINKS[7], [(ROD, ON_HAND)]), world=[ball])
    scene = PlanningScene.load(write(message), robot=kuka)
    arm, bare = (SMP.fit(swings(), robot=robot) for robot in (scene.robot, kuka))
    ends = {"start": arm.demonstrations[0][0], "goal": arm.demonstrations[0][-1]}
    plan = arm.adapt(scene.obstacles, **ends, particles=12)
    unaware = bare.adapt(scene.obstacles, **ends, particles=12)
    assert plan.good.any()
    bullet = physics(KUKA)
    rod, there = bullet.shape(*ROD), bullet.shape("sphere", (0.04,))
    bullet.put(there, (end, (0.0, 0.0, 0.0, 1.0)))

    def least(trajectories):
        """Return the least distance of the rod to the ball, and to the links but the last."""
        found = []
        for q in trajectories[:, ::8].reshape(-1, 7):
            bullet.stand(dict(zip(kuka.joints, q, strict=True)))
            bullet.put(rod, bullet.chained(bullet.pose(LINKS[7]), ON_HAND))
            near = bullet.client.getClosestPoints
            links = near(rod, bullet.body, 5.0)
            found.append(
                (
                    min(point[8] for point in near(rod, there, 5.0)),
                    min(point[8] for point in links if point[4] != bullet.links[LINKS[7]]),
                )
            )
        return np.min(found, axis=0)

    assert (least(plan.trajectories[plan.good]) > 0.0).all()
    assert least(unaware.trajectories[unaware.good])[0] < 0.0


def paired(robot, name):
    """Return the links of which spheres are kept apart from those of a body."""
    bodies = np.array(robot.bodies)[robot.model.collision_pairs]
    with_it = bodies[(bodies == name).any(axis=1)]
    return set(with_it.ravel().tolist()) - {name}


def test_touch_links_are_ignored_and_no_others(write, kuka, tmp_path):
    held = [(ROD, ((0.0, 0.0, 0.34), (0.0, 0.0, 0.0, 1.0)))]
    free, touching = (
        PlanningScene.load(
            write(scene_of(attached("rod", LINKS[7], LINKS[7], held, touch=touch))), robot=kuka
        ).robot
        for touch in ((), (LINKS[6], LINKS[4]))
    )
    assert frozenset(("rod", LINKS[7])) in free.touching
    with_all, with_fewer = (SMP.fit(swings(), robot=robot) for robot in (free, touching))
    # That before the last, too: it turns against what is held.
    assert paired(with_all.robot, "rod") == set(LINKS[:7])
    assert paired(with_fewer.robot, "rod") == set(LINKS[:7]) - {LINKS[6], LINKS[4]}
    with_fewer.save(tmp_path / "held.npz")
    again = SMP.load(tmp_path / "held.npz").robot
    assert again.held == ("rod",)
    np.testing.assert_array_equal(
        again.model.collision_pairs, with_fewer.robot.model.collision_pairs
    )
    assert again.links == kuka.links == set(LINKS)


def test_a_request_may_attach_more(write, kuka):
    """What its start state holds is held, too; an object of the same name is replaced."""
    first = attached("rod", LINKS[7], LINKS[7], [(ROD, ON_HAND)])
    ball = attached("ball", LINKS[7], LINKS[7], [(BALL, ON_HAND)])
    shorter = attached("rod", LINKS[7], LINKS[7], [(("cylinder", (0.1, 0.02)), ON_HAND)])
    asked = {"start_state": {"attached_collision_objects": [ball, shorter], "is_diff": True}}
    scene = PlanningScene.load(
        write(scene_of(first)), request=write(asked, "request.yaml"), robot=kuka
    )
    alone = PlanningScene.load(write(scene_of(shorter)), robot=kuka).robot
    assert scene.robot.held == ("rod", "ball")
    count = [robot.bodies.count("rod") for robot in (scene.robot, alone)]
    assert count[0] == count[1]


def rod(**changes):
    return attached("rod", LINKS[7], LINKS[7], [(ROD, HERE)]) | changes


def without(name):
    entry = rod()
    del entry["object"][name]
    return entry


PLANE = {**rod()["object"], "planes": [{"coef": [0, 0, 1, 0]}]}


@pytest.mark.parametrize(
    ("held", "message", "left"),
    [
        ([rod(link_name="gripper")], "rod must be attached to .* 'gripper', which is not known", 0),
        ([rod(link_name=LINKS[3])], f"rod must be attached to .* got '{LINKS[3]}'; skip", 0),
        ([rod(link_name=LINKS[0])], "that moves as the tip does, lbr_iiwa_link_7; got", 0),
        ([rod(touch_links=["gripper", LINKS[2]])], "rod: touch_links must .* got gripper; skip", 1),
        ([rod(object=PLANE)], r"rod.planes\[0\] is a plane", 1),
        ([rod(link_name=None)], r"objects\[0\].link_name must name a link, got None", None),
        ([rod(object=None)], r"attached_collision_objects\[0\].object must be a mapping", None),
        ([rod(touch_links="hand")], "touch_links must be a list, got 'hand'", None),
        ([rod(touch_links=[3])], "touch_links must be names of links, got 3", None),
        ([rod(), rod()], "must hold each object once, got 'rod' again", None),
        ([without("header")], "rod.header.frame_id must name the frame .* as 'lbr_iiwa", None),
        ([without("primitives")], "rod must have a pose for each of its 0 primitives", None),
        ([rod(object={"id": "rod", "header": {"frame_id": "x"}})], "at least one shape", None),
        ([without("id")], r"object.id must name the object, got None", None),
        (
            [attached(LINKS[7], LINKS[7], LINKS[7], [(ROD, HERE)])],
            "none of the robot's links",
            None,
        ),
        ([attached("rod", LINKS[7], "world", [(ROD, HERE)])], "state must be known: .* lack", None),
        ([attached("rod", LINKS[7], LINKS[3], [(ROD, HERE)])], "frames must say where .*_3", None),
        (
            [attached("crate", LINKS[7], LINKS[7], [(("box", (4.0, 4.0, 4.0)), HERE)])],
            "crate, which the robot holds: .*(too large|beyond the)",
            None,
        ),
        (
            [attached("table", LINKS[7], LINKS[7], [(ROD, HERE)])],
            "must not hold what is attached to the robot, got table",
            None,
        ),
    ],
)
def test_what_cannot_be_held_is_refused_or_skipped(write, kuka, held, message, left):
    table = {"id": "table", "primitives": [{"type": "sphere", "dimensions": [0.1]}]}
    table["primitive_poses"] = [posed(HERE)]
    file = write(scene_of(*held, world=[table]))
    with pytest.raises(ValueError, match=message):
        PlanningScene.load(file, robot=kuka)
    if left is None:
        with pytest.raises(ValueError, match=message):
            PlanningScene.load(file, robot=kuka, skip_unsupported=True)
    else:
        scene = PlanningScene.load(file, robot=kuka, skip_unsupported=True)
        assert len(scene.robot.held) == left


def test_a_robot_must_be_given(write):
    file = write(scene_of(rod()))
    with pytest.raises(ValueError, match="rod is attached to the robot, which must be given"):
        PlanningScene.load(file)
    assert PlanningScene.load(file, skip_unsupported=True).robot is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": ""}, "name must be a text"),
        ({"name": LINKS[2]}, "name must be none of the robot's links"),
        ({"touching": "hand"}, "touching must be names of links, got 'hand'"),
        ({"touching": ["hand"]}, "touching must be names of links of the robot, got 'hand'"),
        ({"touching": [3]}, "touching must be names of links of the robot, got 3"),
    ],
)
def test_names_of_what_is_held_are_checked(write, kuka, arguments, message):
    (body,) = PlanningScene.load(
        write({"world": {"collision_objects": [rod()["object"] | {"header": {}}]}})
    ).obstacles
    with pytest.raises(ValueError, match=message):
        kuka.holding(body, **arguments)
    with pytest.raises(ValueError, match="nor of what it holds, got 'bar'"):
        kuka.holding(body, name="bar").holding(body, name="bar")
