"""RRT-Connect with places and orientations of the tool, by PyBullet's forward kinematics."""

import re

import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from smp_gym.scene import Obstacle
from smp_planner import (
    SMP,
    AdaptSettings,
    AnyOf,
    Box,
    Cone,
    GoalRegion,
    Orientation,
    ToolViaPoint,
    ViaPoint,
)
from smp_planner.experiments.public_arms import PUBLIC_ARMS, swings
from smp_planner.planners.rrt_connect.planner import RRTConnectSettings
from smp_planner.planning.tool_postures import drawn_postures

TOOL = np.zeros(3)
SLACK = AdaptSettings().sigma
"""m and rad by which a place may be missed and count as reached."""


class Arm:
    """A public arm with swings, and its forward kinematics by PyBullet."""

    def __init__(self, name, folder):
        public = PUBLIC_ARMS[name]
        self.robot = public.robot(0.03)
        ready = np.array(public.ready)
        right, left = ready.copy(), ready.copy()
        right[0], left[0] = -0.7, 0.7
        self.ready, self.left = ready, left
        self.primitive = SMP.fit(swings(right, left, np.random.default_rng(0)), robot=self.robot)
        self.start = self.primitive.demonstrations[0][0]
        self.client = BulletClient(pybullet.DIRECT)
        # Kinematics needs no meshes, which PyBullet would not find.
        bare = re.sub(r"(?s)<(visual|collision)>.*?</\1>", "", public.path().read_text())
        (folder / "bare.urdf").write_text(bare)
        self.body = self.client.loadURDF(str(folder / "bare.urdf"), useFixedBase=True)
        count = self.client.getNumJoints(self.body)
        infos = [self.client.getJointInfo(self.body, index) for index in range(count)]
        number = {info[1].decode(): info[0] for info in infos}
        self.numbers = [number[joint] for joint in self.robot.joints]
        (self.tip,) = (info[0] for info in infos if info[12].decode() == public.tip)

    def poses(self, configurations):
        """Return positions (N, 3) m and rotations of the tip in configurations (N, n) rad."""
        found = []
        for q in configurations:
            for index, angle in zip(self.numbers, q, strict=True):
                self.client.resetJointState(self.body, index, angle)
            found.append(self.client.getLinkState(self.body, self.tip, computeForwardKinematics=1))
        return np.array([state[4] for state in found]), Rotation.from_quat(
            [state[5] for state in found]
        )

    def region(self, q, orientation=None, half=0.01):
        ((place,), _) = self.poses(q[None])
        return GoalRegion(TOOL, place - half, place + half, orientation)

    def turned(self, q):
        return self.poses(q[None])[1].as_quat()[0]


@pytest.fixture(scope="module", params=["ur5", "panda"])
def arm(request, tmp_path_factory):
    try:
        PUBLIC_ARMS[request.param].path()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    made = Arm(request.param, tmp_path_factory.mktemp(request.param))
    yield made
    made.client.disconnect()


def at(trajectories, phase):
    """Return the configurations (P, n) rad of trajectories at a phase."""
    times = np.linspace(0.0, 1.0, trajectories.shape[1])
    return np.array([[np.interp(phase, times, q) for q in path.T] for path in trajectories])


def check(arm, places, configurations):
    """Check that the tool has one of several places, with its orientation."""
    positions, rotations = arm.poses(configurations)
    fits = np.zeros((len(places), len(positions)), bool)
    for index, place in enumerate(places):
        if isinstance(place, ToolViaPoint):
            away = np.linalg.norm(positions - place.position, axis=1) - place.tolerance
        else:
            away = np.linalg.norm(positions - np.clip(positions, place.lower, place.upper), axis=1)
        fits[index] = away <= SLACK
        wanted = place.orientation
        if isinstance(wanted, Cone):
            cosine = rotations.apply(wanted.axis) @ wanted.direction
            fits[index] &= np.arccos(np.clip(cosine, -1.0, 1.0)) <= wanted.angle + SLACK
        elif wanted is not None:
            angle = (Rotation.from_quat(wanted.quaternion).inv() * rotations).magnitude()
            fits[index] &= angle <= wanted.tolerance + SLACK
    assert fits.any(axis=0).all()
    return fits


def asked(arm, kind):
    """Return a goal of a kind."""
    turn = arm.turned(arm.left)
    down = Rotation.from_quat(turn).apply((0.0, 0.0, 1.0))
    return {
        "fixed": arm.region(arm.left, Orientation(turn, 0.1)),
        "exact": arm.region(arm.left, Orientation(turn, 0.0), half=0.0),
        "cone": arm.region(arm.left, Cone((0.0, 0.0, 1.0), down, 0.2)),
        "free": arm.region(arm.left),
        "choice": AnyOf(
            [
                arm.region(arm.left, Orientation(turn, 0.1)),
                arm.region(arm.ready, Orientation(arm.turned(arm.ready), 0.1)),
            ]
        ),
    }[kind]


@pytest.mark.parametrize("kind", ["fixed", "exact", "cone", "free", "choice"])
def test_goals_of_the_tool_are_reached_as_those_of_smp(arm, kind):
    """Both methods have one goal and pass one check; PyBullet says the same."""
    goal = asked(arm, kind)
    options = goal.options if isinstance(goal, AnyOf) else [goal]
    for method in ("rrt_connect", "smp"):
        plan = arm.primitive.adapt(start=arm.start, goal=goal, particles=4, method=method)
        assert plan.good.any()
        check(arm, options, plan.trajectories[plan.passing][:, -1])
        np.testing.assert_allclose(plan.trajectories[:, 0], np.tile(arm.start, (4, 1)), atol=SLACK)
        if kind != "free":
            assert (plan.missed["goal orientation"][plan.passing] <= SLACK).all()
        model = arm.robot.model
        assert (plan.trajectories[plan.good] >= model.lower - 1e-6).all()
        assert (plan.trajectories[plan.good] <= model.upper + 1e-6).all()


def test_both_places_of_a_choice_are_sought(arm):
    goal = asked(arm, "choice")
    rng = np.random.default_rng(0)
    found = drawn_postures("goal", goal.options, arm.primitive.robot.model, arm.start, 64, rng)
    fits = check(arm, goal.options, found)
    assert (fits.sum(axis=1) > 3).all()


def test_postures_are_of_several_branches_and_exact(arm):
    model = arm.primitive.robot.model
    goal = asked(arm, "exact")
    found = drawn_postures("goal", [goal], model, arm.start, 48, np.random.default_rng(0))
    positions, rotations = arm.poses(found)
    turns = Rotation.from_quat(goal.orientation.quaternion).inv() * rotations
    assert np.linalg.norm(positions - goal.center, axis=1).max() < 2e-3
    assert turns.magnitude().max() < 2e-3
    assert (found >= model.lower).all()
    assert (found <= model.upper).all()
    apart = np.abs(found[:, None] - found).max(axis=-1)
    assert apart.max() > 1.0


@pytest.fixture(scope="module")
def through(arm):
    """Via-points above and beside the straight way, each with an orientation."""
    (ready,), _ = arm.poses(arm.ready[None])
    turn = arm.turned(arm.ready)
    down = Rotation.from_quat(turn).apply((0.0, 0.0, 1.0))
    return [
        ToolViaPoint(
            0.35, TOOL, ready + np.array([-0.05, -0.1, 0.02]), 0.02, Orientation(turn, 0.3)
        ),
        ToolViaPoint(
            0.7, TOOL, ready + np.array([0.0, 0.1, 0.05]), 0.02, Cone((0, 0, 1), down, 0.3)
        ),
    ]


def test_via_points_of_the_tool_are_passed_at_their_phases(arm, through):
    goal = asked(arm, "fixed")
    plan = arm.primitive.adapt(
        start=arm.start, via_points=through, goal=goal, particles=4, method="rrt_connect"
    )
    assert plan.good.any()
    for via in through:
        check(arm, [via], at(plan.trajectories[plan.good], via.phase))
    check(arm, [goal], plan.trajectories[plan.good][:, -1])


def test_via_points_of_joints_and_boxes_are_passed_too(arm):
    half = np.full(arm.robot.dimension, 0.05)
    goal = Box(arm.left - half, arm.left + half)
    raised = arm.ready + 0.1
    plan = arm.primitive.adapt(
        start=arm.start,
        via_points=[ViaPoint(0.5, raised)],
        goal=goal,
        particles=4,
        method="rrt_connect",
    )
    assert plan.good.any()
    good = plan.trajectories[plan.good]
    np.testing.assert_allclose(at(good, 0.5), np.tile(raised, (len(good), 1)), atol=0.01)
    assert (np.abs(good[:, -1] - arm.left) <= half + 1e-9).all()


def test_obstacles_are_kept_clear_of_and_plans_come_again(arm):
    (middle,), _ = arm.poses(arm.ready[None])
    pole = Obstacle(shape="cylinder", position=tuple(middle), size=(0.04, 0.04, 0.2))
    arguments = {"start": arm.start, "goal": asked(arm, "fixed"), "particles": 4}
    search = RRTConnectSettings(iterations=10_000, postures=48)
    first, again = (
        arm.primitive.adapt([pole], **arguments, method=search, seed=3) for _ in range(2)
    )
    other = arm.primitive.adapt([pole], **arguments, method=search, seed=4)
    assert first.good.any()
    assert (first.clearance[first.good] > 0.0).all()
    np.testing.assert_array_equal(first.trajectories, again.trajectories)
    assert not np.array_equal(first.trajectories, other.trajectories)


def test_a_plan_says_what_no_posture_is_free_for(arm, through):
    goal = asked(arm, "fixed")
    arguments = {"start": arm.start, "goal": goal, "particles": 2, "method": "rrt_connect"}
    ball = {"shape": "sphere", "size": (0.08, 0.08, 0.08)}
    blocked = arm.primitive.adapt([Obstacle(position=tuple(goal.center), **ball)], **arguments)
    assert not blocked.good.any()
    assert re.match(r"0 of 2 searches .* 0 of \d+ configurations at the goal", blocked.message)
    via = through[1]
    blocked = arm.primitive.adapt(
        [Obstacle(position=tuple(via.position), **ball)], **arguments, via_points=via
    )
    assert not blocked.good.any()
    assert re.search(r"and 0 of \d+ at phase 0\.7", blocked.message)


def test_what_is_out_of_reach_is_an_error_as_for_smp(arm):
    far = GoalRegion(TOOL, (5.0, 0.0, 0.0), (5.1, 0.1, 0.1), Orientation((0, 0, 0, 1), 0.1))
    for method in ("rrt_connect", "smp"):
        with pytest.raises(ValueError, match=r"goal .* is out of reach: the arm stays"):
            arm.primitive.adapt(start=arm.start, goal=far, method=method)


def test_what_a_search_does_not_keep_is_refused(arm, through):
    goal, first = asked(arm, "fixed"), through[0]
    whole = {"start": arm.start, "goal": goal, "method": "rrt_connect"}
    other = ToolViaPoint(first.phase, (0.0, 0.0, 0.1), first.position, 0.2)
    for changes, message in (
        ({"start": None}, "start must be given for a search for paths, got none"),
        ({"start": AnyOf([arm.start, arm.ready])}, "start must be one configuration"),
        ({"start": Box(arm.start - 0.1, arm.start)}, "start must be one configuration"),
        ({"goal": None}, "goal must be given for a search for paths"),
        ({"via_points": [first, other]}, "must be the one constraint of phase 0.35"),
        ({"via_points": [ViaPoint(0.001, arm.ready)]}, "at least 0.00503 apart .* 0.001 is not"),
        (
            {"via_points": [ViaPoint(0.5, arm.ready), ViaPoint(0.501, arm.start)]},
            "got 0.5, 0.501, 1, of which 0.501 is not",
        ),
        ({"start_velocity": arm.start}, "start_velocity must be None for the method"),
        ({"per_component": False}, "per_component must be True for the method"),
        ({"deadline": 1.0}, "deadline must be None for the method"),
        ({"history": 5}, "history must be None for the method"),
    ):
        with pytest.raises(ValueError, match=message):
            arm.primitive.adapt(**{**whole, **changes})


def test_paths_without_a_robot_are_refused():
    paths = [np.stack([np.linspace(0, 1, 50), k * np.ones(50)], axis=1) for k in (0.0, 0.1, 0.2)]
    with pytest.raises(ValueError, match="'rrt_connect' needs a primitive of a robot"):
        SMP.fit(paths).adapt(goal=(1.0, 0.1), method="rrt_connect")
