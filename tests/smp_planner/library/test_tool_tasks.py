"""Goals and via-points of the tool of public robots, by PyBullet's forward kinematics."""

import math

import numpy as np
import pybullet
import pybullet_data
import pytest
from scipy.spatial.transform import Rotation

from smp_planner import (
    SMP,
    AdaptSettings,
    AnyOf,
    Cone,
    GoalRegion,
    Orientation,
    Robot,
    ToolViaPoint,
    ViaPoint,
)

DOWN = (0.0, 0.0, -1.0)
Z = (0.0, 0.0, 1.0)
FILES = {
    "kuka": ("kuka_iiwa/model.urdf", "lbr_iiwa_link_7"),
    "panda": ("franka_panda/panda.urdf", "panda_grasptarget"),
}
SWINGS = {
    "kuka": ([-0.9, 0.5, 0.0, -1.4, 0.0, 1.2, 0.0], [0.9, 0.6, 0.0, -1.3, 0.0, 1.2, 0.0]),
    "panda": ([-0.8, 0.2, 0.0, -1.9, 0.0, 2.1, 0.8], [0.8, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8]),
}
SLACK = AdaptSettings().sigma
"""m and rad by which a place may be missed and count as reached."""


class Arm:
    """A robot with swings, and its forward kinematics by PyBullet."""

    def __init__(self, name):
        file, tip = FILES[name]
        path = f"{pybullet_data.getDataPath()}/{file}"
        meshes = {"meshes": f"{pybullet_data.getDataPath()}/franka_panda/meshes"}
        self.robot = Robot.from_urdf(path, tip=tip, packages=meshes)
        right, left = SWINGS[name]
        phase = np.linspace(0.0, 1.0, 100)
        share = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
        bends = np.random.default_rng(0).normal(0.0, 0.12, (6, 7))
        self.swings = [
            right
            + np.outer(share, np.subtract(left, right))
            + np.outer(np.sin(np.pi * phase), bend)
            for bend in bends
        ]
        self.primitive = SMP.fit(self.swings, robot=self.robot)
        self.start = self.swings[0][0]
        self.client = pybullet.connect(pybullet.DIRECT)
        self.body = pybullet.loadURDF(path, useFixedBase=True, physicsClientId=self.client)
        infos = [
            pybullet.getJointInfo(self.body, i, physicsClientId=self.client)
            for i in range(pybullet.getNumJoints(self.body, physicsClientId=self.client))
        ]
        number = {info[1].decode(): info[0] for info in infos}
        self.numbers = [number[joint] for joint in self.robot.joints]
        (self.tip,) = (info[0] for info in infos if info[12].decode() == tip)

    def poses(self, configurations):
        """Return positions (N, 3) m and rotations of the tip in configurations (N, n) rad."""
        found = []
        for q in configurations:
            for index, angle in zip(self.numbers, q, strict=True):
                pybullet.resetJointState(self.body, index, angle, physicsClientId=self.client)
            found.append(
                pybullet.getLinkState(
                    self.body, self.tip, computeForwardKinematics=1, physicsClientId=self.client
                )
            )
        positions = np.array([state[4] for state in found])
        return positions, Rotation.from_quat([state[5] for state in found])

    def pose(self, configuration):
        positions, rotations = self.poses([configuration])
        return positions[0], rotations[0]


@pytest.fixture(scope="module", params=FILES)
def arm(request):
    made = Arm(request.param)
    yield made
    pybullet.disconnect(made.client)


@pytest.fixture(scope="module")
def kuka():
    made = Arm("kuka")
    yield made
    pybullet.disconnect(made.client)


def tilt(rotations, axis, direction):
    """Return angles (N,) rad between an axis of the tip and a direction."""
    return np.arccos(np.clip(rotations.apply(axis) @ np.array(direction), -1.0, 1.0))


def at(trajectories, phase):
    """Return the configurations (P, n) of trajectories (P, T, n) at a phase, straight between."""
    place = phase * (trajectories.shape[1] - 1)
    first = min(int(place), trajectories.shape[1] - 2)
    share = place - first
    return (1.0 - share) * trajectories[:, first] + share * trajectories[:, first + 1]


def test_the_tool_ends_in_a_cone(arm):
    place = arm.pose(arm.swings[0][-1])[0] + np.array([-0.03, -0.1, 0.1])
    point, half = np.array([0.01, 0.0, 0.05]), 0.02
    axis = np.array([0.6, 0.0, 0.8])
    goal = GoalRegion(point, place - half, place + half, Cone(axis, DOWN, 0.1))
    plan = arm.primitive.adapt(start=arm.start, goal=goal, particles=8)
    assert plan.good.sum() >= 6
    positions, rotations = arm.poses(plan.trajectories[plan.passing][:, -1])
    offset = np.abs(positions + rotations.apply(point) - place).max(axis=1)
    assert (offset < half + SLACK).all()
    assert (tilt(rotations, axis, DOWN) < 0.1 + SLACK).all()
    assert plan.missed["goal orientation"].shape == (8,)
    # The demonstrations do not end so.
    assert tilt(arm.pose(arm.swings[0][-1])[1], axis, DOWN) > 0.3


def test_the_tool_ends_with_a_fixed_orientation(arm):
    place, turn = arm.pose(arm.swings[0][-1])
    place, turn = (
        place + np.array([-0.03, -0.1, 0.1]),
        Rotation.from_euler("xz", (-0.2, -0.4)) * turn,
    )
    goal = GoalRegion(np.zeros(3), place, place, Orientation(turn.as_quat(), 0.02))
    plan = arm.primitive.adapt(start=arm.start, goal=goal, particles=8)
    assert plan.good.sum() >= 6
    positions, rotations = arm.poses(plan.trajectories[:, -1])
    away = np.linalg.norm(positions - place, axis=1)
    turned = np.maximum((rotations * turn.inv()).magnitude() - 0.02, 0.0)
    np.testing.assert_allclose(plan.missed["goal"], away, atol=1e-4)
    np.testing.assert_allclose(plan.missed["goal orientation"], turned, atol=1e-4)
    np.testing.assert_array_equal(plan.passing, (away <= SLACK) & (turned <= SLACK))
    # Without adaptation, too, conditioning brings most of them near.
    drawn = arm.primitive.adapt(start=arm.start, goal=goal, particles=8, method="promp")
    assert np.median(drawn.missed["goal orientation"]) < 0.05


@pytest.mark.parametrize("kind", ["free", "cone", "fixed"])
def test_the_tool_passes_a_place_with_an_orientation(arm, kind):
    phase = 0.43
    place, turn = arm.pose(at(np.array(arm.swings[:1]), phase)[0])
    place, turn = place + np.array([-0.05, 0.0, 0.1]), Rotation.from_euler("y", -0.2) * turn
    orientation = {
        "free": None,
        "cone": Cone(Z, (0.3, 0.0, -1.0), 0.08),
        "fixed": Orientation(turn.as_quat(), 0.05),
    }[kind]
    plan = arm.primitive.adapt(
        start=arm.start,
        goal=arm.swings[0][-1],
        via_points=ToolViaPoint(phase, np.zeros(3), place, 0.01, orientation),
        particles=8,
    )
    assert plan.good.sum() >= 6
    positions, rotations = arm.poses(at(plan.trajectories, phase)[plan.passing])
    assert (np.linalg.norm(positions - place, axis=1) < 0.01 + SLACK).all()
    if kind == "cone":
        direction = np.array([0.3, 0.0, -1.0]) / np.linalg.norm([0.3, 0.0, -1.0])
        assert (tilt(rotations, Z, direction) < 0.08 + SLACK).all()
    if kind == "fixed":
        assert ((rotations * turn.inv()).magnitude() < 0.05 + SLACK).all()
    assert ("via_points[0] orientation" in plan.missed) == (kind != "free")


def test_of_several_regions_either_will_do(kuka):
    place, turn = kuka.pose(kuka.swings[0][-1])
    up = place + np.array([0.0, -0.1, 0.15])
    out_of_reach = GoalRegion(np.zeros(3), place + 5.0, place + 5.1, Cone(Z, Z, 0.1))
    options = (
        GoalRegion(np.zeros(3), up - 0.02, up + 0.02, Cone(Z, (1.0, 0.0, -1.0), 0.2)),
        GoalRegion(np.zeros(3), place - 0.02, place + 0.02, Orientation(turn.as_quat(), 0.1)),
        out_of_reach,
    )
    plan = kuka.primitive.adapt(start=kuka.start, goal=AnyOf(options), particles=8)
    assert plan.good.sum() >= 6
    assert set(plan.signatures[:, 0]) <= {0, 1}
    vias = [ToolViaPoint(0.5, np.zeros(3), p, 0.02, Cone(Z, DOWN, 0.5)) for p in (place, up)]
    plan = kuka.primitive.adapt(via_points=AnyOf(vias), particles=8)
    assert plan.passing.sum() >= 7


def test_costs_alone_lead_there_too(kuka):
    place = kuka.pose(kuka.swings[0][-1])[0]
    goal = GoalRegion(np.zeros(3), place - 0.05, place + 0.05, Cone(Z, (0.4, 0.0, -1.0), 0.2))
    soft = AdaptSettings(modulation="likelihood")
    before = kuka.primitive.adapt(goal=goal, settings=soft, particles=8, method="promp")
    after = kuka.primitive.adapt(goal=goal, settings=soft, particles=8)
    assert after.passing.sum() > before.passing.sum()


def test_the_message_says_what_binds(kuka):
    place = kuka.pose(kuka.swings[0][-1])[0]

    def refused(region):
        with pytest.raises(ValueError, match=r"goal .* is out of reach: the arm stays") as caught:
            kuka.primitive.adapt(start=kuka.start, goal=region)
        return str(caught.value)

    far = place + np.array([0.0, 5.0, 0.0])
    said = refused(GoalRegion(np.zeros(3), far, far, Cone(Z, Z, 0.1)))
    # KUKA's arm reaches about a metre from its shoulder.
    away = float(said.partition("stays ")[2].partition(" m")[0])
    assert away == pytest.approx(np.linalg.norm(far - (0.0, 0.0, 0.36)) - 0.9, abs=0.15)
    assert "with the orientation free it is out of reach, too" in said
    # Near full stretch sideways, the hand can not point back at the base.
    stretched = np.array([0.0, 1.1, 0.36])
    reachable = GoalRegion(np.zeros(3), stretched - 0.3, stretched - 0.2)
    assert kuka.primitive.adapt(goal=reachable, particles=2, method="promp").passing.shape == (2,)
    edge = np.array([0.0, 0.8, 0.36])
    said = refused(GoalRegion(np.zeros(3), edge, edge, Cone(Z, (0.0, -1.0, 0.0), 0.05)))
    assert "rad too far" in said
    assert said.endswith("with the orientation free it is within reach")


def test_bad_tasks_are_named(kuka):
    place = np.array([0.5, 0.0, 0.5])
    via = ToolViaPoint(0.5, np.zeros(3), place, 0.01)
    other = ToolViaPoint(0.5, np.zeros(3), place + 0.2, 0.01)
    late = ToolViaPoint(0.7, np.zeros(3), place, 0.01)
    for arguments, named in (
        ({"via_points": [AnyOf([via, ViaPoint(0.5, kuka.start)])]}, "must be a ViaPoint, a Tool"),
        ({"via_points": AnyOf([via, late])}, r"options of one phase, got \[0.5, 0.7\]"),
        ({"via_points": [via, other]}, r"via_points\[0\] and via_points\[1\] contradict"),
        ({"goal": via}, "goal must be a point, a Box or AnyOf of such"),
        ({"start": via}, "start must be a point, a Box or AnyOf of such"),
        (
            {
                "goal": GoalRegion(np.zeros(3), place, place, Cone(Z, Z, 0.1)),
                "via_points": ToolViaPoint(1.0, np.zeros(3), place + 0.1, 0.01),
            },
            r"goal and via_points\[0\] contradict",
        ),
    ):
        with pytest.raises(ValueError, match=named):
            kuka.primitive.adapt(**arguments)
    plane = SMP.fit(np.random.default_rng(0).normal(size=(3, 20, 2)).cumsum(axis=1))
    with pytest.raises(ValueError, match=r"via_points\[0\] is for a tool, but .* no robot"):
        plane.adapt(via_points=via)


def test_a_whole_sphere_of_orientations_is_a_free_one(kuka):
    place = kuka.pose(kuka.swings[0][-1])[0]
    region = GoalRegion(np.zeros(3), place - 0.02, place + 0.02, Cone(Z, Z, math.pi))
    plan = kuka.primitive.adapt(start=kuka.start, goal=region, particles=8)
    assert plan.good.all()
    assert not plan.missed["goal orientation"].any()
