import json
import os
import subprocess
import sys
from collections import Counter

import gymnasium
import numpy as np
import pybullet
import pytest
from bullet_arm import Bullet

import smp_gym  # noqa: F401
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import OBSTACLE_LAYOUT
from smp_gym.robot import kinematics
from smp_gym.robot.forward_kernels import sphere_paths
from smp_gym.rollout import play
from smp_gym.sampling import (
    SPECIFICATIONS,
    DifficultySpecification,
    grid,
    kernels,
    sample_scene,
    sample_with_witness,
)
from smp_gym.sampling.bodies import CEILING
from smp_gym.sampling.choice import choose
from smp_gym.sampling.conversion import to_obstacle, to_row
from smp_gym.sampling.detours import detour_basis
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.swept_path import SweptPath
from smp_gym.scene import (
    BIN_INNER_HALF_WIDTH,
    BIN_WALL_THICKNESS,
    DIFFICULTIES,
    SHAPES,
    Obstacle,
    Scene,
    fixtures,
)
from smp_gym.tasks.placement.rules import (
    BIN_LOWER,
    BIN_UPPER,
    HELD_OBJECT_POSE,
    START_CONFIGURATION,
)

BLOCKED = ("easy", "medium", "hard")
SEEDS = range(6)


@pytest.fixture(scope="module")
def drawn():
    """Scenes with witnesses by difficulty."""
    return {
        difficulty: [sample_with_witness("Placement", difficulty, seed) for seed in SEEDS]
        for difficulty in DIFFICULTIES
    }


# --- What a scene is -------------------------------------------------------------------------


def test_a_scene_is_the_same_in_another_process_and_after_other_scenes(drawn):
    keys = [(difficulty, seed) for difficulty in DIFFICULTIES for seed in (4,)]
    code = (
        "import json, sys\n"
        "from smp_gym.sampling import sample_with_witness\n"
        "out = []\n"
        "for difficulty, seed in json.loads(sys.argv[1]):\n"
        "    scene, witness = sample_with_witness('Placement', difficulty, seed)\n"
        "    out.append([scene.to_json(), witness.tobytes().hex()])\n"
        "print(json.dumps(out))\n"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "2", "PYTHONHASHSEED": "5"}
    answer = subprocess.run(
        [sys.executable, "-c", code, json.dumps(keys)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    for (difficulty, seed), (text, witness) in zip(keys, json.loads(answer.stdout), strict=True):
        scene, here = drawn[difficulty][seed]
        assert scene.to_json() == text
        assert here.tobytes().hex() == witness


def test_sample_scene_gives_the_scene_of_the_witness(drawn):
    assert sample_scene("Placement", "medium", 4) == drawn["medium"][4][0]


def test_scenes_survive_json(drawn):
    for pairs in drawn.values():
        for scene, _ in pairs:
            assert Scene.from_json(scene.to_json()) == scene


def test_task_version_difficulty_and_seed_all_matter():
    scene = sample_scene("Placement", "easy", 1)
    others = [
        sample_scene("Placement", "easy", 2),
        sample_scene("Placement", "medium", 1),
        sample_scene("Placement", "easy", 1, version=1),
    ]
    for other in others:
        assert other.goals != scene.goals
        assert other.obstacles != scene.obstacles


def test_global_random_state_is_neither_used_nor_changed():
    before = sample_scene("Placement", "easy", 5)
    np.random.seed(99)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    assert sample_scene("Placement", "easy", 5) == before
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002


def test_very_large_seeds_are_seeds():
    assert sample_scene("Placement", "none", 2**40).seed == 2**40


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("Juggling", "easy", 0), "task must be one of Placement, .*; got 'Juggling'"),
        (("Placement", "nasty", 0), "must be one of none, easy, medium, hard; got 'nasty'"),
        (("Placement", "easy", -1), "seed must be a whole number .* got -1"),
        (("Placement", "easy", 0, "obstacles", -2), "version must be a whole number .* got -2"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    for function in (sample_scene, sample_with_witness):
        with pytest.raises(ValueError, match=message):
            function(*arguments)


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_scenes_are_what_their_difficulty_says(drawn, difficulty):
    # Beside them there is the wall behind the arm.
    obstacles = SPECIFICATIONS[difficulty].obstacles
    count = obstacles + (obstacles > 0)
    for seed, (scene, _) in enumerate(drawn[difficulty]):
        assert (scene.task, scene.difficulty, scene.seed) == ("Placement", difficulty, seed)
        assert scene.start == START_CONFIGURATION
        assert len(scene.obstacles) == count
        assert (np.array(scene.goals[0].position) >= BIN_LOWER).all()
        assert (np.array(scene.goals[0].position) <= BIN_UPPER).all()


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_obstacles_are_of_the_documented_kind(drawn, difficulty):
    field = next(f for f in OBSTACLE_LAYOUT if f.name == "position")
    standing = Counter()
    for scene, _ in drawn[difficulty]:
        goal = np.array(scene.goals[0].position)
        for obstacle in scene.obstacles:
            assert all(0.0 < half <= CEILING / 2.0 for half in obstacle.size)
            assert obstacle.velocity == (0.0, 0.0, 0.0)
            assert obstacle.quaternion[:2] == (0.0, 0.0)
            assert obstacle.position[2] >= obstacle.size[2] - 1e-12
            assert all(field.low < c < field.high for c in obstacle.position)
            half = obstacle.size[0]
            aside = np.abs(np.array(obstacle.position[:2]) - goal[:2]).max() - half
            assert aside >= BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS + 0.015 - 1e-9
            standing[scene.seed] += obstacle.position[2] == obstacle.size[2]
    assert all(standing[seed] >= SPECIFICATIONS[difficulty].on_table for seed in SEEDS)


def test_all_shapes_and_many_bins_occur(drawn):
    shapes = Counter(o.shape for scene, _ in drawn["hard"] for o in scene.obstacles)
    assert set(shapes) == set(SHAPES)
    goals = np.array([s.goals[0].position for pairs in drawn.values() for s, _ in pairs])
    extent = np.array(BIN_UPPER[:2]) - BIN_LOWER[:2]
    assert (np.ptp(goals[:, :2], axis=0) > 0.8 * extent).all()


# --- The witness -----------------------------------------------------------------------------


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_witnesses_keep_limits_and_join_start_and_goal(drawn, difficulty):
    for scene, witness in drawn[difficulty]:
        assert witness.shape == (200, 6)
        assert (witness > kinematics.JOINT_LOWER).all()
        assert (witness < kinematics.JOINT_UPPER).all()
        np.testing.assert_allclose(witness[0], scene.start, atol=1e-12)
        seconds = 14.0 / 199
        assert (np.abs(np.diff(witness, axis=0)) <= kinematics.JOINT_VELOCITY * seconds).all()
        assert np.abs(np.diff(witness[[0, 1, -2, -1]], axis=0)[[0, 2]]).max() < 5e-3
        end = (kinematics.end_effector_pose(witness[-1]) @ HELD_OBJECT_POSE)[:3, 3]
        np.testing.assert_allclose(end[:2], scene.goals[0].position[:2], atol=1e-3)


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("smp_gym/Placement-v0")
    yield made
    made.close()


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_witnesses_succeed_in_the_physics(drawn, difficulty, env):
    for scene, witness in drawn[difficulty][:4]:
        info = play(env, scene, witness)
        assert info["is_success"], (scene.seed, info)


@pytest.fixture(scope="module")
def bullet():
    made = Bullet()
    yield made
    pybullet.disconnect(made.client)


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_real_shapes_on_the_witness_keep_its_clearance(drawn, difficulty, bullet):
    wanted = SPECIFICATIONS[difficulty].clearance
    for scene, witness in drawn[difficulty][:5]:
        assert bullet.clearance(witness[::2], scene.obstacles) >= wanted - 1e-3


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_real_shapes_at_the_start_are_clear(drawn, difficulty, bullet):
    for scene, _ in drawn[difficulty]:
        assert bullet.clearance([scene.start], scene.obstacles) >= START_CLEARANCE - 1e-3


def carried(scene, witness):
    """Return the demonstrations at 200 samples, blended to the scene's start and release."""
    q = Demonstrations.load("Placement").configurations
    phase = np.linspace(0.0, 1.0, q.shape[1])[:, None]
    blend = phase**3 * (10 - 15 * phase + 6 * phase**2)
    start, end = np.array(scene.start) - q[:, :1], witness[-1] - q[:, -1:]
    return q + (1 - blend) * start + blend * end


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_the_mean_of_the_demonstrations_is_blocked(drawn, difficulty, bullet):
    for scene, witness in drawn[difficulty]:
        mean = carried(scene, witness).mean(axis=0)
        assert bullet.clearance(mean[::2], scene.obstacles) <= 0.0


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_scenes_are_harder_than_the_bare_bin(drawn, difficulty, env):
    scene, witness = drawn[difficulty][0]
    info = play(env, scene, carried(scene, witness).mean(axis=0), duration=8.0)
    assert info["failure"] == "collision"
    assert any(name.startswith("obstacle") for name in info["collision"])


def gaussian_detours(rng, count, samples):
    """Draw from the detours' process by a dense Gaussian, conditioned at its ends."""
    mean_free = conditioned_covariance(samples)
    values, vectors = np.linalg.eigh(mean_free)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    return 0.2 * np.einsum("tr,nrj->ntj", factor, rng.standard_normal((count, samples, 6)))


def conditioned_covariance(samples):
    """Covariance of a unit squared-exponential process given value and slope 0 at both ends."""
    length = 0.2
    phase = np.linspace(0.0, 1.0, samples)
    ends = np.array([0.0, 1.0])

    def kernel(a, b):
        d = a[:, None] - b
        k = np.exp(-0.5 * (d / length) ** 2)
        slope_b = k * d / length**2
        slope_both = k * (1 / length**2 - d**2 / length**4)
        return k, slope_b, slope_both

    prior = kernel(phase, phase)[0]
    k, slope, _ = kernel(phase, ends)
    cross = np.concatenate([k, slope], axis=1)
    k, slope, both = kernel(ends, ends)
    known = np.block([[k, slope], [slope.T, both]])
    return prior - cross @ np.linalg.solve(known, cross.T)


def free_of_spheres(trajectories, obstacles):
    """Return which (N, T, 6) trajectories keep their spheres off obstacles, by plain numpy."""
    spheres = kinematics.concatenate(
        kinematics.arm_spheres(),
        kinematics.finger_spheres(Demonstrations.load("Placement").metadata["finger_angles"]),
        kinematics.box_spheres((0.025, 0.025, 0.03), HELD_OBJECT_POSE),
    )
    kept = spheres.link >= 2
    centers = kinematics.sphere_centers(trajectories, spheres)[..., kept, :]
    deepest = np.full(len(trajectories), np.inf)
    for obstacle in obstacles:
        distance = numpy_distance(centers, obstacle) - spheres.radius[kept]
        deepest = np.minimum(deepest, distance.min(axis=(1, 2)))
    return deepest > 0.0


def numpy_distance(points, obstacle):
    """Return signed distances of (..., 3) points to an upright obstacle."""
    _, _, s, c = obstacle.quaternion
    yaw = 2 * np.arctan2(s, c)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    local = (points - np.array(obstacle.position)) @ turn
    if obstacle.shape == "sphere":
        return np.linalg.norm(local, axis=-1) - obstacle.size[0]
    if obstacle.shape == "cylinder":
        local = np.stack([np.hypot(local[..., 0], local[..., 1]), local[..., 2]], axis=-1)
        size = np.array([obstacle.size[0], obstacle.size[2]])
    else:
        size = np.array(obstacle.size)
    over = np.abs(local) - size
    outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
    return outside + np.minimum(over.max(axis=-1), 0.0)


@pytest.mark.parametrize(("difficulty", "share"), [("easy", 0.4), ("medium", 0.2), ("hard", 0.1)])
def test_fresh_draws_seldom_get_through(difficulty, share):
    rng = np.random.default_rng(42)
    solved = 0
    scenes = 10
    for seed in range(100, 100 + scenes):
        scene, witness = sample_with_witness("Placement", difficulty, seed)
        base = carried(scene, witness)[:, ::5]
        draws = base[rng.integers(len(base), size=42)] + gaussian_detours(rng, 42, base.shape[1])
        solved += free_of_spheres(draws, (*scene.obstacles, *fixtures(scene))).any()
    assert solved <= share * scenes


# --- The parts -------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [20, 200])
def test_detours_are_the_conditioned_gaussian_process(samples):
    basis = detour_basis(samples)
    np.testing.assert_allclose(basis @ basis.T, conditioned_covariance(samples), atol=2e-3)


def test_detours_vanish_with_their_slope_at_both_ends():
    basis = detour_basis(2001)
    assert np.abs(basis[[0, -1]]).max() == 0.0
    assert np.abs(np.diff(basis, axis=0)[[0, -1]] * 2000).max() < 0.03


def random_obstacles(rng, count):
    for _ in range(count):
        shape = SHAPES[rng.integers(3)]
        size = rng.uniform(0.03, 0.06, 3)
        size[1] = size[0] if shape != "box" else size[1]
        size[2] = size[0] if shape == "sphere" else size[2]
        yaw = rng.uniform(-np.pi, np.pi)
        yield Obstacle(
            shape=shape,
            position=tuple(rng.uniform([0.2, -0.2, 0.1], [0.6, 0.2, 0.5])),
            quaternion=(0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))),
            size=tuple(size),
        )


def test_distance_agrees_with_the_physics_engine(bullet):
    rng = np.random.default_rng(0)
    radius = 0.005
    for obstacle in random_obstacles(rng, 40):
        row = np.array(to_row(obstacle))
        body = bullet.body(obstacle)
        for _ in range(10):
            x, y, z = np.array(obstacle.position) + rng.uniform(-0.12, 0.12, 3)
            ball = bullet.body(Obstacle(shape="sphere", position=(x, y, z), size=(radius,) * 3))
            points = pybullet.getClosestPoints(body, ball, 1.0, physicsClientId=bullet.client)
            distance = kernels.point_distance(x, y, z, row)
            if distance > 2 * radius:
                assert distance == pytest.approx(points[0][8] + radius, abs=1.5e-3)
            elif distance < -radius:
                assert points[0][8] < 0.0
            pybullet.removeBody(ball, physicsClientId=bullet.client)
        pybullet.removeBody(body, physicsClientId=bullet.client)


def test_rows_and_obstacles_convert_into_each_other():
    for obstacle in random_obstacles(np.random.default_rng(1), 20):
        back = to_obstacle(np.array(to_row(obstacle)))
        assert back.shape == obstacle.shape
        np.testing.assert_allclose(back.position, obstacle.position)
        np.testing.assert_allclose(back.size, obstacle.size)
        np.testing.assert_allclose(back.quaternion, obstacle.quaternion, atol=1e-12)


@pytest.fixture(scope="module")
def paths():
    """Random walks of a few spheres: centres (70, 15, 4, 3) and radii (4,)."""
    rng = np.random.default_rng(3)
    begin = rng.uniform([0.1, -0.3, 0.1], [0.7, 0.3, 0.5], (70, 1, 4, 3))
    centers = begin + np.cumsum(rng.normal(0.0, 0.02, (70, 15, 4, 3)), axis=1)
    return centers, np.array([0.02, 0.03, 0.05, 0.04])


def test_sphere_paths_are_those_of_the_kinematics():
    q = np.random.default_rng(0).uniform(kinematics.JOINT_LOWER, kinematics.JOINT_UPPER, (50, 6))
    spheres = kinematics.arm_spheres()
    centers = sphere_paths(
        q, kinematics.BASE_TRANSFORM, kinematics.JOINT_ORIGINS, spheres.link, spheres.center
    )
    np.testing.assert_allclose(centers, kinematics.sphere_centers(q, spheres), atol=1e-12)


@pytest.mark.parametrize("depth", [-0.01, 0.0, 0.015])
def test_blocked_paths_agree_with_brute_force(paths, depth):
    centers, radius = paths
    obstacles = list(random_obstacles(np.random.default_rng(5), 30))
    rows = np.array([to_row(obstacle) for obstacle in obstacles])
    blocked = kernels.blocked_paths(centers, radius, rows, depth)
    brute = np.array(
        [(numpy_distance(centers, o) - radius + depth <= 0).any(axis=(1, 2)) for o in obstacles]
    )
    np.testing.assert_array_equal(blocked, brute)
    assert 0.01 < brute.mean() < 0.9


def test_path_clearances_agree_with_brute_force(paths):
    centers, radius = paths
    obstacles = list(random_obstacles(np.random.default_rng(6), 30))
    rows = np.array([to_row(obstacle) for obstacle in obstacles])
    for path in centers[:10]:
        brute = [(numpy_distance(path, o) - radius).min() for o in obstacles]
        swept = SweptPath.of(path, radius)
        found = swept.clearances(rows, 0.15)
        np.testing.assert_allclose(found, np.minimum(brute, 0.15), atol=1e-12)
        for clearance in (-0.02, 0.0, 0.05):
            clear = swept.clear(rows, clearance)
            np.testing.assert_array_equal(clear, np.array(brute) >= clearance)


def test_least_clearances_and_heights_agree_with_brute_force(paths):
    centers, radius = paths
    obstacles = list(random_obstacles(np.random.default_rng(7), 3))
    rows = np.array([to_row(obstacle) for obstacle in obstacles])
    gaps = np.stack([numpy_distance(centers, o) - radius for o in obstacles])
    found = kernels.least_clearances(centers, radius, rows, 0.3)
    np.testing.assert_allclose(found, np.minimum(gaps.min(axis=(0, 2, 3)), 0.3), atol=1e-12)
    lowest = (centers[..., 2] - radius).min(axis=(1, 2))
    np.testing.assert_allclose(kernels.lowest(centers, radius), lowest)


def test_clearance_of_itself_agrees_with_brute_force(paths):
    centers, radius = paths
    pairs = np.array([[0, 1], [1, 3]])
    a, b = pairs.T
    for path in centers[:10]:
        gap = np.linalg.norm(path[:, a] - path[:, b], axis=-1) - radius[a] - radius[b]
        least = max(gap.min(), 0.0)
        assert not kernels.clear_of_itself(path, radius, pairs, least + 1e-9)
        if least > 0.0:
            assert kernels.clear_of_itself(path, radius, pairs, least - 1e-9)


def test_the_grid_tells_which_paths_come_near(paths):
    centers, radius = paths
    obstacles = list(random_obstacles(np.random.default_rng(7), 20))
    rows = np.array([to_row(obstacle) for obstacle in obstacles])
    made = grid.rasterise(centers, radius)
    gaps = np.array([(numpy_distance(centers, o) - radius).min(axis=(1, 2)) for o in obstacles])
    found = grid.near(made, rows, 0.01, len(centers))
    # Half the diagonal of the grid's cells, and what radii of one class differ by.
    off = np.sqrt(3) / 2 * 0.04 + 0.01
    assert not found[gaps > 0.01 + off].any()
    assert found[gaps < 0.01 - off].all()
    assert ((gaps > 0.01 + off) & (gaps < 0.2)).any()
    assert (gaps < 0.01 - off).any()


def chosen_by_hand(rng):
    """Random candidates far from each other, with what they block."""
    rows = np.zeros((12, 9))
    rows[:, 1], rows[:, 4], rows[:, 6:] = np.arange(12), 1.0, 0.05
    rows[:, 3] = np.where(rng.random(12) < 0.5, 0.05, 0.3)
    return rows, rng.random((12, 70)) < 0.3


def test_two_chosen_obstacles_are_the_best_of_all_pairs():
    rng = np.random.default_rng(8)
    specification = DifficultySpecification(2, 0, 0.0, 0.0)
    for _ in range(30):
        rows, blocks = chosen_by_hand(rng)
        found = choose(rows, blocks, np.zeros(70, int), specification)
        worth = {
            (i, j): (blocks[i] | blocks[j]).sum()
            for i in range(12)
            for j in range(12)
            if i != j and (blocks[i, 0] | blocks[j, 0])
        }
        if worth:
            assert worth[tuple(found)] == max(worth.values())
        else:
            assert found is None


@pytest.mark.parametrize("on_table", [0, 2])
def test_more_chosen_obstacles_block_the_mean(on_table):
    rng = np.random.default_rng(9)
    specification = DifficultySpecification(4, on_table, 0.0, 0.0)
    best, found_any = 0, 0
    for _ in range(30):
        rows, blocks = chosen_by_hand(rng)
        blocks[5, 0] = True
        chosen = choose(rows, blocks, np.zeros(70, int), specification)
        assert len(set(chosen)) == 4
        assert blocks[chosen, 0].any()
        assert (rows[chosen[4 - on_table :], 3] == 0.05).all()
        found_any += blocks[chosen].any(axis=0).sum()
        best += blocks[rng.permutation(12)[:4]].any(axis=0).sum()
    assert found_any > best


def test_nothing_is_chosen_where_obstacles_stand_in_one_another():
    rows, blocks = chosen_by_hand(np.random.default_rng(10))
    specification = DifficultySpecification(2, 0, 0.0, 0.0)
    rows[:, 1] = 0.0
    rows[:, 3] = 0.3
    assert choose(rows, blocks, np.zeros(70, int), specification) is None
