"""DrawS: its rules against brute force, scenes and demonstrations against the physics."""

import json
from itertools import pairwise

import numpy as np
import pytest
from resampled_lines import piecewise_linear
from scipy.spatial.transform import Rotation

from smp_gym.datasets import lasa
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import FAILURE_REWARD, ManipulationEnv
from smp_gym.observation import MAX_EPISODE_STEPS, decode, encode_desired_goal
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, JOINT_VELOCITY, PEN_RADIUS, PEN_TIP
from smp_gym.robot.pen import pen_path
from smp_gym.rollout import play
from smp_gym.sampling import sample_scene
from smp_gym.scene import STROKE_POINTS, Goal, Obstacle
from smp_gym.tasks import make_task
from smp_gym.tasks.common import POTENTIAL_PER_METRE
from smp_gym.tasks.draw_s.rules import (
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


def test_equal_arc_is_interpolation_of_the_arc_also_where_the_pen_paused():
    rng = np.random.default_rng(3)
    for _ in range(50):
        walk = np.cumsum(rng.normal(0.0, 0.02, (rng.integers(2, 60), 3)), axis=0)
        walk = np.repeat(walk, rng.integers(1, 4, len(walk)), axis=0)
        np.testing.assert_allclose(equal_arc(walk), piecewise_linear(walk, 32), atol=1e-12)


def brute_force_reached(trace, checkpoints, demanded):
    """Walk along a finely cut trace and tick off one checkpoint after the other."""
    fine = np.concatenate(
        [np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(trace)] + [trace[-1:]]
    )
    near = np.linalg.norm(fine[:, None] - checkpoints, axis=-1) <= CHECKPOINT_TOLERANCE
    k = 0
    for passed in near:
        while k < len(checkpoints) and (demanded[k] == 0 or passed[k]):
            k += 1
    return k


def test_order_is_judged_as_by_walking_along_the_trace():
    rng = np.random.default_rng(0)
    agreed, reached = 0, []
    for _ in range(100):
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
    assert agreed >= 97  # the rule cuts the trace less finely
    assert len(set(reached)) > 10


def reached_by_arrays(trace, checkpoints, demanded):
    """The same rule with arrays: for each checkpoint the first near point from the last on."""
    share = np.arange(3)[:, None] / 3
    cut = trace[:-1, None] + share * np.diff(trace, axis=0)[:, None]
    line = np.concatenate([cut.reshape(-1, 3), trace[-1:]])
    near = np.linalg.norm(line[:, None] - checkpoints, axis=-1) <= CHECKPOINT_TOLERANCE
    place = 0
    for k in np.flatnonzero(demanded):
        fitting = np.flatnonzero(near[place:, k])
        if not len(fitting):
            return k
        place += fitting[0]
    return len(checkpoints)


def test_many_traces_are_judged_as_each_by_arrays():
    rng = np.random.default_rng(4)
    traces = LINE + rng.normal(0.0, 0.03, (40, 5, STROKE_POINTS, 3))
    demanded = (rng.uniform(size=(40, 1, STROKE_POINTS)) < 0.8).astype(float)
    found = passed_in_order(traces, LINE, demanded)
    assert found.shape == (40, 5)
    for i, j in np.ndindex(40, 5):
        assert found[i, j] == reached_by_arrays(traces[i, j], LINE, demanded[i, 0])
    assert len(set(found.ravel())) > 10


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
    assert values[0] == pytest.approx(
        -POTENTIAL_PER_METRE * np.linalg.norm(LINE[-1] - LINE[0]), rel=0.1
    )
    assert values[-1] == pytest.approx(0.0, abs=1e-9)
    assert (np.diff(values) > -POTENTIAL_PER_METRE * CHECKPOINT_TOLERANCE).all()


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
    assert reward == FAILURE_REWARD


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


def test_demonstrations_are_there_in_cartesian_space(demonstrations, env):
    pen = demonstrations.pen_paths
    assert pen.shape == (7, 200, 3)
    assert (np.ptp(pen, axis=1) > [0.08, 0.3, 0.3]).all()
    np.testing.assert_allclose(pen, demonstrations.metadata["pen"], atol=1e-5)
    play(
        env,
        demonstrations.scenes[3],
        demonstrations.configurations[3],
        duration=demonstrations.durations[3],
    )
    # The episode ends as soon as the pen is near enough to the end of the stroke.
    drawn, line = env._cell.status.trace, equal_arc(pen[3], 1000)
    nearest = np.linalg.norm(drawn[:, None] - line, axis=-1).argmin(axis=1)
    assert np.linalg.norm(drawn - line[nearest], axis=1).max() < 0.003
    assert nearest[0] == 0
    assert nearest[-1] > 950
    with pytest.raises(ValueError, match="only demonstrations of DrawS have pen_paths"):
        _ = Demonstrations.load("Placement").pen_paths


def test_demonstrations_keep_the_shape_of_the_handwriting(demonstrations):
    for letter, pen in zip(lasa.demonstrations("Sshape"), demonstrations.pen_paths, strict=True):
        flat = np.column_stack([letter, np.zeros(len(letter))])
        written, drawn = equal_arc(flat, 50), equal_arc(pen, 50)
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


# The environment


def test_the_trace_holds_the_pens_places_however_long_the_episode():
    env = ManipulationEnv("DrawS", difficulty="none")
    observation, _ = env.reset(seed=1)
    action = np.zeros(7, np.float32)
    places, early = [decode(observation, "DrawS").object.position], env._cell.status.trace
    for step in range(MAX_EPISODE_STEPS + 20):
        action[0] = 0.2 if step % 100 < 50 else -0.2
        observation, *_ = env.step(action)
        places.append(decode(observation, "DrawS").object.position)
    np.testing.assert_allclose(env._cell.status.trace, places, atol=1e-6)
    env.reset(seed=2)
    assert len(env._cell.status.trace) == 1
    np.testing.assert_allclose(early, places[:1], atol=1e-6)
    env.close()


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
