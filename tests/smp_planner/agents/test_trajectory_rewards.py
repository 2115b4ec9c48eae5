"""Rewards of trajectories: those of the physics against episodes of their own, and a training."""

import gymnasium
import numpy as np
import pytest

from smp_gym.assets import asset_path
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.registration import environment_id
from smp_gym.robot.kinematics import GRASP_CENTER, end_effector_pose
from smp_gym.rollout import rollout
from smp_gym.sampling import sample_scene
from smp_gym.scene import TASKS, Obstacle
from smp_planner.agents.bump_training import BumpSettings, BumpTraining
from smp_planner.agents.posed_scenes import environment, posed, posing_policy, primitive_of
from smp_planner.agents.shipping import ship_agent
from smp_planner.agents.trajectory_rewards import (
    CheckedRewards,
    ExecutedRewards,
    PosedScene,
    make_rewards,
)
from smp_planner.planners import make_planner
from smp_planner.planners.bump_planner import LEARNED
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.bumps import bump_phases, bumped_mean

TINY = BumpSettings(
    scenes=3, batch=2, rollouts=3, epochs=2, bumps=2, exchanged=0.5, reward="physics"
)


def posed_scene(task, difficulty, seed=3):
    scene = sample_scene(task, difficulty, seed)
    (problem,) = posed([scene])
    return PosedScene(scene, problem)


def mean_of(met):
    """Return the conditioned mean (200, 6) rad of the first component, and what bends it."""
    planner = primitive_of(met.scene.task)
    found = bumped_mean(
        planner.prior.components()[0], met.problem, planner.plan_settings, bump_phases(2)
    )
    assert found is not None
    return found


@pytest.fixture(scope="module")
def placement():
    return ExecutedRewards("Placement")


@pytest.fixture(scope="module")
def blocked(placement):
    """Return a scene with a sphere at half of the conditioned mean's way, and that mean."""
    known = posed_scene("Placement", "none")
    found = mean_of(known)
    # The object in the hand is at the sphere's centre there.
    x, y, z = (end_effector_pose(found.mean[100]) @ np.append(GRASP_CENTER, 1.0))[:3].tolist()
    sphere = Obstacle(shape="sphere", position=(x, y, z), size=(0.04, 0.04, 0.04))
    return placement.met(known, (sphere,)), found


def drawn(found, count):
    """Return numbers (count, F) of which some lead round the sphere of `blocked`."""
    return 0.4 * np.random.default_rng(0).standard_normal((count, len(found.directions)))


@pytest.mark.parametrize("task", TASKS)
def test_where_nothing_is_in_the_way_the_conditioned_mean_earns_all(task):
    met = posed_scene(task, "none")
    reward, succeeded = ExecutedRewards(task).of(met, mean_of(met).mean[None])
    assert succeeded.tolist() == [True]
    assert reward.tolist() == [2.0]


def test_what_is_driven_into_an_obstacle_earns_its_way_there(placement, blocked):
    met, found = blocked
    reward, succeeded = placement.of(met, found.mean[None])
    assert not succeeded.any()
    assert 0.2 < reward[0] < 0.5


def test_what_is_driven_into_the_table_earns_its_way_there(placement):
    met = posed_scene("Placement", "none")
    start = np.array(met.scene.start)
    lowered = start + np.linspace(0.0, 1.0, 200)[:, None] * (0.0, 1.2, 0.0, 0.0, 0.0, 0.0)
    height = (end_effector_pose(lowered) @ np.append(GRASP_CENTER, 1.0))[:, 2]
    reward, succeeded = placement.of(met, lowered[None])
    assert not succeeded.any()
    # The middle of the object in the hand is at the height of the table, or below, from here on.
    assert 0.2 < reward[0] < np.argmax(height <= 0.0) / 199


def test_an_obstacle_in_the_arm_leaves_the_scene_as_it_was_drawn(placement):
    known = posed_scene("Placement", "easy")
    hand = end_effector_pose(np.array(known.scene.start))[:3, 3]
    inside = Obstacle(shape="sphere", position=tuple(hand.tolist()), size=(0.05, 0.05, 0.05))
    assert placement.met(known, (inside,)) is known


@pytest.mark.parametrize("rewards", [CheckedRewards(15.0), ExecutedRewards("Placement")])
def test_scene_and_problem_have_the_obstacles_that_are_given(rewards):
    known = posed_scene("Placement", "easy")
    away = tuple(
        o.model_copy(update={"position": (o.position[0], o.position[1] + 0.01, o.position[2])})
        for o in known.scene.obstacles
    )
    met = rewards.met(known, away)
    assert met.scene == known.scene.model_copy(
        update={"obstacles": away, "seed": None, "difficulty": "custom"}
    )
    shown = [o.position for o in met.problem.movable]
    np.testing.assert_allclose(shown, [o.position for o in away], atol=1e-6)
    fixed = set(known.problem.stages[0].obstacles) - set(known.problem.movable)
    assert set(met.problem.stages[0].obstacles) == {*met.problem.movable, *fixed}
    # Means and bumps are those of the scene as it was drawn.
    np.testing.assert_allclose(mean_of(met).mean, mean_of(known).mean, atol=1e-6)


def test_rewards_of_the_physics_are_those_of_episodes_of_their_own(placement, blocked):
    met, found = blocked
    paths = found.trajectories(drawn(found, 10))
    reward, succeeded = placement.of(met, paths)
    assert 0 < succeeded.sum() < 10
    plan = make_plan(
        met.problem, paths, {"prior": np.zeros(10)}, primitive_of("Placement").plan_settings
    )
    own = gymnasium.make(environment_id("Placement"))
    for index in range(10):
        episode = rollout(own, posing_policy("Placement").track(plan, index), scene=met.scene)
        assert succeeded[index] == episode.success
        if episode.success:
            assert reward[index] == 2.0
        else:
            spent = episode.steps * CONTROL_PERIOD / plan.duration[index]
            assert reward[index] == pytest.approx(min(spent, 1.0))
    own.close()
    # Another order, and an episode of another scene that was left in the middle.
    env = environment("Placement")
    env.reset(options={"scene": sample_scene("Placement", "hard", 5)})
    for _ in range(9):
        env.step(np.full(7, 0.3, np.float32))
    np.testing.assert_array_equal(placement.of(met, paths[::-1])[0][::-1], reward)


def test_what_the_check_calls_a_success_is_good_by_the_whole_check(blocked):
    met, found = blocked
    settings = primitive_of("Placement").plan_settings
    rewards = make_rewards("check", "Placement")
    numbers = drawn(found, 60)
    reward, clear = rewards.of(met, found.resampled(rewards.samples).trajectories(numbers))
    plan = make_plan(met.problem, found.trajectories(numbers), {"prior": np.zeros(60)}, settings)
    assert 0 < clear.sum() < 60
    assert plan.good[clear].all()
    assert reward[clear].min() > 1.0 > 0.1 > reward[~clear].max()


def test_a_training_in_the_physics_goes_on_as_if_undisturbed(tmp_path):
    arguments = {
        "agent": "mp_rl_physics",
        "task": "Placement",
        "difficulties": ["easy"],
        "seed": 5,
        "settings": TINY,
    }
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    first = BumpTraining(whole, **arguments)
    first.run(3, every=1)
    first.close()
    begun = BumpTraining(halves, **arguments)
    begun.run(1, every=1)
    begun.close()
    env = environment("Placement")
    env.reset(options={"scene": sample_scene("Placement", "hard", 6)})
    env.step(np.ones(7, np.float32))
    second = BumpTraining(halves, **arguments)
    assert second.iteration == 1
    second.run(3, every=1)
    second.close()
    assert (whole / "agent.safetensors").read_bytes() == (halves / "agent.safetensors").read_bytes()
    assert [(p.reward, p.clear) for p in first.curve] == [(p.reward, p.clear) for p in second.curve]
    assert all(0.0 < point.reward < 2.0 for point in first.curve)
    shipped = ship_agent(halves / "agent.json", folder=tmp_path)
    assert shipped.name == "mp_rl_physics_Placement.json"
    planner = make_planner(
        "mp_rl_physics", "Placement", settings={"agent": str(shipped), "action": "mean"}
    )
    problem = posed(second.scenes)[0]
    (plan,) = planner.plan([problem])
    # In single precision before its file.
    np.testing.assert_allclose(plan.trajectories[0], second.mean_trajectory(problem), atol=2e-3)


@pytest.mark.parametrize("task", TASKS)
def test_the_agents_are_trained_by_the_rewards_of_their_names(task):
    path = asset_path("agents", "bump_settings.json")
    rewards = {name: BumpSettings.from_json(path, name, task).reward for name in LEARNED}
    assert rewards == {"mp_rl": "check", "mp_rl_physics": "physics", "detour": "check"}


def test_a_training_in_the_physics_earns_more_and_more(tmp_path):
    settings = BumpSettings(
        scenes=1,
        batch=1,
        rollouts=12,
        bumps=2,
        shift=0.0,
        exchanged=0.0,
        learning_rate=0.02,
        reward="physics",
    )
    training = BumpTraining(
        tmp_path,
        agent="detour",
        task="Placement",
        difficulties=["easy"],
        seed=0,
        settings=settings,
    )
    training.run(10, every=1)
    training.close()
    earned = [point.reward for point in training.curve]
    # The mean of 36 rewards has a standard error of 0.03.
    assert np.mean(earned[-3:]) > np.mean(earned[:3]) + 0.1
