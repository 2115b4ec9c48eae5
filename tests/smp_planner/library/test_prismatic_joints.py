"""Robots with prismatic joints: kinematics and collisions against PyBullet, limits and units."""

import json

import numpy as np
import pybullet
import pytest
import torch

from smp_gym.assets import asset_path
from smp_gym.scene import Obstacle
from smp_planner.collision.autograd import by_autograd, map_collision, self_collision
from smp_planner.collision.clearance_in_time import clearance_in_time
from smp_planner.collision.clearances import SphereClearances
from smp_planner.collision.costs import CollisionCost, SelfCollisionCost
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.forecast import Forecast
from smp_planner.collision.moving_cost import MovingCollisionCost
from smp_planner.collision.verification import check_collisions
from smp_planner.library.collision_pairs import with_collision_pairs
from smp_planner.library.smp import SMP, AdaptSettings, GoalRegion, Robot
from smp_planner.occupancy.archive import read_archive
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.robot_body import RobotBody, reachable_box
from smp_planner.planning.tool_box_cost import ToolBoxCost

ROLL = "0 0 0"


def link(name, geometry="", origin="0 0 0", turn=ROLL):
    solid = f'<collision><origin xyz="{origin}" rpy="{turn}"/><geometry>{geometry}</geometry>'
    return f'<link name="{name}">{solid + "</collision>" if geometry else ""}</link>'


def joint(name, kind, parent, child, origin, axis, limit, turn=ROLL):
    lower, upper, velocity = limit
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}" rpy="{turn}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="1"/></joint>'
    )


def bar(length):
    return f'<cylinder radius="0.05" length="{length}"/>'


TURN = (-3.0, 3.0, 2.0)

# Offsets and lengths about those of a UR5, on a carriage that slides 2.4 m along x.
ARM = (
    joint("shoulder", "revolute", "carriage", "column", "0 0 0.09", "0 0 1", TURN)
    + link("column", bar(0.14))
    + joint("lift", "revolute", "column", "upper", "0 0.136 0", "0 1 0", TURN, "0 1.57 0")
    + link("upper", bar(0.42), "0 0 0.21")
    + joint("elbow", "revolute", "upper", "fore", "0 -0.12 0.425", "0 1 0", TURN)
    + link("fore", bar(0.39), "0 0 0.2")
    + joint("wrist_1", "revolute", "fore", "wrist_a", "0 0 0.392", "0 1 0", TURN, "0 1.57 0")
    + link("wrist_a", '<sphere radius="0.045"/>')
    + joint("wrist_2", "revolute", "wrist_a", "wrist_b", "0 0.093 0", "0 0 1", TURN)
    + link("wrist_b", '<sphere radius="0.045"/>')
    + joint("wrist_3", "revolute", "wrist_b", "tool", "0 0 0.095", "0 1 0", TURN)
    + link("tool", '<box size="0.06 0.12 0.06"/>', "0 0.05 0")
)
CHAINS = {
    "rail": (
        link("ground", '<box size="2.8 0.2 0.1"/>', "1.2 0 -0.2")
        + joint("rail", "prismatic", "ground", "carriage", "0 0 0", "1 0 0", (0.0, 2.4, 0.8))
        + link("carriage", '<box size="0.2 0.2 0.06"/>')
        + ARM
    ),
    # A lift turned about a post and tilted, a boom that reaches out, a joint beyond it.
    "lift": (
        link("ground")
        + joint("post", "revolute", "ground", "mast", "0.1 0 0.2", "0 0 1", TURN, "0.1 0.2 0")
        + link("mast", bar(0.6), "0 0 0.3")
        + joint("lift", "prismatic", "mast", "sledge", "0.1 0 0.2", "0 0.28 0.96", (-0.1, 0.5, 0.2))
        + link("sledge", '<box size="0.1 0.1 0.1"/>')
        + joint("boom", "prismatic", "sledge", "arm", "0.1 0 0", "0.96 0 0.28", (0.0, 0.4, 0.3))
        + link("arm", bar(0.3), "0.1 0 0", "0 1.57 0")
        + joint("tilt", "revolute", "arm", "tool", "0.3 0 0", "0 1 0", TURN, "0 0.3 0")
        + link("tool", '<box size="0.1 0.06 0.2"/>', "0 0 0.1")
    ),
    "gantry": (
        link("ground")
        + joint("x", "prismatic", "ground", "bridge", "-0.5 0 1", "1 0 0", (0.0, 1.0, 0.5))
        + link("bridge", '<box size="0.06 1.2 0.06"/>', "0 0.5 0")
        + joint("y", "prismatic", "bridge", "trolley", "0 0 0.02", "0 1 0", (0.0, 1.0, 0.4))
        + link("trolley", '<box size="0.1 0.1 0.1"/>')
        + joint("z", "prismatic", "trolley", "tool", "0.08 0 0", "0 0 -1", (0.0, 0.6, 0.3))
        + link("tool", '<box size="0.04 0.04 0.3"/>', "0 0 -0.1")
    ),
}


class Twin:
    """The same URDF in PyBullet, in a client of its own."""

    def __init__(self, path, robot):
        self.client = pybullet.connect(pybullet.DIRECT)
        flags = pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
        self.body = pybullet.loadURDF(
            str(path), useFixedBase=True, flags=flags, physicsClientId=self.client
        )
        count = pybullet.getNumJoints(self.body, physicsClientId=self.client)
        infos = [
            pybullet.getJointInfo(self.body, index, physicsClientId=self.client)
            for index in range(count)
        ]
        names = {info[1].decode(): info[0] for info in infos}
        self.joints = [names[name] for name in robot.joints]
        self.tip = next(info[0] for info in infos if info[12].decode() == "tool")

    def pose(self, configuration):
        """Return position (3,) and quaternion (4,) of the tool's frame."""
        for index, position in zip(self.joints, configuration, strict=True):
            pybullet.resetJointState(self.body, index, position, physicsClientId=self.client)
        state = pybullet.getLinkState(
            self.body, self.tip, computeForwardKinematics=True, physicsClientId=self.client
        )
        return np.array(state[4]), np.array(state[5])

    def jacobian(self, configuration):
        """Return the derivatives (6, n) of position and turn of the tool's frame."""
        self.pose(configuration)
        state = pybullet.getLinkState(self.body, self.tip, physicsClientId=self.client)
        zeros = [0.0] * len(self.joints)
        # The point is asked for from the centre of mass.
        found = pybullet.calculateJacobian(
            self.body,
            self.tip,
            pybullet.invertTransform(state[2], state[3])[0],
            list(configuration),
            zeros,
            zeros,
            physicsClientId=self.client,
        )
        return np.concatenate([np.array(part) for part in found])

    def gap(self, path, obstacle):
        """Return the least distance, m up to 1, of a path (T, n) to a box."""
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=obstacle.size, physicsClientId=self.client
        )
        body = pybullet.createMultiBody(
            0.0, shape, -1, obstacle.position, physicsClientId=self.client
        )
        least = 1.0
        for configuration in path:
            self.pose(configuration)
            near = pybullet.getClosestPoints(self.body, body, 1.0, physicsClientId=self.client)
            least = min([least, *(point[8] for point in near)])
        pybullet.removeBody(body, physicsClientId=self.client)
        return least


@pytest.fixture(scope="module", params=list(CHAINS))
def pair(request, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / "robot.urdf"
    path.write_text(f'<robot name="{request.param}">{CHAINS[request.param]}</robot>')
    robot = Robot.from_urdf(path, "tool", overshoot=0.03)
    twin = Twin(path, robot)
    yield robot, twin
    pybullet.disconnect(twin.client)


def drawn(robot, count, seed=0):
    model = robot.model
    return np.random.default_rng(seed).uniform(model.lower, model.upper, (count, robot.dimension))


def paired(robot):
    """Return the model with pairs of spheres, and the robot's paths (P, T, n) within limits."""
    starts, ends = drawn(robot, 4, 1)[:, None], drawn(robot, 4, 2)[:, None]
    paths = starts + np.linspace(0.0, 1.0, 30)[None, :, None] * (ends - starts)
    return with_collision_pairs(robot, list(paths)), paths


def crossed(robot, path):
    """Return a box around where the tool passes on its way."""
    x, y, z = robot.tool_positions(path)[len(path) // 2]
    return Obstacle(shape="box", position=(x, y, z), size=(0.08, 0.1, 0.06))


def test_the_cost_of_the_tool_has_the_gradient_of_its_finite_differences(pair):
    robot, _ = pair
    _, paths = paired(robot)
    places = robot.tool_positions(drawn(robot, 2, 3))
    points = np.array([[0.0, 0.0, 0.1], [0.02, -0.03, 0.0]])
    for options in (None, np.array([0.0, -0.5])):
        cost = ToolBoxCost(
            robot.model, points, (0.4, 1.0), places - 0.05, places + 0.05, 0.3, options
        )
        direction = np.random.default_rng(4).normal(size=paths.shape)
        above, below = (cost(paths + sign * 1e-6 * direction)[0] for sign in (1.0, -1.0))
        value, gradient = cost(paths)
        slope = (gradient * direction).sum(axis=(1, 2))
        assert (value > -1.0).all()
        np.testing.assert_allclose(slope, (above - below) / 2e-6, rtol=1e-5, atol=1e-5)


def test_tool_and_jacobian_are_those_of_pybullet(pair):
    robot, twin = pair
    for q in drawn(robot, 20):
        position, quaternion = twin.pose(q)
        np.testing.assert_allclose(robot.tool_positions(q), position, atol=1e-5)
        turn = robot.tool_quaternions(q)
        assert abs(turn @ quaternion) == pytest.approx(1.0, abs=1e-6)
        expected = twin.jacobian(q)
        np.testing.assert_allclose(
            robot.model.carried_points(q, np.zeros(3))[1], expected[:3], atol=1e-5
        )
        np.testing.assert_allclose(robot.model.tool_rotations(q)[1], expected[3:], atol=1e-5)


def test_units_and_limits_are_those_of_the_joints(pair):
    robot, _ = pair
    slides = {"rail", "boom", "x", "y", "z"} | ({"lift"} if "post" in robot.joints else set())
    for name, unit, lower in zip(robot.joints, robot.units, robot.model.lower, strict=True):
        assert unit == ("m" if name in slides else "rad")
        assert (lower == -3.0) == (unit == "rad")
    assert not robot.model.endless.any()


def test_compiled_poses_are_those_of_autograd(pair):
    robot, _ = pair
    q = drawn(robot, 70, 3)
    points, jacobians = robot.model.carried_points(q, np.array([0.02, 0.03, 0.1]))
    end = torch.from_numpy(robot.model.carried([0.02, 0.03, 0.1]))

    def of(configurations):
        poses = robot.model.link_transforms(configurations)[..., -1, :, :]
        return poses[..., :3, :3] @ end + poses[..., :3, 3]

    np.testing.assert_allclose(of(torch.from_numpy(q)).numpy(), points, atol=1e-12)
    for number in (0, 40):
        expected = torch.autograd.functional.jacobian(of, torch.from_numpy(q[number]))
        np.testing.assert_allclose(jacobians[number], expected, atol=1e-12)


def test_costs_and_gradients_are_those_of_autograd(pair):
    robot, _ = pair
    model, paths = paired(robot)
    box = crossed(robot, paths[0])
    cost = RobotBody(model).obstacle_cost((box,), None, SceneMaps(AdaptSettings(), 0))
    assert isinstance(cost, CollisionCost)
    value, gradient = cost(paths, 0.05, 0.01)
    given = torch.from_numpy(paths)
    expected, slope = by_autograd(lambda q: map_collision(cost, q, 0.05, 0.01), given)
    assert expected.max() > 0.1
    np.testing.assert_allclose(value, expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(gradient, slope, rtol=1e-2, atol=1e-2 * np.abs(slope).max())
    if len(model.collision_pairs):
        own = SelfCollisionCost(model, edge_width=0.05)
        value, gradient = own(paths)
        expected, slope = by_autograd(lambda q: self_collision(own, q), given)
        assert expected.max() > 1e-3
        np.testing.assert_allclose(value, expected, rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(gradient, slope, rtol=1e-2, atol=1e-3 * np.abs(slope).max())


def test_clearances_have_the_slopes_of_finite_differences(pair):
    robot, _ = pair
    model, paths = paired(robot)
    box = crossed(robot, paths[0])
    cost = RobotBody(model).obstacle_cost((box,), None, SceneMaps(AdaptSettings(), 0))
    clearances = SphereClearances(model, cost.grid)
    q = paths[0, 10:20]
    weights = np.random.default_rng(0).uniform(size=clearances(q).shape)
    found = clearances.pull_back(q, weights)
    step = 1e-6
    for joint_number in range(robot.dimension):
        change = step * np.eye(robot.dimension)[joint_number]
        ahead, behind = (
            (weights * clearances(q + sign * change)).sum(axis=1) for sign in (1.0, -1.0)
        )
        expected = (ahead - behind) / (2.0 * step)
        scale = max(np.abs(found).max(), 1e-3)
        np.testing.assert_allclose(found[:, joint_number], expected, atol=2e-2 * scale)


def test_bodies_that_move_push_along_a_slide(pair):
    robot, _ = pair
    model, paths = paired(robot)
    box = crossed(robot, paths[0])
    moving = Obstacle(shape="box", position=box.position, size=box.size, velocity=(0.02, 0.0, 0.0))
    forecast = Forecast((moving,), np.zeros((1, 3)), 1.0, 0.1, 0.02)
    cost = MovingCollisionCost(model, forecast)
    times = np.tile(np.linspace(0.0, 1.0, paths.shape[1]), (len(paths), 1))
    _, gradient = cost(paths, times, 0.05)
    direction = np.random.default_rng(4).normal(size=paths.shape)
    step = 1e-6
    ahead, behind = (cost(paths + s * step * direction, times, 0.05)[0] for s in (1.0, -1.0))
    expected = (ahead - behind) / (2.0 * step)
    assert np.abs(expected).max() > 1e-2
    found = (gradient * direction).sum(axis=(1, 2))
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


def dense(paths, count=601):
    """Return paths (P, count, n) with samples between those given."""
    at = np.linspace(0.0, paths.shape[1] - 1.0, count)
    steps = np.arange(paths.shape[1])
    return np.stack(
        [np.stack([np.interp(at, steps, column) for column in path.T], axis=1) for path in paths]
    )


@pytest.mark.parametrize("stretch", [1.0, 3.0])
def test_checks_between_samples_hold_for_all_of_the_way(pair, stretch):
    """Also beyond the limits, where what slides is farther from the joints before it."""
    robot, _ = pair
    model, paths = paired(robot)
    middle = (model.lower + model.upper) / 2
    few = middle + stretch * (paths[:, ::10] - middle)
    many = dense(few)
    obstacles = (crossed(robot, few[0]), crossed(robot, few[1][:1]))
    found = check_collisions(few, model, obstacles)
    centers = model.sphere_centers(torch.from_numpy(many)).numpy()
    moves = model.link > 0
    gap = np.full(many.shape[:2], np.inf)
    for obstacle in obstacles:
        outside = np.abs(centers[..., moves, :] - obstacle.position) - obstacle.size
        distance = np.linalg.norm(np.maximum(outside, 0.0), axis=-1)
        distance += np.minimum(outside.max(axis=-1), 0.0)
        gap = np.minimum(gap, (distance - model.radius[moves]).min(axis=-1))
    assert (found.clearance <= gap.min(axis=1) + 1e-3).all()
    assert (found.clearance >= gap.min(axis=1) - 1e-2).all()
    pairs = model.collision_pairs
    if len(pairs):
        some = centers[:, ::10]
        apart = np.linalg.norm(some[..., pairs[:, 0], :] - some[..., pairs[:, 1], :], axis=-1)
        own = (apart - model.radius[pairs].sum(axis=1)).min(axis=(1, 2))
        assert not found.self_free[own < 0.0].any()
    still = Forecast(obstacles, np.zeros((2, 3)), 0.0, 0.0, 0.0)
    times = np.tile(np.linspace(0.0, 1.0, few.shape[1]), (len(few), 1))
    in_time = clearance_in_time(few, times, model, still)
    assert (np.minimum(in_time, 0.05) <= np.minimum(gap.min(axis=1), 0.05) + 1.1e-3).all()
    free = EdgeChecker(model, obstacles).edges_free(few[:, 0], few[:, 1])
    first = gap[:, : many.shape[1] // (few.shape[1] - 1)].min(axis=1)
    assert not free[first < 0.0].any()


def test_levers_and_reach_hold_for_what_slides(pair):
    robot, _ = pair
    model = robot.model
    q = drawn(robot, 300, 5)
    corners = np.where(np.random.default_rng(6).random(q.shape) < 0.5, model.lower, model.upper)
    q = np.concatenate([q, corners])
    given = torch.from_numpy(q)
    centers = model.sphere_centers(given)
    lower, upper = (np.array(corner) for corner in reachable_box(model))
    moves = model.link > 0
    reach = model.radius[moves][:, None]
    assert (centers.numpy()[:, moves] - reach >= lower - 1e-9).all()
    assert (centers.numpy()[:, moves] + reach <= upper + 1e-9).all()
    step = 1e-6
    for joint_number in range(robot.dimension):
        ahead = model.sphere_centers(given + step * torch.eye(robot.dimension)[joint_number])
        speed = torch.linalg.vector_norm(ahead - centers, dim=-1).numpy() / step
        assert (speed <= model.levers[:, joint_number] + 1e-5).all()


def test_pairs_that_slide_past_each_other_are_not_left_out(pair):
    robot, _ = pair
    model, _ = paired(robot)
    pairs, gaps = model.link_pairs.pairs, model.least_gaps
    centers = model.sphere_centers(torch.from_numpy(drawn(robot, 500, 7))).numpy()
    apart = np.linalg.norm(centers[:, pairs[:, 0]] - centers[:, pairs[:, 1]], axis=-1)
    assert (gaps <= apart.min(axis=0, initial=9.0) - model.radius[pairs].sum(axis=1) + 1e-9).all()


def swings(robot, start, end, count=6, seed=0, spread=0.05):
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, 60)[:, None]
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    bend = (
        spread * (robot.model.upper - robot.model.lower) * rng.normal(size=(count, 1, len(start)))
    )
    paths = start + share * (np.subtract(end, start)) + np.sin(np.pi * share) * bend
    return np.clip(paths, robot.model.lower, robot.model.upper)


def test_a_plan_moves_the_rail_and_is_free_for_pybullet(tmp_path):
    path = tmp_path / "rail.urdf"
    path.write_text(f'<robot name="rail">{CHAINS["rail"]}</robot>')
    robot = Robot.from_urdf(path, "tool", overshoot=0.03)
    twin = Twin(path, robot)
    arm = np.array([0.0, -1.2, 1.4, -0.2, 0.3, 0.0])
    start, end = np.append(0.3, arm), np.append(2.0, np.add(arm, [0.4, 0.2, -0.2, 0.0, 0.0, 0.0]))
    demonstrations = swings(robot, start, end, spread=0.02)
    primitive = SMP.fit(list(demonstrations), robot=robot)
    np.testing.assert_allclose(primitive.settings.smooth_std, [0.2, *[0.2] * 6])
    box = crossed(robot, demonstrations[0])
    mean = demonstrations.mean(axis=0)
    assert twin.gap(mean, box) < 0.0
    there = robot.tool_positions(end)
    plan = primitive.adapt(
        [box],
        start=start,
        goal=GoalRegion(np.zeros(3), there - 0.02, there + 0.02),
        particles=16,
        seed=1,
    )
    assert plan.good.any()
    for index in np.flatnonzero(plan.good)[:3]:
        way = plan.trajectories[index]
        assert twin.gap(way[::2], box) > 0.0
        np.testing.assert_allclose(twin.pose(way[-1])[0], there, atol=0.0201)
        # The arm alone would reach from -0.9 m to 0.9 m about its carriage.
        assert way[-1, 0] > 1.0
        assert (way >= robot.model.lower - 1e-6).all()
        assert (way <= robot.model.upper + 1e-6).all()
    with pytest.raises(ValueError, match="acceleration must have one entry for each joint"):
        robot.timed(plan.best, acceleration=2.0)
    motion = robot.timed(plan.best, [1.0, *[3.0] * 6], jerk=[10.0, *[30.0] * 6])
    assert (np.abs(motion.velocities) <= robot.model.velocity * (1.0 + 1e-6)).all()
    assert (np.abs(motion.accelerations) <= np.array([1.0, *[3.0] * 6]) * (1.0 + 1e-6)).all()
    speeds = np.abs(np.diff(motion.positions[:, 0])) / np.diff(motion.times)
    assert speeds.max() <= 0.8 + 1e-6
    titles = [axes.get_title() for axes in plan.plot_joints().axes]
    assert titles[:2] == ["rail, m", "shoulder, rad"]
    primitive.save(tmp_path / "primitive.npz")
    again = SMP.load(tmp_path / "primitive.npz")
    assert again.robot.units == robot.units
    same, expected = (
        each.adapt([box], start=start, goal=end, particles=4, method="promp")
        for each in (again, primitive)
    )
    np.testing.assert_array_equal(same.trajectories, expected.trajectories)
    pybullet.disconnect(twin.client)


FIRST = {"format": "smp_planner.primitive", "version": 1}


def test_files_are_refused_by_readers_that_know_revolute_joints_alone(pair, tmp_path):
    """Readers of version 1 ask for its header, and would take metres for radians."""
    robot, _ = pair
    file, ends = tmp_path / "primitive.npz", (drawn(robot, 1, 1)[0], drawn(robot, 1, 2)[0])
    primitive = SMP.fit(list(swings(robot, *ends)), robot=robot)
    primitive.save(file)
    with pytest.raises(ValueError, match=r"must have .*'version': 1.*got .*'version': 2"):
        read_archive(file.read_bytes(), "primitive.npz", FIRST)
    # What was written of such robots as version 1 is read on.
    with np.load(file) as archive:
        arrays = dict(archive)
    np.savez(tmp_path / "before.npz", **arrays | {"header": np.array(json.dumps(FIRST))})
    for name in ("primitive.npz", "before.npz"):
        again = SMP.load(tmp_path / name)
        assert again.robot.units == robot.units
        assert "m" in again.robot.units
        np.testing.assert_array_equal(again.single.mean, primitive.single.mean)


def test_files_of_other_robots_stay_those_of_version_1(tmp_path):
    robot = Robot.from_urdf(asset_path("jaco", "jaco.urdf"), tip="j2s6s200_end_effector")
    SMP.fit(asset_path("demonstrations", "Placement.npz"), robot=robot).save(tmp_path / "arm.npz")
    SMP.fit([[[0.0], [1.0]], [[0.0], [2.0]]]).save(tmp_path / "path.npz")
    for name in ("arm.npz", "path.npz"):
        arrays = read_archive((tmp_path / name).read_bytes(), name, FIRST)
        arrays.pop("prismatic", None)
        np.savez(tmp_path / name, header=np.array(json.dumps(FIRST)), **arrays)
        again = SMP.load(tmp_path / name)
        assert again.robot is None or set(again.robot.units) == {"rad"}


@pytest.fixture(scope="module")
def gantry(tmp_path_factory):
    path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    path.write_text(f'<robot name="gantry">{CHAINS["gantry"]}</robot>')
    return path, Robot.from_urdf(path, "tool", overshoot=0.03)


def test_a_gantry_is_timed_in_metres(gantry):
    _, robot = gantry
    path = swings(robot, [0.1, 0.1, 0.1], [0.8, 0.9, 0.4])[0]
    motion = robot.timed(path, acceleration=1.0)
    assert (np.abs(motion.velocities) <= np.array([0.5, 0.4, 0.3]) * (1.0 + 1e-6)).all()
    with pytest.raises(ValueError, match=r"start_velocity must have a norm .* m/s for this path"):
        robot.timed(path, acceleration=1.0, start_velocity=9.0)


def test_mixed_units_have_no_norm(tmp_path):
    path = tmp_path / "lift.urdf"
    path.write_text(f'<robot name="lift">{CHAINS["lift"]}</robot>')
    robot = Robot.from_urdf(path, "tool", overshoot=0.03)
    way = swings(robot, [0.0, 0.0, 0.1, 0.0], [1.0, 0.3, 0.3, 1.0])[0]
    limits = [2.0, 0.5, 0.5, 2.0]
    with pytest.raises(ValueError, match="start_velocity must be 0 or have 4 entries"):
        robot.timed(way, limits, start_velocity=0.1)
    with pytest.raises(ValueError, match=r"jerk must have one entry for each joint, .* rad, m, m"):
        robot.timed(way, limits, jerk=10.0)


def test_limits_are_named_in_metres(gantry):
    path, robot = gantry
    demonstrations = list(swings(robot, [0.1, 0.1, 0.1], [0.8, 0.9, 0.4]))
    with pytest.raises(ValueError, match=r"joint 'z', \[0, 0.6\] m, got .*: are they in millim"):
        SMP.fit([np.add(d, [0.0, 0.0, 0.7]) for d in demonstrations], robot=robot)
    primitive = SMP.fit(demonstrations, robot=robot)
    with pytest.raises(ValueError, match=r"goal must keep the limits of joint 'y', \[0, 1\] m"):
        primitive.adapt(goal=[0.5, 1.2, 0.3], particles=2)
    for limit, message in (
        ({"limits": {"y": (1.0, 0.0)}}, r"limits\['y'\] must be \(lower, upper\)"),
        ({"velocities": {"y": -1.0}}, r"velocities\['y'\]"),
    ):
        with pytest.raises(ValueError, match=message):
            Robot.from_urdf(path, "tool", **limit)
    text = path.read_text().replace('lower="0.0" upper="0.6"', "")
    (path.parent / "endless.urdf").write_text(text)
    with pytest.raises(ValueError, match=r"joint 'z' must have a range .* m and 0.3 m/s"):
        Robot.from_urdf(path.parent / "endless.urdf", "tool")


def test_a_slide_of_a_turn_is_no_turn(tmp_path):
    """A step of 2 pi metres between two samples is one, and is not unwrapped."""
    text = CHAINS["gantry"].replace('upper="1.0" velocity="0.5"', 'upper="9.0" velocity="5"')
    path = tmp_path / "long.urdf"
    path.write_text(f'<robot name="long">{text}</robot>')
    robot = Robot.from_urdf(path, "tool", overshoot=0.05)
    steps = np.array([0.5, 0.5 + 2.0 * np.pi, 7.0, 7.2])
    ways = [np.column_stack([steps + shift, 4 * [0.3], 4 * [0.3]]) for shift in (0.0, 0.1)]
    primitive = SMP.fit(ways, robot=robot, basis_functions=4)
    np.testing.assert_array_equal(primitive.demonstrations[0], ways[0])


def test_what_is_added_is_asked_for_by_coordinate(gantry):
    _, robot = gantry
    ways = list(swings(robot, [0.1, 0.1, 0.1], [0.8, 0.9, 0.4]))
    default = SMP.fit(ways, robot=robot)
    np.testing.assert_allclose(default.settings.smooth_std, [0.1, 0.1, 0.06])
    asked = SMP.fit(ways, robot=robot, smooth_std=(0.2, 0.05, 0.01))
    with pytest.raises(ValueError, match="smooth_std must have shape"):
        SMP.fit(ways, robot=robot, smooth_std=(0.2, 0.05))

    def spread(primitive):
        values = primitive.single.basis.values(torch.tensor(0.5, dtype=torch.float64))
        covariance = primitive.single.covariance.reshape(15, 3, 15, 3)
        return torch.einsum("k,kdle,l->de", values, covariance, values).numpy()

    difference = spread(asked) - spread(default)
    expected = np.diag(np.square([0.2, 0.05, 0.01]) - np.square([0.1, 0.1, 0.06]))
    np.testing.assert_allclose(difference, expected, atol=1e-12)


def test_a_short_stroke_leaves_room_within_its_limits(gantry):
    path, _ = gantry
    robot = Robot.from_urdf(path, "tool", limits={"z": (0.1, 0.13)}, overshoot=0.05)
    ways = list(swings(robot, [0.1, 0.1, 0.105], [0.8, 0.9, 0.125]))
    plan = SMP.fit(ways, robot=robot).adapt(start=ways[0][0], goal=ways[0][-1], particles=8)
    assert plan.good.any()


@pytest.mark.parametrize("method", ["cpromp_chance", "cpromp"])
def test_baselines_keep_the_limits_of_a_short_stroke(gantry, method):
    path, _ = gantry
    robot = Robot.from_urdf(path, "tool", limits={"z": (0.1, 0.2)}, overshoot=0.05)
    ways = list(swings(robot, [0.1, 0.1, 0.12], [0.8, 0.9, 0.18]))
    obstacle = Obstacle(shape="sphere", position=(0.6, 2.0, 0.5), size=(0.05, 0.05, 0.05))
    plan = SMP.fit(ways, robot=robot).adapt(
        obstacle, start=ways[0][0], goal=ways[0][-1], particles=8, method=method
    )
    assert plan.good.mean() > 0.4
