"""DoubleSidedPlacement: its rules on goals made by hand, its data and scenes in the physics."""

from functools import cache

import gymnasium
import numpy as np
import pybullet
import pytest
from bullet_arm import Bullet

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import decode
from smp_gym.robot import kinematics
from smp_gym.rollout import play
from smp_gym.sampling import SPECIFICATIONS, sample_scene, sample_with_witness
from smp_gym.scene import (
    PAD_HALF_WIDTH,
    Goal,
    ManipulatedObject,
    Obstacle,
    Scene,
    fixtures,
)
from smp_gym.tasks import Status
from smp_gym.tasks.common import POTENTIAL_PER_METRE
from smp_gym.tasks.double_sided_placement.rules import (
    HELD_OBJECT_POSE,
    NOMINAL_PADS,
    PAD_LOWEST,
    PAD_SHIFT,
    PAD_TOP,
    RELEASE_GAP,
    START_CONFIGURATION,
    TILT,
    DoubleSidedPlacement,
)
from smp_gym.tasks.status import CALM_STEPS

TASK = DoubleSidedPlacement()
LEFT, RIGHT = (0.4, 0.45, 0.13), (0.45, -0.4, 0.08)
DESIRED = np.array([*LEFT, *RIGHT, 0.0, 1.0, 1.0, 1.0])
ID = "smp_gym/DoubleSidedPlacement-v0"
BLOCKED = ("easy", "medium", "hard")
SEEDS = range(1, 5)
"""Of scenes that are drawn in a second or two; the easy one of seed 0 takes many."""


def goal(place, offset=(0.0, 0.0, 0.0), collided=0.0, released=1.0, at_rest=1.0, supported=1.0):
    position = np.add(place, offset)
    return np.array([*position, *position, collided, released, at_rest, supported])


def scene(**changes):
    values = {
        "task": "DoubleSidedPlacement",
        "start": START_CONFIGURATION,
        "manipulated": ManipulatedObject(),
        "goals": tuple(Goal(kind="pad", position=p) for p in NOMINAL_PADS),
        **changes,
    }
    return Scene(**values)


# --- The rules -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("achieved", "side"),
    [
        (goal(LEFT), "left"),
        (goal(RIGHT), "right"),
        (goal(LEFT, offset=(PAD_HALF_WIDTH - 1e-3, 1e-3 - PAD_HALF_WIDTH, 0.01)), "left"),
        (goal(LEFT, offset=(PAD_HALF_WIDTH + 1e-3, 0.0, 0.0)), ""),
        (goal(RIGHT, offset=(0.0, -PAD_HALF_WIDTH - 1e-3, 0.0)), ""),
        (goal(RIGHT, offset=(0.0, 0.0, 0.02)), ""),
        (goal(RIGHT, offset=(0.0, 0.0, -0.02)), ""),
        (goal(np.add(LEFT, RIGHT) / 2), ""),
        (goal(LEFT, collided=1.0), ""),
        (goal(LEFT, released=0.0), ""),
        (goal(RIGHT, at_rest=0.0), ""),
    ],
)
def test_success_is_rest_on_either_pad_without_collision(achieved, side):
    assert bool(TASK.success(achieved, DESIRED)) is (side != "")
    assert TASK.details(achieved, DESIRED) == {"side": side}


@pytest.mark.parametrize(
    ("achieved", "lost"),
    [
        (goal(LEFT), False),
        (goal(RIGHT), False),
        (goal(LEFT, offset=(0.0, 0.2, 0.0)), True),
        (goal(LEFT, offset=(0.0, 0.2, 0.0), at_rest=0.0), False),
        (goal(LEFT, offset=(0.0, 0.2, 0.0), released=0.0), False),
    ],
)
def test_an_object_at_rest_elsewhere_is_lost(achieved, lost):
    assert bool(TASK.lost(achieved, DESIRED)) is lost


def test_goals_are_judged_in_any_shape_as_one_by_one():
    rng = np.random.default_rng(0)
    shape = (5, 8)
    places = np.array([LEFT, RIGHT])[rng.integers(2, size=shape)]
    places = places + rng.uniform(-0.09, 0.09, (*shape, 3)) * (1.0, 1.0, 0.1)
    achieved = np.concatenate([places, places, rng.integers(0, 2, (*shape, 4))], axis=-1)
    achieved[..., 7:] = rng.random((*shape, 3)) < 0.9
    desired = np.broadcast_to(DESIRED, achieved.shape)
    success, potential = TASK.success(achieved, desired), TASK.potential(achieved, desired)
    assert success.shape == potential.shape == shape
    assert 0 < success.sum() < success.size
    for index in np.ndindex(*shape):
        assert success[index] == TASK.success(achieved[index], DESIRED)
        distances = [np.sqrt(((places[index] - place) ** 2).sum()) for place in (LEFT, RIGHT)]
        assert potential[index] == pytest.approx(-POTENTIAL_PER_METRE * min(distances))


def test_the_achieved_goal_is_reached_by_itself():
    lying = Status(np.array(LEFT), frozenset({"pad"}), False, CALM_STEPS, False)
    values = TASK.achieved_goal(lying)
    achieved = np.concatenate([np.atleast_1d(value) for value in values.values()])
    np.testing.assert_array_equal(achieved, goal(LEFT))
    assert TASK.success(achieved, achieved)


def test_pads_may_be_touched_by_the_released_object_only():
    assert ("object", "pad") not in TASK.permitted_contacts(held=True)
    assert ("object", "pad") in TASK.permitted_contacts(held=False)
    for held in (True, False):
        permitted = TASK.permitted_contacts(held)
        assert all(pair == tuple(sorted(pair)) for pair in permitted)
        assert not any({"arm", "obstacle", "bin"} & set(pair) for pair in permitted)
        assert ("hand", "pad") not in permitted


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"manipulated": None}, "manipulated"),
        ({"goals": (Goal(kind="pad", position=NOMINAL_PADS[0]),)}, "two pads, got 1"),
        ({"goals": tuple(Goal(position=p) for p in NOMINAL_PADS)}, "kind 'pad', got 'bin'"),
        (
            {"goals": tuple(Goal(kind="pad", position=p) for p in reversed(NOMINAL_PADS))},
            "the left pad",
        ),
        ({"goals": tuple(Goal(kind="pad", position=(x, y, 0.3)) for x, y, _ in NOMINAL_PADS)}, "0"),
        ({"start": (6.5, 3.5, 1.0, 0.0, 2.0, 0.0)}, "start"),
    ],
)
def test_unplayable_scenes_are_refused(changes, message):
    TASK.check_scene(scene())
    with pytest.raises(ValueError, match=message):
        TASK.check_scene(scene(**changes))


def test_the_start_is_midway_and_upright():
    held = kinematics.end_effector_pose(np.array(START_CONFIGURATION)) @ HELD_OBJECT_POSE
    np.testing.assert_allclose(held[:3, 3], (0.5, 0.0, 0.35), atol=1e-3)
    np.testing.assert_allclose(held[:3, :3], np.eye(3), atol=2e-3)


def release(position):
    """Return the configuration that holds the object upright just above a pad."""
    x, y, z = position
    yaw = np.arctan2(y, x)
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    approach = np.cos(TILT) * forward - np.array([0.0, 0.0, np.sin(TILT)])
    opening = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    rotation = np.column_stack([approach, opening, np.cross(approach, opening)])
    center = np.array([x, y, z + ManipulatedObject().size[2] + RELEASE_GAP])
    seed = np.array(START_CONFIGURATION)
    seed[0] -= yaw
    return kinematics.inverse_kinematics(
        center - rotation @ HELD_OBJECT_POSE[:3, 3], rotation, seed=seed
    )


@pytest.mark.parametrize("nominal", NOMINAL_PADS)
@pytest.mark.parametrize("angle", np.linspace(0.0, 2 * np.pi, 8, endpoint=False))
@pytest.mark.parametrize("height", [PAD_LOWEST, PAD_TOP])
def test_every_pad_is_in_reach_with_margin(nominal, angle, height):
    x, y = nominal[:2] + PAD_SHIFT * np.array([np.cos(angle), np.sin(angle)])
    solution = release((x, y, height))
    limited = [1, 2, 4]
    room = np.minimum(solution - kinematics.JOINT_LOWER, kinematics.JOINT_UPPER - solution)[limited]
    assert room.min() > 0.05
    assert abs(solution[4] - np.pi) > 0.15


# --- The environment -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make(ID)
    yield made
    made.close()


def test_an_observation_gives_the_pads_back(env):
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        decoded = decode(observation, "DoubleSidedPlacement").scene
        drawn = env.unwrapped.scene
        assert info["side"] == ""
        assert [g.kind for g in decoded.goals] == ["pad", "pad"]
        for after, before in zip(decoded.goals, drawn.goals, strict=True):
            np.testing.assert_allclose(after.position, before.position, atol=1e-6)


def surface(client, x, y):
    """Return the height that a ray from above meets first."""
    hits = pybullet.rayTest((x, y, 0.18), (x, y, -1.0), physicsClientId=client)
    return hits[0][3][2]


def test_pads_stand_where_the_scene_says(env):
    drawn = sample_scene("DoubleSidedPlacement", "none", 3)
    env.reset(options={"scene": drawn})
    client = env.unwrapped._cell.world.client
    for goal_, body in zip(drawn.goals, fixtures(drawn)[1:], strict=True):
        x, y, z = goal_.position
        assert body.position[2] + body.size[2] == pytest.approx(z)
        inside = PAD_HALF_WIDTH - 1e-3
        for dx, dy in ((0, 0), (inside, inside), (-inside, inside), (inside, -inside)):
            assert surface(client, x + dx, y + dy) == pytest.approx(z, abs=1e-4)
        outside = PAD_HALF_WIDTH + 1e-3
        for dx, dy in ((outside, 0), (0, outside), (-outside, 0), (0, -outside)):
            assert surface(client, x + dx, y + dy) == pytest.approx(0.0, abs=1e-4)


def test_lowering_the_held_object_onto_a_pad_is_a_collision(env):
    high = scene(goals=tuple(Goal(kind="pad", position=p) for p in NOMINAL_PADS))
    x, y, z = NOMINAL_PADS[1]
    end = release((x, y, z - RELEASE_GAP - 0.01))
    share = np.linspace(0.0, 1.0, 100)[:, None]
    info = play(env, high, np.array(START_CONFIGURATION) * (1 - share) + end * share)
    assert info["failure"] == "collision"
    assert info["collision"] == ("object", "pad_right")
    assert info["side"] == ""


# --- Demonstrations --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shipped():
    return Demonstrations.load("DoubleSidedPlacement")


def test_seven_demonstrations_go_to_each_side(shipped):
    assert shipped.configurations.shape == (14, 200, 6)
    assert np.abs(shipped.configurations[:, 0] - START_CONFIGURATION).max() < 2e-3
    ends = (kinematics.end_effector_pose(shipped.configurations[:, -1]) @ HELD_OBJECT_POSE)[:, :3]
    for side, group in zip(NOMINAL_PADS, (ends[:7], ends[7:]), strict=True):
        assert np.abs(group[:, :2, 3] - side[:2]).max() < PAD_HALF_WIDTH / 2
    velocity = np.diff(shipped.configurations, axis=1) * 199 / shipped.durations[:, None, None]
    assert (np.abs(velocity) <= 0.9 * kinematics.JOINT_VELOCITY).all()


@pytest.mark.parametrize("index", range(14))
def test_each_demonstration_succeeds_in_the_physics(shipped, index, env):
    info = play(
        env,
        shipped.scenes[index],
        shipped.configurations[index],
        duration=shipped.durations[index],
    )
    assert info["is_success"], info
    assert info["side"] == ("left" if index < 7 else "right")


# --- Scenes ----------------------------------------------------------------------------------


@cache
def drawn(difficulty):
    """Return scenes with witnesses, drawn once for all tests."""
    return [sample_with_witness("DoubleSidedPlacement", difficulty, seed) for seed in SEEDS]


def taken(drawn_scene):
    """Return the indices of the goals on whose pad an obstacle stands."""
    return [
        number
        for number, pad in enumerate(drawn_scene.goals)
        for o in drawn_scene.obstacles
        if np.abs(np.subtract(o.position, pad.position)[:2]).max() < PAD_HALF_WIDTH
        and o.position[2] - o.size[2] == pytest.approx(pad.position[2])
    ]


@pytest.mark.parametrize(("difficulty", "walls"), [("none", 0), ("easy", 1), ("medium", 1)])
def test_both_sides_are_blocked_and_open_or_one_is_closed_off(difficulty, walls):
    for drawn_scene, _ in drawn(difficulty):
        closed = len(taken(drawn_scene))
        assert closed <= (difficulty != "none")
        blocked = (2 - closed) * SPECIFICATIONS[difficulty].obstacles
        assert len(drawn_scene.obstacles) == walls + blocked + closed


def test_pads_are_where_the_task_says():
    for difficulty in ("none", *BLOCKED):
        for drawn_scene, _ in drawn(difficulty):
            for pad, nominal in zip(drawn_scene.goals, NOMINAL_PADS, strict=True):
                shift = np.subtract(pad.position, nominal)
                assert np.hypot(*shift[:2]) <= PAD_SHIFT
                assert PAD_LOWEST <= pad.position[2] <= PAD_TOP


def test_scenes_are_pure_functions():
    for difficulty in ("easy", "hard"):
        again = sample_with_witness("DoubleSidedPlacement", difficulty, 2)
        there = drawn(difficulty)[SEEDS.index(2)]
        assert again[0] == there[0]
        np.testing.assert_array_equal(again[1], there[1])


@pytest.mark.parametrize("difficulty", ["none", *BLOCKED])
def test_witnesses_succeed_in_the_physics(difficulty, env):
    for drawn_scene, witness in drawn(difficulty):
        info = play(env, drawn_scene, witness)
        assert info["is_success"], (drawn_scene.seed, info)


@pytest.fixture(scope="module")
def bullet():
    made = Bullet(HELD_OBJECT_POSE)
    yield made
    pybullet.disconnect(made.client)


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_real_shapes_on_the_witness_keep_its_clearance(difficulty, bullet):
    for drawn_scene, witness in drawn(difficulty)[:2]:
        least = bullet.clearance(witness[::2], drawn_scene.obstacles)
        assert least >= SPECIFICATIONS[difficulty].clearance - 1e-3


@pytest.mark.parametrize("difficulty", ["easy", "medium"])
def test_the_mean_is_blocked_on_both_sides(difficulty, bullet, shipped):
    phase = np.linspace(0.0, 1.0, 200)[:, None]
    blend = phase**3 * (10 - 15 * phase + 6 * phase**2)
    for drawn_scene, _ in drawn(difficulty):
        for side, pad in enumerate(drawn_scene.goals):
            mean = shipped.configurations[7 * side : 7 * side + 7].mean(axis=0)
            mean = mean + blend * (release(pad.position) - mean[-1])
            assert bullet.clearance(mean[::2], drawn_scene.obstacles) <= 0.0


def test_at_hard_one_pad_has_no_room_for_the_object(bullet):
    rng = np.random.default_rng(0)
    half = ManipulatedObject().size
    sides = set()
    for drawn_scene, witness in drawn("hard"):
        # The wall, those on the open side, and the one on the other pad.
        assert len(drawn_scene.obstacles) == 1 + SPECIFICATIONS["hard"].obstacles + 1
        (closed,) = taken(drawn_scene)
        sides.add(closed)
        end = (kinematics.end_effector_pose(witness[-1]) @ HELD_OBJECT_POSE)[:3, 3]
        open_pad = drawn_scene.goals[1 - closed].position
        np.testing.assert_allclose(end[:2], open_pad[:2], atol=1e-3)
        x, y, z = drawn_scene.goals[closed].position
        bodies = [bullet.body(obstacle) for obstacle in drawn_scene.obstacles]
        for _ in range(100):
            dx, dy = rng.uniform(-PAD_HALF_WIDTH, PAD_HALF_WIDTH, 2)
            yaw = rng.uniform(-np.pi, np.pi)
            block = Obstacle(
                shape="box",
                position=(x + dx, y + dy, z + half[2]),
                quaternion=(0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)),
                size=half,
            )
            body = bullet.body(block)
            touching = [
                p
                for b in bodies
                for p in pybullet.getClosestPoints(
                    body, b, 0.0, -1, -1, physicsClientId=bullet.client
                )
            ]
            assert touching
            pybullet.removeBody(body, physicsClientId=bullet.client)
        for body in bodies:
            pybullet.removeBody(body, physicsClientId=bullet.client)
    assert sides == {0, 1}
