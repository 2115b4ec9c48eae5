"""Plans made anew: continuous where they begin, near the last ones, and refused where they must."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

import smp_gym  # noqa: F401
from smp_planner.collision.verification import check_collisions
from smp_planner.planning.clock import Clock
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.replanning import direction, resumed
from smp_planner.planning.target import SceneTarget
from smp_planner.policy.planner_policy import PlannerPolicy

PHASE = 0.37


@pytest.fixture(scope="module")
def policy():
    settings = {"particles": 14, "samples": 100, "widths": (1.0,)}
    return PlannerPolicy.make("smp", "Placement", settings=settings)


@pytest.fixture(scope="module")
def problem(policy):
    env = gym.make("smp_gym/Placement-v0", difficulty="easy")
    observation, _ = env.reset(seed=73_001)
    env.close()
    return policy.problem(observation)


@pytest.fixture(scope="module")
def plan(policy, problem):
    return policy.planner.plan([problem])[0]


@pytest.fixture(scope="module")
def rest(plan, problem):
    """What is left of the problem in mid-motion, the obstacles being where they were."""
    rate = 1.0 / float(plan.duration[plan.chosen])
    return resumed(problem, plan.best, Clock(PHASE, 0.1, rate), problem.movable)


@pytest.fixture(scope="module")
def again(policy, plan, rest):
    return policy.planner.replan(plan, rest)


def test_all_particles_begin_where_the_arm_is_in_its_direction(plan, rest, again):
    """Position and velocity are continuous, whichever particle is taken."""
    here = at_phases(plan.best[None], PHASE)[0, 0]
    count = again.trajectories.shape[1]
    first = rest.clock.first(count)
    for trajectory in again.trajectories:
        np.testing.assert_array_equal(trajectory[: first + 1], plan.best[: first + 1])
        between = at_phases(trajectory[None], PHASE)[0, 0]
        np.testing.assert_allclose(between, here, atol=1e-3)
    (part,) = again.state.parts
    weights = part.primitive.unwhiten(part.latent)
    at = torch.tensor([PHASE], dtype=torch.float64)
    exact = part.primitive.trajectory(weights, at).numpy()[:, 0]
    np.testing.assert_allclose(exact, np.tile(here, (len(exact), 1)), atol=1e-9)
    slope = part.primitive.velocity(weights, at).numpy()[:, 0]
    expected = np.tile(direction(plan.best, PHASE), (len(slope), 1))
    np.testing.assert_allclose(slope, expected, atol=1e-8)
    ahead = again.trajectories[:, first + 1]
    assert np.abs(ahead - plan.best[first + 1]).max() < 2e-3


def test_in_an_unchanged_scene_a_good_plan_stays_good_and_its_class(plan, again):
    assert again.good.sum() >= plan.good.sum() - 1
    np.testing.assert_array_equal(again.signatures[again.chosen], again.signatures[plan.chosen])
    moved = np.abs(again.trajectories[plan.chosen] - plan.best).max()
    others = np.abs(again.trajectories - plan.best).max(axis=(1, 2))
    assert moved < np.median(others)


def test_the_rest_is_checked_against_where_obstacles_are_now(policy, plan, problem):
    """A body on the rest of the trajectory counts; one on what is done does not."""
    robot = problem.robot
    clock = Clock(PHASE, 0.1, 1.0 / float(plan.duration[plan.chosen]))
    places = {}
    for name, phase in (("done", 0.1), ("ahead", 0.75)):
        tool = robot.carried_points(at_phases(plan.best[None], phase)[0], np.zeros(3))[0][0]
        places[name] = tuple(map(float, tool))
    done = [o.model_copy(update={"position": places["done"]}) for o in problem.movable]
    ahead = [o.model_copy(update={"position": places["ahead"]}) for o in problem.movable]
    found = policy.planner.replan(plan, resumed(problem, plan.best, clock, ahead))
    first = clock.first(found.trajectories.shape[1])
    check = check_collisions(found.trajectories[:, first:], robot, found_obstacles(problem, ahead))
    np.testing.assert_array_equal(found.collision_free, check.free)
    passed = policy.planner.replan(plan, resumed(problem, plan.best, clock, done))
    first = clock.first(passed.trajectories.shape[1])
    check = check_collisions(passed.trajectories[:, first:], robot, found_obstacles(problem, done))
    np.testing.assert_array_equal(passed.collision_free, check.free)


def found_obstacles(problem, movable):
    """Return all that must not be touched, with the movable obstacles where they are now."""
    standing = [o for o in problem.stages[0].obstacles if o not in problem.movable]
    return (*movable, *standing)


def test_what_comes_too_fast_leaves_the_least_bad_particle_with_the_reason(policy, plan, problem):
    robot = problem.robot
    hand = robot.carried_points(at_phases(plan.best[None], PHASE)[0], np.zeros(3))[0][0]
    coming = [
        o.model_copy(
            update={"position": tuple(map(float, hand - [0.2, 0, 0])), "velocity": (2.0, 0, 0)}
        )
        for o in problem.movable
    ]
    clock = Clock(PHASE, 0.1, 1.0 / float(plan.duration[plan.chosen]))
    found = policy.planner.replan(plan, resumed(problem, plan.best, clock, coming))
    assert not found.good.any()
    assert "no particle is good: of 14 particles 0 are collision-free" in found.message
    assert found.standing_free.any()
    assert (found.apart < 0.0).all()


def test_doubt_keeps_trajectories_farther_away(policy, plan, problem, rest, again):
    """What the costs keep away from is enlarged by it; the check of what is good is not."""
    settings = policy.planner.plan_settings
    doubtful = replace(rest, doubt=0.02)
    found = SceneTarget(doubtful, settings)
    wider = SceneTarget(rest, settings.model_copy(update={"margin": settings.margin + 0.02}))
    paths = np.ascontiguousarray(plan.trajectories[:, :: 100 // settings.planning_steps])
    for one, other in zip(found.evaluate(paths, 0.5), wider.evaluate(paths, 0.5), strict=True):
        np.testing.assert_array_equal(one, other)
    cautious = policy.planner.replan(plan, doubtful)
    ahead = slice(int(np.ceil(PHASE * 99)), None)
    robot, obstacles = problem.robot, problem.movable
    clearance = [
        np.median(check_collisions(each.trajectories[:, ahead], robot, obstacles).clearance)
        for each in (again, cautious)
    ]
    assert clearance[1] > clearance[0]
    assert cautious.solved


@pytest.mark.parametrize("doubt", [-0.01, np.nan, np.inf])
def test_doubt_that_is_no_distance_is_refused(rest, doubt):
    with pytest.raises(ValueError, match=r"Problem.doubt must be finite and not negative"):
        replace(rest, doubt=doubt)


def test_from_rest_any_direction_is_free(plan, problem):
    still = resumed(problem, plan.best, Clock(PHASE, 0.1, 0.0), problem.movable)
    moving = resumed(problem, plan.best, Clock(PHASE, 0.1, 0.2), problem.movable)
    assert len(moving.constraints) == len(still.constraints) + 1


def test_replans_go_on_with_the_optimisers_memory(policy, plan, rest, again):
    further = policy.planner.replan(again, rest)
    (part,), (later,) = again.state.parts, further.state.parts
    assert (part.iteration, later.iteration) == (12, 24)
    assert part.memory is not None


def test_the_same_replan_is_the_same(policy, plan, rest, again):
    twice = policy.planner.replan(plan, rest)
    np.testing.assert_array_equal(twice.trajectories, again.trajectories)
    np.testing.assert_array_equal(twice.ranks, again.ranks)


def test_what_cannot_be_gone_on_from_is_refused(policy, plan, problem, rest):
    planner = policy.planner
    with pytest.raises(ValueError, match="got one that cannot be gone on from"):
        planner.replan(replace(plan, state=None), rest)
    other = PlannerPolicy.make("smp", "DoubleSidedPlacement", settings={"particles": 4})
    with pytest.raises(ValueError, match="got one of another planner"):
        other.planner.replan(plan, rest)
    with pytest.raises(ValueError, match="must say what is done"):
        planner.replan(plan, problem)
    with pytest.raises(ValueError, match=r"must be the \d+ of the problem in their order"):
        resumed(problem, plan.best, Clock(PHASE), problem.movable[1:])
    variational = PlannerPolicy.make("cpromp", "Placement", settings={"particles": 4}).planner
    assert not variational.can_replan


def test_a_replan_of_another_robot_is_refused(policy, plan, rest, planar):
    from smp_planner.planning.robot_body import RobotBody

    other = replace(rest, body=RobotBody(planar))
    with pytest.raises(ValueError, match="must be of a robot with 6 joints, as the plan; got 2"):
        policy.planner.replan(plan, other)
    quicker = replace(rest.robot, velocity=2.0 * rest.robot.velocity)
    with pytest.raises(ValueError, match="must be of the robot of the plan, got another velocity"):
        policy.planner.replan(plan, replace(rest, body=replace(rest.body, model=quicker)))


def test_a_replan_of_another_task_is_refused(policy, plan, rest):
    """One with a stage more, as where an object is grasped, or without the rest at the end."""
    staged = replace(rest, stages=(*rest.stages, replace(rest.stages[0], first=0.5)))
    ends = tuple(c for c in rest.constraints if c.name != "rest at the end")
    for other in (staged, replace(rest, constraints=ends)):
        with pytest.raises(ValueError, match="must be of the task of the plan"):
            policy.planner.replan(plan, other)


def test_where_an_earlier_rest_began_binds_no_more_after_a_retreat(plan, rest):
    back = resumed(rest, plan.best, Clock(PHASE - 0.2, 0.1, -0.1), rest.movable)
    begin = [c for c in back.constraints if max(c.phases) < 1.0]
    assert {c.phases for c in begin} == {(PHASE - 0.2,)}
    again = resumed(back, plan.best, Clock(PHASE, 0.1, 0.1), rest.movable)
    assert [c.name for c in again.constraints] == [c.name for c in rest.constraints]


def test_problems_of_robots_that_were_not_demonstrated_are_refused(policy, problem, planar):
    from smp_planner.planning.robot_body import RobotBody

    other = replace(problem, body=RobotBody(planar))
    with pytest.raises(ValueError, match=r"must have the 6 .* got 2 in problems\[1\]"):
        policy.planner.plan([problem, other])
