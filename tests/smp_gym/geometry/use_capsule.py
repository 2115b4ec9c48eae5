"""What a process does with the capsule; fails where something does not take it."""

import gymnasium
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.geometry.distance import signed_distance, signed_distance_and_gradient
from smp_gym.geometry.faces import body_faces
from smp_gym.observation import decode
from smp_gym.physics.world import BulletWorld
from smp_gym.robot.kinematics import arm_spheres, sphere_centers
from smp_gym.sampling import kernels, sample_scene
from smp_gym.sampling.conversion import to_obstacle, to_row
from smp_gym.scene import SHAPES, Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import jaco_model
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks
from smp_planner.policy.planner_policy import PlannerPolicy

RADIUS, HALF = 0.04, 0.15
SIZE = (RADIUS, RADIUS, HALF)
LEANING = (0.0, np.sin(0.4), 0.0, np.cos(0.4))


def capsule(position, quaternion=(0.0, 0.0, 0.0, 1.0)):
    return Obstacle(shape="capsule", position=position, quaternion=quaternion, size=SIZE)


def check_distance(rng):
    body = capsule((0.1, -0.2, 0.3), LEANING)
    mesh = trimesh.creation.capsule(2.0 * (HALF - RADIUS), RADIUS, count=[96, 96])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    turn = trimesh.transformations.quaternion_matrix(np.roll(LEANING, 1))
    mesh.apply_transform(turn)
    mesh.apply_translation(body.position)
    surface = mesh.sample(200_000)
    points = np.array(body.position) + rng.uniform(-0.25, 0.25, (500, 3))
    distance, gradient = signed_distance_and_gradient(points, [body])
    np.testing.assert_allclose(np.abs(distance), cKDTree(surface).query(points)[0], atol=2e-3)
    np.testing.assert_array_less(np.abs(signed_distance(surface, [body])), 1e-4)
    assert (signed_distance(0.9 * surface + 0.1 * np.array(body.position), [body]) < 0.0).all()
    step = 1e-6 * np.eye(3)
    slope = [
        (signed_distance(points + h, [body]) - signed_distance(points - h, [body])) / 2e-6
        for h in step
    ]
    np.testing.assert_allclose(np.stack(slope, axis=1), gradient, atol=1e-6)
    assert np.abs(signed_distance(np.concatenate(body_faces(body)), [body])).max() < 1e-9


def check_sampling(rng):
    body = capsule((0.3, 0.1, 0.2), (0.0, 0.0, np.sin(0.3), np.cos(0.3)))
    row = np.array(to_row(body))
    points = rng.uniform(-0.2, 0.6, (200, 3))
    np.testing.assert_allclose(
        kernels.point_distances(points, row[None])[0], signed_distance(points, [body]), atol=1e-12
    )
    assert to_obstacle(row).shape == "capsule"


def check_map(rng):
    box = Obstacle(shape="box", position=(0.3, 0.0, 0.0), size=SIZE)
    bodies = (capsule((0.0, 0.0, 0.0), LEANING), box)
    points = rng.uniform(-0.3, 0.4, (2000, 3))
    networks = default_networks()
    exact = np.clip(signed_distance(points, bodies), -networks.truncation, networks.truncation)
    error = ShapeNetworkMap(bodies, networks).signed_distance(points) - exact
    assert np.abs(error).max() < 0.01
    alone = ShapeNetworkMap(bodies[:1], networks).signed_distance(points)
    np.testing.assert_allclose(
        alone,
        np.clip(signed_distance(points, bodies[:1]), -networks.truncation, networks.truncation),
    )


def check_physics(rng):
    world = BulletWorld()
    world.reserve_obstacles()
    ball = Obstacle(shape="sphere", position=(0.0, 0.0, 0.0), size=(0.01, 0.01, 0.01))
    world.add_body("ball", (ball,), color=(1.0, 1.0, 1.0, 1.0))
    body = capsule((0.2, 0.0, 0.4), LEANING)
    world.set_obstacles([body])
    world.place("obstacle_0", body.position, body.quaternion)
    for point in np.array(body.position) + rng.uniform(-0.3, 0.3, (50, 3)):
        world.place("ball", tuple(point), (0.0, 0.0, 0.0, 1.0))
        distance = signed_distance(point, [body]) - 0.01
        if distance > 0.0:
            found = world.clearance(["ball"], ["obstacle_0"], 1.0)
            assert found == pytest.approx(distance, abs=1e-3)
    world.close()


def check_episode():
    env = gymnasium.make("smp_gym/Placement-v0")
    scene = sample_scene("Placement", "none", 1)
    goal = np.array(scene.goals[0].position)
    bare, _ = env.reset(options={"scene": scene})
    _, state = PlannerPolicy.make("promp", "Placement").predict(bare, deterministic=True)
    plan = state[0].plan
    # In the middle of where the hand would go.
    spheres = arm_spheres()
    hand = sphere_centers(plan.trajectories[plan.chosen, 100], spheres)[-1]
    body = capsule(tuple(hand.tolist()), LEANING)
    assert np.linalg.norm(hand - goal) > 0.1
    blocked = scene.model_copy(update={"difficulty": "custom", "seed": None, "obstacles": (body,)})
    assert type(scene).from_json(blocked.to_json()) == blocked
    observation, _ = env.reset(options={"scene": blocked})
    assert env.observation_space.contains(observation)
    (seen,) = decode(observation, "Placement").scene.obstacles
    assert seen.shape == "capsule"
    policy = PlannerPolicy.make("smp", "Placement")
    _, state = policy.predict(observation, deterministic=True)
    plan = state[0].plan
    assert plan.good.any()
    path = plan.trajectories[plan.chosen]
    clearance = signed_distance(sphere_centers(path, spheres), [body]) - spheres.radius
    assert clearance.min() > 0.0
    straight = np.linspace(path[0], path[-1], 400)
    far = signed_distance(sphere_centers(straight, spheres), [body]) - spheres.radius
    off_base = spheres.link > 0
    checker = EdgeChecker(jaco_model(), [body])
    free = checker.configurations_free(straight)
    assert not free.all()
    assert free.any()
    assert (far[free][:, off_base] > 0.0).all()


rng = np.random.default_rng(0)
assert SHAPES == ("box", "cylinder", "sphere", "capsule")
with pytest.raises(ValueError, match="size of a capsule is"):
    Obstacle(shape="capsule", position=(0.0, 0.0, 0.0), size=(0.1, 0.1, 0.05))
check_distance(rng)
check_sampling(rng)
check_map(rng)
check_physics(rng)
check_episode()
print("taken")
