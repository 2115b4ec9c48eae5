"""The environment from outside: what a user of Gymnasium and stable-baselines3 relies on."""

import json
import pickle
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo
from rollouts import rollout_digest

import smp_gym
from smp_gym.env import FAILURE_REWARD, SHAPING_DISCOUNT, SUCCESS_REWARD, ManipulationEnv
from smp_gym.observation import CONTROL_PERIOD, MAX_EPISODE_STEPS, decode
from smp_gym.physics.workcell import SUBSTEPS
from smp_gym.robot import kinematics
from smp_gym.sampling import sample_scene
from smp_gym.scene import (
    BIN_HEIGHT,
    BIN_INNER_HALF_WIDTH,
    BIN_WALL_THICKNESS,
    EVALUATION_SEEDS_START,
    MAX_OBSTACLES,
    Goal,
    Obstacle,
)
from smp_gym.tasks.common import POTENTIAL_PER_METRE
from smp_gym.tasks.placement.rules import (
    HELD_OBJECT_POSE,
    NOMINAL_BIN,
    RELEASE_HEIGHT,
    RELEASE_TILT,
    START_CONFIGURATION,
)

PLACEMENT = "smp_gym/Placement-v0"
IDS = [entry.id for entry in smp_gym.ENVIRONMENTS]
STAY = np.zeros(7, np.float32)
OPEN = np.array([0, 0, 0, 0, 0, 0, -1], np.float32)
EMPTY = sample_scene("Placement", "none", 0)
SCENE = sample_scene("Placement", "medium", 5)
BALL = {"shape": "sphere", "position": (1.0, 1.0, 1.0), "size": (0.05, 0.05, 0.05)}


@pytest.fixture(scope="module")
def env():
    env = ManipulationEnv()
    yield env
    env.close()


@pytest.fixture(scope="module")
def dense():
    env = ManipulationEnv(reward="dense")
    yield env
    env.close()


def scene_with(*obstacles, bin_position=NOMINAL_BIN):
    return EMPTY.model_copy(
        update={
            "difficulty": "custom",
            "seed": None,
            "obstacles": obstacles,
            "goals": (Goal(position=bin_position),),
        }
    )


def cube(position, half=0.04):
    return Obstacle(shape="box", position=tuple(position), size=(half, half, half))


def drive(env, target, *, fraction=0.9, steps=300):
    """Move straight to a configuration and stop; return the last step's results."""
    limit = fraction * kinematics.JOINT_VELOCITY * CONTROL_PERIOD
    reference = decode(env._observe(), "Placement").robot.reference
    results = []
    for _ in range(steps):
        move = np.asarray(target) - reference
        if np.abs(move).max() < 1e-6:
            break
        move = move / max(1.0, np.abs(move / limit).max())
        reference = reference + move
        action = np.append(move / (kinematics.JOINT_VELOCITY * CONTROL_PERIOD), 0.0)
        results.append(env.step(action.astype(np.float32)))
        if results[-1][2]:
            break
    return results


def release_configuration(scene):
    x, y, z = scene.goals[0].position
    yaw = np.arctan2(y, x)
    tilt = RELEASE_TILT
    approach = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), -np.sin(tilt)])
    opening = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    rotation = np.column_stack([approach, opening, np.cross(approach, opening)])
    position = np.array([x, y, z + RELEASE_HEIGHT]) - rotation @ HELD_OBJECT_POSE[:3, 3]
    seed = np.array([-2.08, 3.75, 1.0, 0.05, 2.45, -0.02])
    return kinematics.inverse_kinematics(position, rotation, seed=seed)


def place(env):
    """Carry the object to above the bin, over a raised way, and let go."""
    start, end = np.array(START_CONFIGURATION), release_configuration(env.scene)
    over = (start + end) / 2
    over[1] -= 0.25
    results = drive(env, over) + drive(env, end)
    while not results[-1][2] and len(results) < MAX_EPISODE_STEPS:
        results.append(env.step(OPEN))
    return results


# What Gymnasium and stable-baselines3 demand


@pytest.mark.parametrize("id", IDS)
def test_specification(id):
    spec = gymnasium.spec(id)
    assert isinstance(spec.entry_point, str)
    assert spec.max_episode_steps == MAX_EPISODE_STEPS
    assert json.loads(json.dumps(spec.kwargs)) == spec.kwargs
    assert gymnasium.make(id).render_mode is None


def test_registering_again_changes_nothing():
    before = {id: gymnasium.spec(id) for id in IDS}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        smp_gym.register_envs()
    assert {id: gymnasium.spec(id) for id in IDS} == before


def test_time_runs_out_after_the_limit():
    env = gymnasium.make(PLACEMENT, difficulty="none")
    env.reset(seed=0)
    for step in range(1, MAX_EPISODE_STEPS + 1):
        _, reward, terminated, truncated, info = env.step(STAY)
        assert (reward, terminated) == (0.0, False)
        assert truncated is (step == MAX_EPISODE_STEPS)
        assert info["failure"] == ("timeout" if truncated else "")
    env.close()


# Scenes, seeds, determinism


def test_a_seed_is_a_scene(env):
    for difficulty in ("none", "hard"):
        other = ManipulationEnv(difficulty=difficulty)
        _, info = other.reset(seed=7)
        assert other.scene == sample_scene("Placement", difficulty, 7)
        assert (info["seed"], info["difficulty"]) == (7, difficulty)
        other.close()


def test_resets_without_seed_repeat_after_a_seed_and_keep_to_tuning_seeds(env):
    runs = []
    for _ in range(2):
        env.reset(seed=123)
        runs.append([env.reset()[1]["seed"] for _ in range(5)])
    assert runs[0] == runs[1]
    assert len(set(runs[0])) > 1
    assert all(0 <= seed < EVALUATION_SEEDS_START for seed in runs[0])


def test_an_evaluation_seed_is_played_when_asked_for(env):
    _, info = env.reset(seed=EVALUATION_SEEDS_START + 3)
    assert info["seed"] == EVALUATION_SEEDS_START + 3


def test_an_episode_is_the_same_bit_for_bit_whatever_was_played_before():
    scenes = [sample_scene("Placement", "medium", seed) for seed in range(4)]
    digests = []
    for scene in scenes:
        fresh = ManipulationEnv()
        digests.append(rollout_digest(fresh, scene))
        fresh.close()
    used = ManipulationEnv(difficulty="hard")
    for k in (3, 3, 0, 2, 1, 3, 0):
        assert rollout_digest(used, scenes[k]) == digests[k]
    used.close()


def test_an_episode_is_the_same_bit_for_bit_in_a_rebuilt_world(env):
    before = rollout_digest(env, SCENE)
    other = EMPTY.model_copy(update={"start": tuple(np.add(EMPTY.start, 0.1).tolist())})
    env.reset(options={"scene": other})
    np.testing.assert_allclose(
        decode(env._observe(), "Placement").robot.configuration, other.start, atol=2e-3
    )
    assert rollout_digest(env, SCENE) == before


@pytest.mark.parametrize("form", [lambda s: s, lambda s: s.to_json(), lambda s: s.model_dump()])
def test_a_scene_can_be_replayed_in_every_form(env, form):
    scene = sample_scene("Placement", "easy", 21)
    _, info = env.reset(options={"scene": form(scene)})
    assert env.scene == scene
    assert info["difficulty"] == "easy"
    assert decode(env._observe(), "Placement").scene.obstacles[0].shape == scene.obstacles[0].shape


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene": "no json"}, "JSON"),
        ({"scene": "{}"}, "task"),
        ({"scene": {**EMPTY.model_dump(), "task": "Juggling"}}, "Juggling"),
        ({"scene": 5}, "int"),
        ({"seen": EMPTY}, "seen"),
        ({"scene": sample_scene("DrawS", "none", 0)}, "must be 'Placement', got 'DrawS'"),
        (
            {"scene": {**EMPTY.model_dump(), "obstacles": [BALL] * (MAX_OBSTACLES + 1)}},
            "at most 16",
        ),
        ({"scene": {**EMPTY.model_dump(), "obstacles": [{**BALL, "size": None}]}}, "size"),
        ({"scene": {**EMPTY.model_dump(), "obstacles": [{**BALL, "size": (0, 0, 0)}]}}, "size"),
        ({"scene": EMPTY.model_copy(update={"manipulated": None})}, "manipulated"),
        ({"scene": scene_with(bin_position=(1.1, 0.9, 0.01))}, r"goals\[0\] .*\[1.1, 0.9, 0.01\]"),
        ({"scene": scene_with(bin_position=(0.4, 0.3, -0.01))}, "above the table"),
    ],
)
def test_bad_scenes_are_refused_and_the_environment_stays_usable(env, options, message):
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    env.reset(seed=1)
    env.step(STAY)


def test_a_scene_that_begins_with_a_collision_is_refused(env):
    with pytest.raises(ValueError, match="obstacle_0"):
        env.reset(options={"scene": scene_with(cube((0.0, 0.0, 0.1)))})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(STAY)
    env.reset(seed=1)
    env.step(STAY)


def test_an_object_that_does_not_fit_the_hand_is_refused(env):
    wide = EMPTY.model_copy(
        update={"manipulated": EMPTY.manipulated.model_copy(update={"size": (0.03, 0.2, 0.03)})}
    )
    with pytest.raises(ValueError, match=r"0\.2"):
        env.reset(options={"scene": wide})
    env.reset(seed=1)
    env.step(STAY)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.full(7, np.nan), "nan"),
        (np.array([np.inf, 0, 0, 0, 0, 0, 0]), "inf"),
        (np.zeros(6), r"\(6,\)"),
        (np.zeros((1, 7)), r"\(1, 7\)"),
        (np.array([0, 1.01, 0, 0, 0, 0, 0]), r"1\.01"),
        (None, "must be real numbers"),
        ("up", "up"),
        (np.array(["a"] * 7), "must be real numbers"),
        (np.array([object()] * 7), "must be real numbers"),
    ],
)
def test_bad_actions_are_refused_and_move_nothing(env, action, message):
    env.reset(seed=1)
    before = env._observe()
    with pytest.raises(ValueError, match=message):
        env.step(action)
    after = env._observe()
    for key, vector in before.items():
        np.testing.assert_array_equal(after[key], vector)
    env.step(STAY)


def test_rounding_beyond_the_bounds_is_forgiven(env):
    env.reset(seed=1)
    env.step(np.array([1 + 1e-7, 0, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "Juggling"}, "Placement"),
        ({"difficulty": "silly"}, "medium"),
        ({"reward": "gold"}, "sparse"),
        ({"render_mode": "ansi"}, "rgb_array"),
        ({"width": 0}, "width"),
        ({"height": 1.5}, "height"),
        ({"camera": {"zoom": 2}}, "distance"),
    ],
)
def test_bad_arguments_list_what_exists(arguments, message):
    with pytest.raises(ValueError, match=message):
        ManipulationEnv(**arguments)


# Episodes


@pytest.mark.parametrize("seed", range(3))
def test_a_scripted_placement_succeeds(env, seed):
    env.reset(options={"scene": sample_scene("Placement", "none", seed)})
    results = place(env)
    observation, reward, terminated, _, info = results[-1]
    assert terminated
    assert (info["is_success"], info["failure"]) == (True, "")
    assert reward == SUCCESS_REWARD
    assert [r[1] for r in results[:-1]] == [0.0] * (len(results) - 1)
    assert (info["failure"], info["collided"], info["collision"]) == ("", False, None)
    x, y, z = decode(observation, "Placement").object.position
    bin_x, bin_y, floor = env.scene.goals[0].position
    assert max(abs(x - bin_x), abs(y - bin_y)) < 0.06
    # The box, half-extents 25, 25 and 30 mm, lies flat on one of its sides.
    assert min(abs(z - floor - half) for half in (0.025, 0.03)) < 2e-3


def test_success_needs_the_object_at_rest(env):
    env.reset(options={"scene": EMPTY})
    results = place(env)
    flags = [decode(r[0], "Placement") for r in results]
    speeds = [np.linalg.norm(f.object.linear_velocity) for f in flags[-5:]]
    assert max(speeds) < 0.01
    assert all(not r[4]["is_success"] for r in results[:-1])


def until_the_end(env, action, most=80):
    results = []
    while len(results) < most and not (results and results[-1][2]):
        results.append(env.step(action))
    return results


def test_an_object_dropped_on_the_table_ends_the_episode_once_it_rests(env):
    env.reset(options={"scene": EMPTY})
    results = until_the_end(env, OPEN)
    _, reward, terminated, _, info = results[-1]
    assert terminated
    assert reward == FAILURE_REWARD
    assert (info["failure"], info["collided"], info["is_success"]) == ("dropped", False, False)
    assert results[3][4]["failure"] == ""
    assert all(r[1] == 0.0 for r in results[:-1])


def collide(env, scene, target):
    env.reset(options={"scene": scene})
    results = drive(env, target)
    observation, reward, terminated, _, info = results[-1]
    assert terminated
    assert reward == FAILURE_REWARD
    assert (info["failure"], info["collided"], info["is_success"]) == ("collision", True, False)
    assert decode(observation, "Placement").collided
    assert all(r[1] == 0.0 and not r[4]["collided"] for r in results[:-1])
    return info["collision"]


def held_object(configuration=START_CONFIGURATION):
    return (kinematics.end_effector_pose(np.array(configuration)) @ HELD_OBJECT_POSE)[:3, 3]


def turned(angle, configuration=START_CONFIGURATION):
    """Return the configuration turned about the vertical, joint 1 being upside down."""
    return (configuration[0] - angle, *configuration[1:])


def lowered(angle):
    """Return the start leaning forward in the shoulder."""
    return (START_CONFIGURATION[0], START_CONFIGURATION[1] + angle, *START_CONFIGURATION[2:])


def test_collision_of_the_object_with_an_obstacle(env):
    below = held_object() - np.array([0.0, 0.0, 0.09])
    assert collide(env, scene_with(cube(below, 0.03)), lowered(0.3)) == ("object", "obstacle_0")


def test_collision_of_the_arm_with_an_obstacle(env):
    elbow = kinematics.link_transforms(np.array(turned(0.5)))[3, :3, 3]
    wrist = kinematics.link_transforms(np.array(turned(0.5)))[4, :3, 3]
    pair = collide(env, scene_with(cube((elbow + wrist) / 2, 0.03)), turned(0.8))
    assert pair[1] == "obstacle_0"
    assert pair[0].startswith("j2s6s200_link_")


def test_collision_of_the_held_object_with_the_table(env):
    assert collide(env, EMPTY, lowered(0.7)) == ("object", "table")


def test_collision_of_the_held_object_with_the_bin(env):
    x, y, z = held_object()
    wall = BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS / 2
    under = scene_with(bin_position=(x, y + wall, z - BIN_HEIGHT - 0.06))
    assert collide(env, under, lowered(0.3)) == ("bin", "object")


def test_collision_of_the_hand_with_the_table_and_with_the_bin(env):
    for scene, other in ((EMPTY, "table"), (None, "bin")):
        if scene is None:
            x, y, _ = held_object(turned(0.5))
            scene = scene_with(bin_position=(x, y, held_object()[2] - 0.05))
        env.reset(options={"scene": scene})
        # Without the object, which falls beside the table and never rests, the hand comes first.
        env.unwrapped._cell.world.place("object", (5.0, 5.0, -5.0))
        results = drive(env, turned(0.25 if other == "table" else 0.8))
        if other == "table":
            results += drive(
                env, (START_CONFIGURATION[0] - 0.25, START_CONFIGURATION[1] + 0.9, *EMPTY.start[2:])
            )
        _, reward, terminated, _, info = results[-1]
        assert terminated
        assert reward == FAILURE_REWARD
        assert other in info["collision"]
        assert any(part.startswith("j2s6s200_link_") for part in info["collision"])


def test_collision_of_the_arm_with_itself(env):
    folded = list(START_CONFIGURATION)
    folded[2], folded[4] = 0.35, 0.55
    pair = collide(env, EMPTY, folded)
    assert all(part.startswith("j2s6s200_link_") or part == "object" for part in pair)
    assert pair[0] != pair[1]


@pytest.mark.parametrize("substep", [0, 2, SUBSTEPS - 1])
def test_a_contact_in_any_single_physics_step_is_seen(env, monkeypatch, substep):
    env.reset(options={"scene": EMPTY})
    world = env._cell.world
    contacts, seen = world.contacts, []

    def graze():
        seen.append(contacts())
        grazed = {("j2s6s200_link_3", "table")} if len(seen) == substep + 1 else set()
        return seen[-1] | grazed

    monkeypatch.setattr(world, "contacts", graze)
    _, reward, terminated, _, info = env.step(STAY)
    assert terminated
    assert reward == FAILURE_REWARD
    assert info["collision"] == ("j2s6s200_link_3", "table")


def test_clearance_is_the_least_distance_so_far(env):
    position, half = held_object(), 0.03
    gap = 0.03
    above = position + np.array([0.0, 0.0, 0.15])
    env.reset(options={"scene": scene_with(cube(above))})
    assert env.step(STAY)[4]["clearance"] > 0.0
    ball = Obstacle(
        shape="sphere", position=tuple(position - [0, 0, half + gap + 0.1]), size=(0.1,) * 3
    )
    env.reset(options={"scene": scene_with(ball)})
    hand = kinematics.end_effector_pose(np.array(START_CONFIGURATION))[:3, :3]
    corners = np.array(np.meshgrid(*[np.linspace(-1, 1, 41)] * 3)).reshape(3, -1).T
    surface = position + corners * (0.025, 0.025, 0.03) @ hand.T
    distance = np.linalg.norm(surface - np.array(ball.position), axis=1).min() - 0.1
    clearance = env.step(STAY)[4]["clearance"]
    assert clearance <= distance + 1e-3
    assert clearance > 0.0
    nearest = clearance
    for _ in range(20):
        clearance = env.step(np.array([1, 0, 0, 0, 0, 0, 0], np.float32))[4]["clearance"]
        assert clearance <= nearest
        nearest = clearance


# Rewards


def test_reward_of_goals_is_the_reward_of_the_step(env):
    env.reset(options={"scene": EMPTY})
    for observation, reward, _, _, _ in place(env)[::10]:
        again = env.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})
        assert again == reward


def test_rewards_of_batches(env):
    desired = np.tile([0.5, 0.3, 0.04, 0.0, 1.0, 1.0, 1.0], (5, 1))
    achieved = desired.copy()
    achieved[1, [0, 5]] = 1.0, 0.0  # elsewhere and not yet at rest
    achieved[2, 3] = 1.0  # collided
    achieved[3, 0] = 1.0  # let go and at rest elsewhere
    achieved[4, [0, 4]] = 1.0, 0.0  # elsewhere, still in the hand
    rewards = env.compute_reward(achieved, desired, [{}] * 5)
    np.testing.assert_array_equal(
        rewards, [SUCCESS_REWARD, 0.0, FAILURE_REWARD, FAILURE_REWARD, 0.0]
    )


@pytest.mark.parametrize("finish", [place, lambda e: drive(e, turned(0.6))])
def test_dense_rewards_add_up_to_sparse_ones_plus_the_first_potential(dense, finish):
    """Ng et al. 1999: discounted shaping telescopes to minus the potential of the first state."""
    blocked = finish is not place
    ahead = held_object(turned(0.4))
    scene = scene_with(cube(ahead, 0.025)) if blocked else EMPTY
    observation, _ = dense.reset(options={"scene": scene})
    achieved = observation["achieved_goal"].astype(np.float64)
    start = -POTENTIAL_PER_METRE * np.linalg.norm((achieved - observation["desired_goal"])[:3])
    results = finish(dense)
    assert results[-1][2]
    rewards = np.array([r[1] for r in results])
    sparse = np.zeros(len(results))
    sparse[-1] = FAILURE_REWARD if blocked else SUCCESS_REWARD
    discounts = SHAPING_DISCOUNT ** np.arange(len(results))
    assert rewards @ discounts == pytest.approx(sparse @ discounts - start, abs=1e-6)


def test_dense_rewards_of_batches_need_the_goals_before(dense):
    dense.reset(seed=0)
    steps = [dense.step(np.full(7, 0.1, np.float32)) for _ in range(3)]
    achieved = np.stack([s[0]["achieved_goal"] for s in steps])
    desired = np.stack([s[0]["desired_goal"] for s in steps])
    rewards = dense.compute_reward(achieved, desired, np.array([s[4] for s in steps]))
    np.testing.assert_array_equal(rewards, [s[1] for s in steps])
    with pytest.raises(ValueError, match="copy_info_dict"):
        dense.compute_reward(achieved, desired, [{}])


# Pictures, copies, endings


def test_pictures_show_the_scene(tmp_path):
    env = ManipulationEnv(render_mode="rgb_array", width=160, height=120)
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    yellow = (first[..., 0] > 120) & (first[..., 1] > 90) & (first[..., 2] < first[..., 1] // 2)
    assert yellow.sum() > 10
    for _ in range(10):
        env.step(np.array([-1, 0, 0, 0, 0, 0, 0], np.float32))
    assert (env.render() != first).any()
    env.close()


def test_episodes_can_be_recorded(tmp_path):
    env = gymnasium.make(PLACEMENT, render_mode="rgb_array", width=96, height=64)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        recorder = RecordVideo(env, str(tmp_path / "videos"), disable_logger=True)
        recorder.reset(seed=0)
        for _ in range(5):
            recorder.step(STAY)
        recorder.close()
    (video,) = tmp_path.glob("videos/*.mp4")
    assert video.stat().st_size > 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="X servers are Linux's")
def test_a_window_without_display_is_a_clear_error(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="rgb_array"):
        ManipulationEnv(render_mode="human")


def test_a_pickled_environment_is_made_anew():
    env = ManipulationEnv(difficulty="easy", reward="dense", width=100)
    copy = pickle.loads(pickle.dumps(env))
    assert (copy.difficulty, copy.reward) == ("easy", "dense")
    first, second = env.reset(seed=3)[0], copy.reset(seed=3)[0]
    for key, vector in first.items():
        np.testing.assert_array_equal(second[key], vector)
    env.close()
    copy.close()


def test_closing_twice_is_harmless_and_then_it_is_closed():
    env = ManipulationEnv()
    env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(STAY)


def test_stepping_before_the_first_reset_is_a_clear_error():
    env = ManipulationEnv()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(STAY)
    env.close()


def test_instances_share_nothing_they_change():
    before = json.dumps(ManipulationEnv.metadata)
    env = ManipulationEnv(render_mode="rgb_array", camera={"distance": 2.0})
    assert json.dumps(ManipulationEnv.metadata) == before == json.dumps(env.metadata)
    assert env.metadata["render_fps"] == 20
    env.close()
