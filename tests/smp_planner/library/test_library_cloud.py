"""Point clouds as obstacles: what a camera sees of a body, judged by the body itself."""

import numpy as np
import pybullet
import pytest
import torch
from pybullet_utils.bullet_client import BulletClient

from smp_gym.assets import jaco_urdf
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.geometry.distance import signed_distance
from smp_gym.scene import Obstacle
from smp_planner.adaptation import adaptation
from smp_planner.collision.verification import CLEARANCE_TOLERANCE, check_collisions
from smp_planner.library.cloud import learned_cloud
from smp_planner.library.frame import Frame
from smp_planner.library.scene import Scene
from smp_planner.library.smp import SMP, AdaptSettings, PointCloud, Robot
from smp_planner.occupancy.grid import DistanceGrid, bake_analytic
from smp_planner.planning.assessment import assess
from smp_planner.planning.path_clearance import path_clearance
from smp_planner.planning.target import SceneTarget

PHASE = np.linspace(0.0, 1.0, 60)
QUICK = AdaptSettings(map_points=6000, map_steps=400, retries=0)
SHORT = adaptation("smp", iterations=40)
BLOCK = Obstacle(
    shape="box",
    position=(0.5, 0.0, 0.25),
    quaternion=(0.0, 0.0, 0.6, 0.8),
    size=(0.08, 0.05, 0.1),
)
CAMERA = np.array([0.1, -0.8, 0.9])
DEPTH = 0.2
"""m, at least as thick as the block is anywhere along a ray."""


def seen(bodies, camera, count=70, half_angle=0.25):
    """Return (N, 3) where the rays of a camera that looks at the first body meet the bodies."""
    forward = np.subtract(bodies[0].position, camera)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    aside = np.tan(half_angle) * np.linspace(-1.0, 1.0, count)
    rays = forward + aside[:, None, None] * right + aside[:, None] * np.cross(right, forward)
    rays = rays.reshape(-1, 3) / np.linalg.norm(rays, axis=-1).reshape(-1, 1)
    depth = np.zeros(len(rays))
    for _ in range(80):
        depth += np.minimum(signed_distance(camera + depth[:, None] * rays, bodies), 1.0)
    points = camera + depth[:, None] * rays
    return points[signed_distance(points, bodies) < 1e-6]


def densely(paths, count=20):
    share = np.linspace(0.0, 1.0, count)[:, None]
    steps = paths[:, :-1, None] + share * np.diff(paths, axis=1)[:, :, None]
    return steps.reshape(len(paths), -1, paths.shape[-1])


@pytest.fixture(scope="module")
def arcs():
    rng = np.random.default_rng(1)
    line = np.stack([PHASE, 0.0 * PHASE, 0.25 * np.sin(np.pi * PHASE)], axis=1)
    return [line + rng.normal(0.0, 0.02, 3) * np.sin(np.pi * PHASE)[:, None] for _ in range(5)]


@pytest.fixture(scope="module")
def space(arcs):
    return SMP.fit(arcs)


@pytest.fixture(scope="module")
def block():
    return PointCloud(seen([BLOCK], CAMERA), CAMERA, DEPTH)


@pytest.fixture(scope="module")
def plan(space, block, arcs):
    ends = {"start": arcs[0][0], "goal": arcs[0][-1]}
    return space.adapt(block, **ends, radius=0.02, particles=20, method=SHORT, settings=QUICK)


@pytest.fixture(scope="module")
def placing():
    robot = Robot.from_urdf(jaco_urdf(), "j2s6s200_end_effector")
    return SMP.fit(Demonstrations.load("Placement").configurations, robot=robot)


@pytest.fixture(scope="module")
def pillar(placing):
    x, y, z = placing.robot.tool_positions(placing.demonstrations[0])[100]
    return Obstacle(shape="cylinder", position=(x, y, z), size=(0.04, 0.04, 0.1))


@pytest.fixture(scope="module")
def view(pillar):
    camera = np.add(pillar.position, [0.6, 0.3, 0.6])
    return PointCloud(seen([pillar], camera), camera)


def body_clearance(placing, paths, bodies):
    """Return the least distance (P,) of the spheres of a robot to bodies, along dense paths."""
    model = placing.robot.model
    moving = model.link > 0
    centers = model.sphere_centers(torch.from_numpy(densely(paths, 4))).numpy()[:, :, moving]
    return (signed_distance(centers, bodies) - model.radius[moving]).min(axis=(1, 2))


def test_paths_go_round_what_the_camera_saw(space, block, arcs, plan):
    true = signed_distance(densely(plan.trajectories), [BLOCK]).min(axis=1) - 0.02
    assert plan.collision_free.sum() >= 17
    assert true[plan.chosen] > 0.0
    assert (true[plan.collision_free] > -0.01).all()
    prior = space.adapt(
        block,
        start=arcs[0][0],
        goal=arcs[0][-1],
        radius=0.02,
        method="promp",
        settings=QUICK,
        particles=1000,
    )
    true = signed_distance(densely(prior.trajectories), [BLOCK]).min(axis=1) - 0.02
    assert (true < -0.01).mean() > 20 / 42
    assert not prior.collision_free[:42][true[:42] < -0.01].any()


def test_a_plan_is_the_same_in_millimetres(space, block, arcs, plan):
    in_mm = SMP.fit([1000.0 * d for d in arcs])
    cloud = PointCloud(1000.0 * block.points, 1000.0 * CAMERA, 1000.0 * DEPTH)
    again = in_mm.adapt(
        [cloud],
        start=1000.0 * arcs[0][0],
        goal=1000.0 * arcs[0][-1],
        radius=20.0,
        particles=20,
        method=SHORT,
        settings=QUICK,
    )
    np.testing.assert_allclose(again.trajectories, 1000.0 * plan.trajectories, atol=1e-6)
    np.testing.assert_allclose(again.clearance, 1000.0 * plan.clearance, atol=1e-6)


def test_thickness_is_what_lies_behind_the_surface():
    sheet = np.stack(np.meshgrid(*[np.linspace(-200.0, 200.0, 41)] * 2, [0.0]), -1).reshape(-1, 3)
    cloud = PointCloud(sheet, [0.0, 0.0, 1000.0], thickness=100.0)
    box = np.full(3, -0.3), np.full(3, 0.3)
    grid = learned_cloud(cloud, Frame(np.zeros(3), 1000.0), box, 0.0, QUICK).grid
    # In front, at the surface, in the middle of the slab, at its back, behind; m.
    heights = np.array([0.05, 0.0, -0.05, -0.1, -0.15])
    found = grid.query(np.stack([0.0 * heights, 0.0 * heights, heights], 1))
    np.testing.assert_allclose(found, [0.05, 0.0, -0.05, 0.0, 0.05], atol=0.012)


def test_a_map_is_learned_once(space, arcs):
    cloud = PointCloud(seen([BLOCK], CAMERA, 30), CAMERA)
    few = {"particles": 2, "method": "promp"}
    settings = AdaptSettings(map_points=500, map_steps=20)
    plans = [
        space.adapt(cloud, start=start, goal=arcs[0][-1], seed=seed, settings=settings, **few)
        for start, seed in ((arcs[0][0], 0), (arcs[0][0] - 0.1, 1))
    ]
    assert len(cloud.maps) == 1
    assert plans[0].display["obstacles"] == (cloud,)
    fresh = PointCloud(cloud.points, CAMERA)
    again = space.adapt(fresh, start=arcs[0][0], goal=arcs[0][-1], settings=settings, **few)
    np.testing.assert_array_equal(again.clearance, plans[0].clearance)
    space.adapt(cloud, radius=0.02, settings=settings, **few)
    assert len(cloud.maps) == 2


def test_what_was_not_looked_at_is_not_free(space, arcs):
    """Far from the demonstrations the cloud is not learned; a path that goes there is refused."""
    far = BLOCK.model_copy(update={"position": (0.5, 3.0, 0.25)})
    points = np.concatenate([seen([BLOCK], CAMERA, 30), seen([far], CAMERA, 30, 0.1)])
    settings = AdaptSettings(map_points=500, map_steps=20)
    scene = Scene(space.frame, None, [PointCloud(points, CAMERA)], 0.0)
    problem = scene.problem((), settings, 0, space.demonstrations)
    beside, through_far = (
        space.frame.inwards(np.array([[0.0, 0.3, 0.0], [0.5, y, 0.6], [1.0, 0.3, 0.0]]))
        for y in (0.3, 3.0)
    )
    both = np.stack([beside, through_far])
    np.testing.assert_array_equal(assess(problem, both, settings).free, [True, False])
    only_far = PointCloud(seen([far], CAMERA, 60, 0.1), CAMERA)
    scene = Scene(space.frame, None, [only_far], 0.0)
    problem = scene.problem((), settings, 0, space.demonstrations)
    np.testing.assert_array_equal(assess(problem, both, settings).free, [True, False])
    assert SceneTarget(problem, settings).costs(beside[None])["obstacles"] == 0.0


def test_an_arm_goes_round_what_the_camera_saw(placing, pillar, view):
    ends = {"start": placing.demonstrations[0][0], "goal": placing.demonstrations[0][-1]}
    plan = placing.adapt(view, **ends, particles=12, method=SHORT, settings=QUICK)
    assert plan.good.sum() >= 9
    true = body_clearance(placing, plan.trajectories, [pillar])
    assert true[plan.chosen] > 0.0
    assert (true[plan.collision_free] > -0.01).all()
    prior = placing.adapt(view, **ends, particles=40, method="promp", settings=QUICK)
    true = body_clearance(placing, prior.trajectories, [pillar])
    decided = np.abs(true) > 0.015
    assert (true[decided] < 0.0).any()
    assert (true[decided] > 0.0).any()
    np.testing.assert_array_equal((prior.clearance > 0.0)[decided], true[decided] > 0.0)


def test_the_map_is_right_where_the_camera_saw(pillar, view):
    (known,) = view.maps.values()
    rng = np.random.default_rng(2)
    around = view.points[rng.integers(len(view.points), size=3000)]
    around = around + rng.uniform(-0.03, 0.03, around.shape)
    true = signed_distance(around, [pillar])
    outside = true > 0.0
    for points, expected in ((view.points, 0.0), (around[outside], true[outside])):
        error = np.abs(known.grid.query(points) - expected)
        assert np.percentile(error, 95) < 0.01


def test_a_depth_image_of_the_physics_engine_is_a_cloud(space, arcs):
    client = BulletClient(pybullet.DIRECT)
    client.createMultiBody(
        0.0,
        client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=BLOCK.size),
        client.createVisualShape(pybullet.GEOM_BOX, halfExtents=BLOCK.size),
        BLOCK.position,
        BLOCK.quaternion,
    )
    count, near, far = 100, 0.5, 3.0
    look = client.computeViewMatrix(CAMERA, BLOCK.position, (0.0, 0.0, 1.0))
    project = client.computeProjectionMatrixFOV(25.0, 1.0, near, far)
    renderer = pybullet.ER_TINY_RENDERER
    image = client.getCameraImage(count, count, look, project, renderer=renderer)
    client.disconnect()
    depth = np.reshape(image[3], (count, count))
    across = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    corners = np.stack([*np.meshgrid(across, -across), 2.0 * depth - 1.0, np.ones_like(depth)], -1)
    to_world = np.linalg.inv(
        np.reshape(project, (4, 4), order="F") @ np.reshape(look, (4, 4), order="F")
    )
    points = (corners @ to_world.T)[depth < 1.0]
    points = points[:, :3] / points[:, 3:]
    assert np.percentile(np.abs(signed_distance(points, [BLOCK])), 95) < 0.005
    cloud = PointCloud(points, CAMERA, DEPTH)
    plan = space.adapt(
        cloud, start=arcs[0][0], goal=arcs[0][-1], method=SHORT, particles=12, settings=QUICK
    )
    assert plan.good.sum() >= 9
    assert signed_distance(densely(plan.best[None]), [BLOCK]).min() > 0.0


def test_bodies_beside_a_cloud_count_too(space, placing, block, pillar, view):
    ball = Obstacle(shape="sphere", position=(0.5, 0.0, 0.25), size=(0.1, 0.1, 0.1))
    path = space.frame.inwards(np.array(space.demonstrations))
    shelf = ball.model_copy(update={"position": (0.3, -0.5, 0.3)})
    configurations = np.array(placing.demonstrations)
    for primitive, body, cloud, paths in (
        (space, ball, block, path),
        (placing, shelf, view, configurations),
    ):
        checks, costs = [], []
        for obstacles in ([body], [cloud], [cloud, body]):
            radius = 0.02 if primitive.robot is None else 0.0
            scene = Scene(primitive.frame, primitive.robot, obstacles, radius)
            problem = scene.problem((), QUICK, 0, primitive.demonstrations)
            checks.append(assess(problem, paths, QUICK))
            costs.append(SceneTarget(problem, QUICK).costs(paths)["obstacles"])
        least = np.minimum(checks[0].clearance, checks[1].clearance)
        np.testing.assert_allclose(checks[2].clearance, least, atol=2 * CLEARANCE_TOLERANCE)
        assert (costs[2] >= 0.95 * np.maximum(costs[0], costs[1])).all()
        assert (costs[2] <= 1.05 * (costs[0] + costs[1])).all()


def test_a_blocked_start_is_refused_by_the_map(space, placing, block, pillar, view, arcs):
    seen_side = block.points[np.argmin(np.linalg.norm(block.points - CAMERA, axis=1))]
    ball = Obstacle(shape="sphere", position=(0.5, 0.9, 0.25), size=(0.1, 0.1, 0.1))
    with pytest.raises(ValueError, match=r"start .* is inside or touches obstacles\[0\]$"):
        space.adapt([block, ball], start=seen_side, radius=0.02, settings=QUICK)
    with pytest.raises(ValueError, match=r"goal .* is inside or touches obstacles\[1\]$"):
        space.adapt([block, ball], goal=ball.position, radius=0.02, settings=QUICK)
    with pytest.raises(ValueError, match=r"goal .* is inside or touches obstacles\[0\]"):
        placing.adapt(view, goal=placing.demonstrations[0][100], settings=QUICK)


def steep_grid():
    """A grid that is steeper than a distance: an exact one times 1.5, with a bend in each cell."""
    body = Obstacle(shape="sphere", position=(0.5, 0.1, 0.0), size=(0.1, 0.1, 0.1))
    exact = bake_analytic([body], ((-0.8,) * 3, (0.8,) * 3), 0.05, 2.0)
    return DistanceGrid(exact.origin, exact.spacing, 1.5 * exact.values)


def test_clearance_to_a_grid_is_found_between_samples(pointer):
    grid = steep_grid()
    assert 1.5 < grid.steepness < 2.7
    rng = np.random.default_rng(3)
    paths = rng.uniform(-1.0, 1.0, (20, 4, 3))
    expected = grid.query(densely(paths, 2000)).min(axis=1)
    np.testing.assert_allclose(path_clearance(paths, (), 1e-4, grid), expected, atol=6e-4)
    rod = pointer(length=0.5, radius=0.05)
    turns = rng.uniform(-2.0, 2.0, (20, 3, 1))
    angle = densely(turns, 4000)
    ends = 0.5 * np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    expected = grid.query(ends).min(axis=1) - 0.05
    found = check_collisions(turns, rod, (), grid=grid)
    np.testing.assert_allclose(found.clearance, expected, atol=CLEARANCE_TOLERANCE)
    assert (found.clearance <= expected + CLEARANCE_TOLERANCE).all()
    assert found.free.any()
    assert not found.free.all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.empty((0, 3))}, r"points must have shape \(N, 3\), N at least 1"),
        ({"points": np.zeros((4, 2))}, r"points must have shape .* got \(4, 2\)"),
        ({"points": np.full((2, 3), np.nan)}, "points must be finite, got nan"),
        ({"sensor": np.zeros((3, 3))}, r"sensor must have shape \(3,\) or \(2, 3\)"),
        ({"sensor": (0.0, np.inf, 0.0)}, "sensor must be finite, got inf"),
        ({"sensor": (0.5, 0.0, 0.0)}, "sensor must be farther than 0 from what it sees"),
        ({"sensor": (0.5, 0.0, 0.1), "inflation": 0.2}, "sensor must be farther than 0.2"),
        ({"thickness": -0.1}, "thickness must be .* at least 0.0, got -0.1"),
        ({"thickness": np.nan}, "thickness must be .* at least 0.0, got nan"),
        ({"inflation": 0.0}, "inflation must be .* above 0.0, got 0.0"),
    ],
)
def test_bad_clouds_are_named(change, message):
    given = {"points": [[0.5, 0.0, 0.0], [0.51, 0.0, 0.0]], "sensor": (0.0, 0.0, 1.0)} | change
    with pytest.raises(ValueError, match=message):
        PointCloud(**given)


def test_clouds_that_do_not_fit_are_named(space, block, arcs):
    flat = SMP.fit([d[:, :2] for d in arcs])
    with pytest.raises(ValueError, match=r"obstacles\[0\] .* D = 2 must be Circle or Rectangle"):
        flat.adapt(block)
    with pytest.raises(ValueError, match="one PointCloud at most, got 2"):
        space.adapt([block, block])
    with pytest.raises(ValueError, match=r"denser than inflation, 0\.02, got .* 0\.22.* away"):
        space.adapt(PointCloud(0.1 * np.eye(3) + [[0.0], [0.1], [0.2]], CAMERA))
    with pytest.raises(ValueError, match=r"sensor must be farther than 0\.02"):
        space.adapt(PointCloud(block.points, block.points[0] + [0.0, 0.0, 0.01]))
    assert repr(block) == f"PointCloud({len(block.points)} points)"
    with pytest.raises(ValueError, match="read-only"):
        block.points[0] = 0.0
