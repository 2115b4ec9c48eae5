"""Execution with replanning, in the physics: latency, continuity, limits, determinism."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

import smp_gym  # noqa: F401
from smp_gym.observation import CONTROL_PERIOD, decode, state_field
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_gym.sampling import sample_scene
from smp_gym.scene import Obstacle
from smp_planner.planning.clock import RAMP
from smp_planner.policy.outlook import FACTORS, SAFE_DISTANCE, outlook, turns_of
from smp_planner.policy.planner_policy import PlannerPolicy

FEW = {"particles": 14}
EVERY, LATENCY = 7, 3


@pytest.fixture(scope="module")
def policy():
    return PlannerPolicy.make("smp", "Placement", settings=FEW, replan_every=EVERY, latency=LATENCY)


@pytest.fixture(scope="module")
def env():
    made = gym.make("smp_gym/Placement-v0", difficulty="easy")
    yield made
    made.close()


def play(policy, env, seed, steps=400):
    """Return observations, actions, states of the policy, and the last info."""
    observation, info = env.reset(seed=seed)
    observations, actions, states, state = [observation], [], [], None
    for _ in range(steps):
        action, state = policy.predict(observation, state, deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        states.append(state[0].pursuit)
        if terminated or truncated:
            break
    return observations, np.array(actions), states, info


@pytest.fixture(scope="module")
def played(policy, env):
    return play(policy, env, 73_001)


def test_a_static_scene_replanned_all_along_succeeds(played):
    _, _, states, info = played
    assert info["is_success"]
    assert states[-1].replans >= 5


def test_velocities_are_continuous_and_within_the_limits(played):
    observations, actions, _, _ = played
    reference = np.array([state_field(o, "reference") for o in observations])
    velocity = np.diff(reference, axis=0) / CONTROL_PERIOD / JOINT_VELOCITY
    assert np.abs(velocity).max() <= 1.0
    measured = np.array([state_field(o, "joint_velocity") for o in observations])
    assert np.abs(measured / JOINT_VELOCITY).max() <= 1.0
    # From rest to full speed takes the ramp; a jump would be as large as the velocity itself.
    assert np.abs(np.diff(velocity, axis=0)).max() < 1.5 * CONTROL_PERIOD / RAMP
    np.testing.assert_allclose(velocity, actions[:, :6], atol=1e-3)


def test_plans_take_effect_exactly_the_latency_after_they_were_asked_for(played):
    _, actions, states, _ = played
    assert np.abs(actions[:LATENCY, :6]).max() < 1e-6
    assert np.abs(actions[LATENCY, :6]).max() > 1e-4
    asked = [n for n, s in enumerate(states) if s.pending is not None and s.asked == n]
    assert asked[0] == EVERY
    assert asked[1] == asked[0] + EVERY
    for n in asked:
        pending = states[n].pending
        assert pending.due == n + LATENCY
        for k in range(n, n + LATENCY):
            assert states[k].plan is not pending.plan
        assert states[n + LATENCY].plan is pending.plan


def test_the_present_trajectory_is_followed_until_the_new_one_begins(played):
    """Both are one up to the phase at which the rest begins, which is not passed before."""
    _, _, states, _ = played
    for n, state in enumerate(states):
        if state.pending is None or state.asked != n or n + LATENCY >= len(states):
            continue
        begins = state.pending.problem.clock.phase
        assert states[n + LATENCY - 1].phase <= begins + 1e-9
        first = state.pending.problem.clock.first(len(state.trajectory))
        new = states[n + LATENCY].trajectory
        np.testing.assert_array_equal(new[: first + 1], state.trajectory[: first + 1])


def test_the_same_episode_is_played_the_same(policy, env, played):
    _, actions, _, _ = play(policy, env, 73_001, steps=40)
    np.testing.assert_array_equal(actions, played[1][:40])


def test_a_safe_trajectory_that_takes_effect_is_gone_along_at_once():
    """What was said of the trajectory of before, here that it must be left backwards, is over."""
    replanned = PlannerPolicy.make("smp", "DoubleSidedPlacement", replan_every=10)
    world = gym.make("smp_gym/DoubleSidedPlacement-v0", difficulty="medium", family="moving")
    retreats, settings = [], replanned.planner.plan_settings
    # Whether the arm retreats in a scene hangs on the draws of its plans.
    for seed in (79_705, 79_707, 79_709, 79_710):
        _, _, states, _ = play(replanned, world, seed, steps=60)
        retreats += [
            (before, now)
            for before, now in pairwise(states)
            if before.pending is not None
            and now.plan is before.pending.plan
            and now.plan.solved
            and before.factor < 0.0
            and outlook(now, now.looks.obstacles, turns_of(now.seen), settings, FACTORS[:1])[1]
            >= SAFE_DISTANCE
        ]
        if retreats:
            break
    world.close()
    assert retreats
    for _, now in retreats:
        assert now.factor > 0.0
        assert now.pending is None or not now.pending.backwards


def test_noise_asks_for_no_plan_and_plans_are_made_of_the_mean_of_all_looks():
    """Bodies stand far from the arm, and are seen 5 cm off."""
    every, steps = 15, 20
    policy = PlannerPolicy.make(
        "promp", "Placement", settings={"particles": 2, "samples": 50}, replan_every=every
    )
    far = [
        Obstacle(shape="sphere", position=(-0.6, y, 0.2), size=(0.05,) * 3)
        for y in (-0.5, -0.2, 0.2, 0.5)
    ]
    scene = sample_scene("Placement", "none", 73_001).model_copy(update={"obstacles": tuple(far)})
    env = gym.make("smp_gym/Placement-v0", difficulty="none", sensing="noise", noise=0.05)
    observation, _ = env.reset(options={"scene": scene})
    state, looks = None, []
    for step in range(steps):
        action, state = policy.predict(observation, state, deterministic=True)
        pursuit = state[0].pursuit
        seen = decode(observation, "Placement").scene.obstacles
        looks.append([obstacle.position for obstacle in seen])
        known = np.array([obstacle.position for obstacle in pursuit.looks.obstacles])
        np.testing.assert_allclose(known, np.mean(looks, axis=0), atol=1e-9)
        assert pursuit.asked == (0 if step < every else every)
        if step == every:
            assert pursuit.pending.problem.movable == pursuit.looks.obstacles
        observation, *_ = env.step(action)
    env.close()
    assert pursuit.replans == 1
    assert np.ptp(looks, axis=0).max() > 0.05


@pytest.mark.parametrize("name", ["replan_every", "latency"])
@pytest.mark.parametrize("value", [0, -3, 1.5, True, "2"])
def test_numbers_of_steps_are_positive_and_whole(name, value):
    options = {"replan_every": 5, "latency": 2, name: value}
    with pytest.raises(ValueError, match=f"{name} must be a positive whole number"):
        PlannerPolicy.make("promp", "Placement", settings=FEW, **options)


def test_a_planner_that_cannot_go_on_is_refused():
    for method in ("cpromp", "rrt_connect"):
        with pytest.raises(ValueError, match="replan_every needs a planner that can go on"):
            PlannerPolicy.make(method, "Placement", settings={"particles": 4}, replan_every=5)
