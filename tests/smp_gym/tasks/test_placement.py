"""The task's rules, checked on goals and states made by hand."""

import numpy as np
import pytest

from smp_gym.robot import kinematics
from smp_gym.scene import (
    BIN_HEIGHT,
    BIN_INNER_HALF_WIDTH,
    Goal,
    ManipulatedObject,
    Obstacle,
    Scene,
)
from smp_gym.tasks import Status, make_task
from smp_gym.tasks.common import POTENTIAL_PER_METRE
from smp_gym.tasks.placement.rules import (
    BIN_LOWER,
    BIN_UPPER,
    HELD_OBJECT_POSE,
    NOMINAL_BIN,
    RELEASE_HEIGHT,
    RELEASE_TILT,
    START_CONFIGURATION,
    Placement,
)
from smp_gym.tasks.status import CALM_STEPS

TASK = Placement()
PLACE = (0.5, 0.3, 0.04)
DESIRED = np.array([*PLACE, 0.0, 1.0, 1.0, 1.0])


def goal(offset=(0.0, 0.0, 0.0), collided=0.0, released=1.0, at_rest=1.0, supported=1.0):
    return np.array([*np.add(PLACE, offset), collided, released, at_rest, supported])


@pytest.mark.parametrize(
    ("achieved", "expected"),
    [
        (goal(), True),
        (goal(offset=(0.079, -0.079, 0.02)), True),
        (goal(offset=(0.081, 0.0, 0.0)), False),
        (goal(offset=(0.0, -0.081, 0.0)), False),
        (goal(offset=(0.0, 0.0, 0.09)), False),
        (goal(collided=1.0), False),
        (goal(released=0.0), False),
        (goal(at_rest=0.0), False),
    ],
)
def test_success_needs_place_release_rest_and_no_collision(achieved, expected):
    assert bool(TASK.success(achieved, DESIRED)) is expected


def test_an_object_balanced_on_the_rim_is_not_in_the_bin():
    on_rim = PLACE[2] - 0.03 + BIN_HEIGHT + 0.025
    achieved = goal(offset=(BIN_INNER_HALF_WIDTH - 0.01, 0.0, on_rim - PLACE[2]))
    assert not TASK.success(achieved, DESIRED)


def test_flags_that_are_not_demanded_do_not_matter():
    in_hand = goal(released=0.0, at_rest=0.0, supported=0.0)
    assert TASK.success(in_hand, in_hand)
    assert not TASK.success(in_hand, DESIRED)


def test_goals_are_judged_in_any_shape_as_one_by_one():
    rng = np.random.default_rng(0)
    shape = (3, 4)
    achieved = np.concatenate(
        [
            PLACE + rng.uniform(-0.12, 0.12, (*shape, 3)),
            rng.integers(0, 2, (*shape, 4)),
        ],
        axis=-1,
    )
    desired = np.broadcast_to(DESIRED, achieved.shape)
    success, collided = TASK.success(achieved, desired), TASK.collided(achieved)
    potential = TASK.potential(achieved, desired)
    assert success.shape == collided.shape == potential.shape == shape
    for index in np.ndindex(*shape):
        assert success[index] == TASK.success(achieved[index], DESIRED)
        assert collided[index] == (achieved[index][3] == 1.0)
        distance = np.sqrt(((achieved[index][:3] - PLACE) ** 2).sum())
        assert potential[index] == pytest.approx(-POTENTIAL_PER_METRE * distance)


def status(contacts=(), held=False, calm_steps=0, collided=False):
    return Status(
        object_position=np.array(PLACE),
        object_contacts=frozenset(contacts),
        held=held,
        calm_steps=calm_steps,
        collided=collided,
    )


def test_flags_of_the_achieved_goal():
    carried = TASK.achieved_goal(status({"hand"}, held=True))
    assert (carried["released"], carried["at_rest"], carried["collided"]) == (0.0, 0.0, 0.0)
    lying = TASK.achieved_goal(status({"bin"}, calm_steps=CALM_STEPS))
    assert (lying["released"], lying["at_rest"]) == (1.0, 1.0)
    assert TASK.achieved_goal(status({"bin"}, calm_steps=CALM_STEPS - 1))["at_rest"] == 0.0
    assert TASK.achieved_goal(status(collided=True))["collided"] == 1.0


def test_only_an_object_let_go_can_be_dropped():
    assert TASK.failure(status({"table"})) == "dropped"
    # It falls onto the bin's floor so fast that the engine sees it touch what is below.
    assert TASK.failure(status({"table", "bin"})) == ""
    assert TASK.failure(status({"bin"})) == ""
    assert TASK.failure(status({"hand", "table"}, held=True)) == ""


def test_the_bin_may_be_touched_by_the_released_object_only():
    assert ("bin", "object") not in TASK.permitted_contacts(held=True)
    assert ("bin", "object") in TASK.permitted_contacts(held=False)
    for held in (True, False):
        permitted = TASK.permitted_contacts(held)
        assert all(pair == tuple(sorted(pair)) for pair in permitted)
        assert not any("arm" in pair or "obstacle" in pair for pair in permitted)


MOVING = Obstacle(
    shape="sphere", position=(0.5, 0.0, 0.5), size=(0.05,) * 3, velocity=(0.1, 0.0, 0.0)
)


def scene(**changes):
    values = {
        "task": "Placement",
        "start": START_CONFIGURATION,
        "manipulated": ManipulatedObject(),
        "goals": (Goal(position=NOMINAL_BIN),),
        **changes,
    }
    return Scene(**values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"manipulated": None}, "manipulated"),
        ({"goals": (Goal(position=NOMINAL_BIN),) * 2}, "one bin"),
        ({"obstacles": (MOVING,)}, "stand still"),
        ({"start": (0.0, 0.5, 1.0, 0.0, 2.0, 0.0)}, "start"),
        ({"start": (6.5, 3.5, 1.0, 0.0, 2.0, 0.0)}, "start"),
    ],
)
def test_unplayable_scenes_are_refused(changes, message):
    TASK.check_scene(scene())
    with pytest.raises(ValueError, match=message):
        TASK.check_scene(scene(**changes))


def test_unknown_task_lists_what_exists():
    with pytest.raises(ValueError, match=r"Placement.*'Juggling'"):
        make_task("Juggling")


def test_the_start_is_where_it_says():
    hand = kinematics.end_effector_pose(np.array(START_CONFIGURATION))
    held = hand @ HELD_OBJECT_POSE
    np.testing.assert_allclose(held[:3, 3], (0.42, -0.40, 0.26), atol=1e-3)
    assert np.degrees(-np.arcsin(hand[2, 0])) == pytest.approx(29, abs=1)


@pytest.mark.parametrize("x", [BIN_LOWER[0], NOMINAL_BIN[0], BIN_UPPER[0]])
@pytest.mark.parametrize("y", [BIN_LOWER[1], NOMINAL_BIN[1], BIN_UPPER[1]])
def test_every_bin_is_in_reach_with_margin(x, y):
    yaw = np.arctan2(y, x)
    approach = np.array(
        [
            np.cos(yaw) * np.cos(RELEASE_TILT),
            np.sin(yaw) * np.cos(RELEASE_TILT),
            -np.sin(RELEASE_TILT),
        ]
    )
    opening = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    rotation = np.column_stack([approach, opening, np.cross(approach, opening)])
    center = np.array([x, y, BIN_LOWER[2] + RELEASE_HEIGHT])
    position = center - rotation @ HELD_OBJECT_POSE[:3, 3]
    seed = np.array([-2.08, 3.75, 1.0, 0.05, 2.45, -0.02])
    solution = kinematics.inverse_kinematics(position, rotation, seed=seed)
    limited = [1, 2, 4]
    room = np.minimum(solution - kinematics.JOINT_LOWER, kinematics.JOINT_UPPER - solution)[limited]
    assert room.min() > 0.15
    # The wrist is singular where joint 5 is straight (pi), the arm where joint 3 is.
    assert abs(solution[4] - np.pi) > 0.25
    assert abs(solution[2] - np.pi) > 0.5
