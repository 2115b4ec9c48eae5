"""The order of outcomes by their returns: success, running out of time, failure."""

import gymnasium
import numpy as np
import pytest

import smp_gym
from smp_gym.env import ManipulationEnv
from smp_gym.observation import MAX_EPISODE_STEPS
from smp_gym.sampling import sample_scene
from smp_gym.scene import TASKS

DISCOUNTS = (0.95, 0.96, 0.97, 0.98, 0.99, 0.995, 1.0)
DENSE_IDS = [entry.id for entry in smp_gym.ENVIRONMENTS if entry.reward == "dense"]


def ends(task):
    """Return achieved goals (of a step before the end, success, collision) and the desired one."""
    env = ManipulationEnv(task, "none")
    observation, _ = env.reset(seed=3)
    desired = observation["desired_goal"].astype(np.float64)
    collided = observation["achieved_goal"].astype(np.float64)
    collided[env.task.goals.columns("collided")] = 1.0
    return env, observation["achieved_goal"].astype(np.float64), desired.copy(), collided, desired


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("horizon", [10, MAX_EPISODE_STEPS, 1000])
def test_returns_order_the_outcomes_for_all_lengths_and_discounts(task, horizon):
    env, going, succeeded, collided, desired = ends(task)
    if task == "DoubleSidedPlacement":  # the object is at one place: both fields tell it
        one, other = (env.task.goals.columns(f"object_position_{s}") for s in ("left", "right"))
        succeeded[other] = succeeded[one]
    step, success, failure = env.compute_reward(
        np.stack([going, succeeded, collided]), np.tile(desired, (3, 1)), [{}] * 3
    )
    env.close()
    lengths = np.arange(1, horizon + 1)
    for discount in DISCOUNTS:
        weights = discount ** (lengths - 1.0)
        before = np.concatenate([[0.0], np.cumsum(weights * step)])
        timeout = before[horizon]
        assert (before[lengths - 1] + weights * success > timeout).all()
        assert (before[lengths - 1] + weights * failure < timeout).all()


@pytest.mark.parametrize("id", DENSE_IDS)
def test_shaping_keeps_the_order_at_its_discount(id):
    """With potentials of at most 10 the forgiven rest never outweighs a failure.

    The sum of shaping is (discount^n times the last potential, 0 at an end) minus the first one.
    """
    env = gymnasium.make(id, difficulty="none")
    rules = env.unwrapped.task
    goals = []
    for seed in range(20):
        observation, _ = env.reset(seed=seed)
        goals.append((observation["achieved_goal"], observation["desired_goal"]))
        far = observation["achieved_goal"].copy()
        for field in rules.goals.layout:
            if "position" in field.name or field.name == "stroke":
                far[rules.goals.columns(field.name)] = np.resize([-0.9, 0.0, 0.9], field.size)
        goals.append((far, observation["desired_goal"]))
    env.close()
    achieved, desired = (np.array(part, np.float64) for part in zip(*goals, strict=True))
    potential = rules.potential(achieved, desired)
    assert (potential <= 0.0).all()
    assert potential.min() > -10.0


@pytest.mark.parametrize("task", ["Placement", "DoubleSidedPlacement", "PushLiftBox"])
def test_staying_at_a_subgoal_is_worth_no_more_than_success(task):
    """Hindsight keeps the ends of episodes, so at a goal that it puts in place they go on."""
    env, going, succeeded, _, desired = ends(task)
    flags = [
        env.task.goals.columns(field.name).start
        for field in env.task.goals.layout
        if field.high == 1.0
    ]
    subgoal = going.copy()
    subgoal[flags] = 0.0
    if task == "DoubleSidedPlacement":  # the object is at one place: both fields tell it
        one, other = (env.task.goals.columns(f"object_position_{s}") for s in ("left", "right"))
        succeeded[other] = succeeded[one]
    subgoal_reward, success = env.compute_reward(
        np.stack([subgoal, succeeded]), np.stack([subgoal, desired]), [{}] * 2
    )
    env.close()
    assert success == smp_gym.env.SUCCESS_REWARD
    assert 0.0 < subgoal_reward < success
    assert subgoal_reward / (1.0 - 0.98) <= success + 1e-9


def drop(env, steps):
    observations = []
    for _ in range(steps):
        observation, reward, terminated, _, info = env.step(np.array([0] * 6 + [-1], np.float32))
        observations.append(observation)
        if terminated:
            break
    assert terminated
    assert not info["is_success"]
    return observations, reward


@pytest.mark.parametrize("task", ["Placement", "DoubleSidedPlacement"])
def test_no_drop_is_a_success_for_any_goal_that_hindsight_puts_in_its_place(task):
    env = ManipulationEnv(task, "none")
    env.reset(options={"scene": sample_scene(task, "none", 1)})
    observations, last = drop(env, 80)
    assert last < 0.0
    goals = np.array([o["achieved_goal"] for o in observations], np.float64)
    released = goals[:, env.task.goals.columns("released").start] > 0.5
    assert released.any()
    assert not released.all()
    count = len(goals)
    achieved, desired = np.repeat(goals, count, axis=0), np.tile(goals, (count, 1))
    rewards = env.compute_reward(achieved, desired, [{}] * count**2).reshape(count, count)
    assert (rewards[released] <= 0.0).all()
    assert (rewards[-1] < 0.0).all()
    # While it is held, hindsight finds successes.
    held = ~released
    assert (np.diag(rewards)[held] > 0.0).all()
    env.close()


def test_a_collision_is_a_failure_for_any_goal_that_hindsight_puts_in_its_place():
    env = ManipulationEnv("DrawS", "none")
    env.reset(seed=0)
    goals = []
    terminated = False
    while not terminated and len(goals) < 400:
        observation, _, terminated, _, info = env.step(np.array([0, 1, 0, 0, 0, 0, 0], np.float32))
        goals.append(observation["achieved_goal"])
    assert info["collided"]
    desired = np.array(goals, np.float64)
    achieved = np.tile(desired[-1], (len(desired), 1))
    assert (env.compute_reward(achieved, desired, [{}] * len(desired)) < 0.0).all()
    env.close()


@pytest.mark.parametrize("limit", [10, 1000])
def test_the_limit_that_make_is_given_is_the_limit(limit):
    env = gymnasium.make("smp_gym/DrawS-v0", difficulty="none", max_episode_steps=limit)
    env.reset(seed=0)
    for step in range(1, limit + 1):
        observation, _, terminated, truncated, info = env.step(np.zeros(7, np.float32))
        assert not terminated
        assert truncated == (step == limit)
        assert info["failure"] == ("timeout" if truncated else "")
        if step in (1, 7, limit):
            decoded = smp_gym.observation.decode(observation, "DrawS")
            assert (decoded.elapsed_steps, decoded.limit) == (step, limit)
    again = gymnasium.make(env.spec)
    assert again.unwrapped.limit == limit
    again.close()
    env.close()


@pytest.mark.parametrize("limit", [0, -3, 10_001, 2.5])
def test_other_limits_are_errors(limit):
    with pytest.raises((ValueError, TypeError), match=r"positive|from 1 to 10000|integer"):
        gymnasium.make("smp_gym/Placement-v0", max_episode_steps=limit)
