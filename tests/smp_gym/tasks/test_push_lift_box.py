"""PushLiftBox: its rules on goals made by hand, its data and scenes in the physics."""

import gymnasium
import numpy as np
import pybullet
import pytest

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import FAILURE_REWARD, ManipulationEnv
from smp_gym.observation import CONTROL_PERIOD, decode
from smp_gym.robot.kinematics import JOINT_VELOCITY, end_effector_pose, inverse_kinematics
from smp_gym.rollout import play
from smp_gym.sampling import sample_scene, sample_with_witness
from smp_gym.scene import Goal, ManipulatedObject, Obstacle, Scene
from smp_gym.tasks.push_lift_box.rules import (
    BOX_BEARING,
    BOX_RADIUS,
    BOX_TURN,
    HAND_HEIGHT,
    HAND_TILT,
    HELD_OBJECT_POSE,
    PUSH_FROM,
    PUSH_LENGTH,
    START_CONFIGURATION,
    START_SPREAD,
    TARGET_BEARING,
    TARGET_HEIGHT,
    TARGET_RADIUS,
    TARGET_TOLERANCE,
    PushLiftBox,
    push_poses,
)
from smp_gym.tasks.push_lift_box.scenes import CROWDS

TASK = PushLiftBox()
ID = "smp_gym/PushLiftBox-v0"
BOX = ManipulatedObject(position=(0.48, -0.14, 0.03), yaw=-0.25)
TARGET = (0.4, 0.25, 0.32)
DESIRED = np.array([*TARGET, 0.0, 1.0])
BLOCKED = ("easy", "medium", "hard")
SEEDS = range(3)


def goal(offset=(0.0, 0.0, 0.0), collided=0.0, held=1.0):
    return np.array([*np.add(TARGET, offset), collided, held])


def scene(**changes):
    values = {
        "task": "PushLiftBox",
        "start": START_CONFIGURATION,
        "manipulated": BOX,
        "goals": (Goal(kind="lift", position=TARGET),),
        **changes,
    }
    return Scene(**values)


@pytest.fixture(scope="module")
def env():
    made = ManipulationEnv("PushLiftBox", "none")
    yield made
    made.close()


@pytest.fixture(scope="module")
def shipped():
    return Demonstrations.load("PushLiftBox")


@pytest.mark.parametrize(
    ("achieved", "reached"),
    [
        (goal(), True),
        (goal((0.0, 0.9 * TARGET_TOLERANCE, 0.0)), True),
        (goal((0.0, 1.1 * TARGET_TOLERANCE, 0.0)), False),
        (goal((0.6 * TARGET_TOLERANCE,) * 3), False),
        (goal(held=0.0), False),
        (goal(collided=1.0), False),
    ],
)
def test_success_needs_the_box_near_the_target_gripped_and_no_collision(achieved, reached):
    assert TASK.success(achieved, DESIRED) == reached
    batch = TASK.success(np.stack([achieved, goal()]), np.stack([DESIRED, DESIRED]))
    assert batch.tolist() == [reached, True]


def test_no_state_is_lost_and_nearer_is_better():
    far, near = goal((0.2, 0.0, 0.0)), goal((0.1, 0.0, 0.0))
    assert not TASK.lost(np.stack([far, near]), DESIRED).any()
    assert TASK.potential(near, DESIRED) > TASK.potential(far, DESIRED)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"manipulated": ManipulatedObject()}, "position on the table"),
        ({"manipulated": ManipulatedObject(position=(0.5, 0.0, 0.1))}, "0.03 m above the table"),
        ({"goals": (Goal(position=TARGET),)}, "kind 'lift', got \\['bin'\\]"),
        ({"goals": (Goal(kind="lift", position=(0.4, 0.2, 0.05)),)}, "must be lifted; got 0.05"),
        ({"start": (0.0, 0.1, 3.0, 0.0, 3.0, 0.0)}, "scene.start must lie between"),
        (
            {
                "obstacles": (
                    Obstacle(
                        shape="sphere",
                        position=(0.3, 0.5, 0.5),
                        size=(0.04, 0.04, 0.04),
                        velocity=(0.1, 0.0, 0.0),
                    ),
                )
            },
            "must stand still",
        ),
    ],
)
def test_scenes_that_cannot_be_played_are_refused(env, changes, message):
    with pytest.raises(ValueError, match=message):
        env.reset(options={"scene": scene(**changes)})
    env.reset(options={"scene": scene()})


def test_the_pose_of_an_object_goes_to_json_only_where_there_is_one():
    assert "position" not in ManipulatedObject().model_dump()
    assert Scene.from_json(scene().to_json()) == scene()
    with pytest.raises(ValueError, match=r"yaw of an object without position must be 0, got 0\.3"):
        ManipulatedObject(yaw=0.3)


def test_the_push_goes_straight_along_the_box():
    yaw, shares = 0.4, np.linspace(0.0, 1.0, 6)
    poses = push_poses(np.array([0.5, 0.1, 0.03]), yaw, shares)
    assert np.allclose(poses[:, 2, 3], HAND_HEIGHT)
    offsets = poses[:, :2, 3] - (0.5, 0.1)
    ahead, aside = (np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))
    assert np.allclose(offsets @ aside, 0.0)
    assert (offsets @ ahead)[0] == pytest.approx(-PUSH_FROM)
    # With the box where the palm has it at the end, it has gone the length of the push, upright.
    placed = poses[-1] @ HELD_OBJECT_POSE
    assert np.allclose(
        placed[:3, 3], np.array([0.5, 0.1, 0.03]) + PUSH_LENGTH * np.append(ahead, 0)
    )
    assert np.allclose(placed[:3, 2], (0.0, 0.0, 1.0))
    assert np.allclose(poses[:, 2, 0], -np.sin(HAND_TILT))


def test_an_episode_begins_with_the_box_at_rest_where_the_scene_puts_it(env):
    observation, _ = env.reset(options={"scene": scene()})
    state = decode(observation, "PushLiftBox")
    assert np.abs(state.object.position - BOX.position).max() < 2e-4
    assert np.linalg.norm(state.object.linear_velocity) < 2e-3
    assert np.allclose(state.object.quaternion[2:], (np.sin(-0.125), np.cos(-0.125)), atol=1e-4)
    assert np.abs(state.robot.finger_angles).max() < 0.02
    for _ in range(20):
        observation, *_ = env.step(np.zeros(7, np.float32))
    later = decode(observation, "PushLiftBox")
    assert np.abs(later.object.position - state.object.position).max() < 2e-4
    assert later.scene.goals[0].position == pytest.approx(TARGET, abs=1e-6)


def test_demonstrations_begin_all_over_the_region(shipped):
    starts = shipped.configurations[:, 0]
    assert len(shipped) == 7
    assert (np.abs(starts - START_CONFIGURATION) < np.array(START_SPREAD)).all()
    assert (np.ptp(starts, axis=0) > np.array(START_SPREAD) / 2).all()
    assert len({scene.manipulated.position for scene in shipped.scenes}) == 7


# All are played where they are recorded anew.
@pytest.mark.parametrize("number", [0, 3, 6])
def test_a_demonstration_succeeds_in_the_physics(env, shipped, number):
    grasp = int(shipped.gripper[number].argmax())
    info = play(
        env,
        shipped.scenes[number],
        shipped.configurations[number],
        float(shipped.durations[number]),
        grasp,
    )
    assert info["is_success"], info


def test_without_closing_the_hand_the_box_stays_on_the_table(env, shipped):
    info = play(env, shipped.scenes[0], shipped.configurations[0], grasp=len(shipped.mean) - 1)
    assert not info["is_success"]
    assert decode(env._observe(), "PushLiftBox").object.position[2] == pytest.approx(0.03, abs=2e-3)


def test_collision_of_the_hand_with_the_table(env):
    env.reset(options={"scene": scene()})
    start = np.array(START_CONFIGURATION)
    pose = end_effector_pose(start)
    low = inverse_kinematics(pose[:3, 3] * (1, 1, 0) + (0, 0, -0.03), pose[:3, :3], seed=start)
    for _ in range(200):
        reference = decode(env._observe(), "PushLiftBox").robot.reference
        move = (low - reference) / (JOINT_VELOCITY * CONTROL_PERIOD)
        move /= max(1.0, np.abs(move).max())
        _, reward, terminated, _, info = env.step(np.append(move, 0.0).astype(np.float32))
        if terminated:
            break
    assert info["collided"]
    assert "table" in info["collision"]
    assert reward == FAILURE_REWARD


@pytest.mark.parametrize("difficulty", ["none", *BLOCKED])
def test_witnesses_solve_their_scenes_in_the_physics(env, shipped, difficulty):
    grasp = shipped.metadata["push_samples"][1]
    for seed in range(4):
        drawn, witness = sample_with_witness("PushLiftBox", difficulty, seed)
        assert len(drawn.obstacles) == (CROWDS[difficulty][1] if difficulty in CROWDS else 0)
        info = play(env, drawn, witness, grasp=grasp)
        assert info["is_success"], (difficulty, seed, info)


def test_scenes_vary_within_their_regions():
    for seed in range(20):
        drawn = sample_scene("PushLiftBox", "none", seed)
        assert (np.abs(np.subtract(drawn.start, START_CONFIGURATION)) <= START_SPREAD).all()
        x, y, _ = drawn.manipulated.position
        bearing = np.arctan2(y, x)
        assert BOX_RADIUS[0] <= np.hypot(x, y) <= BOX_RADIUS[1]
        assert BOX_BEARING[0] <= bearing <= BOX_BEARING[1]
        assert abs(drawn.manipulated.yaw - bearing) <= BOX_TURN
        x, y, z = drawn.goals[0].position
        assert TARGET_RADIUS[0] <= np.hypot(x, y) <= TARGET_RADIUS[1]
        assert TARGET_BEARING[0] <= np.arctan2(y, x) <= TARGET_BEARING[1]
        assert TARGET_HEIGHT[0] <= z <= TARGET_HEIGHT[1]


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_obstacles_leave_the_box_alone(env, difficulty):
    for seed in SEEDS:
        env.reset(options={"scene": sample_scene("PushLiftBox", difficulty, seed)})
        world = env._cell.world
        for name in world.obstacles:
            near = pybullet.getClosestPoints(
                world.body("object"), world.body(name), 0.03, physicsClientId=world.client
            )
            assert not near


def test_a_scene_is_a_pure_function_of_its_seed():
    assert sample_scene("PushLiftBox", "medium", 1) == sample_scene("PushLiftBox", "medium", 1)
    assert sample_scene("PushLiftBox", "medium", 1) != sample_scene("PushLiftBox", "medium", 2)


def test_an_episode_is_the_same_bit_for_bit_whatever_was_played_before(shipped):
    def play_and_watch(made):
        """Return the bytes of all observations of a demonstration: contacts of all kinds."""
        seen = []
        step = made.step
        made.step = lambda action: seen.append(step(action)) or seen[-1]
        grasp = shipped.metadata["push_samples"][1]
        info = play(made, shipped.scenes[0], shipped.configurations[0], grasp=grasp)
        made.step = step
        assert info["is_success"]
        return b"".join(o[0][key].tobytes() for o in seen for key in sorted(o[0]))

    fresh, used = (ManipulationEnv("PushLiftBox", "easy") for _ in range(2))
    for seed in range(4):
        used.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(30):
            if used.step(rng.uniform(-1, 1, 7).astype(np.float32))[2]:
                break
    assert play_and_watch(used) == play_and_watch(fresh)
    fresh.close()
    used.close()


def test_the_registered_environment_plays_seeds():
    made = gymnasium.make(ID, difficulty="easy")
    _, info = made.reset(seed=3)
    assert made.unwrapped.scene == sample_scene("PushLiftBox", "easy", 3)
    assert info["failure"] == ""
    made.close()
