"""Plans on threads, the best particle before the rest, and deadlines."""

import time
from dataclasses import replace

import numpy as np
import pytest

from smp_gym.robot.kinematics import finger_spheres
from smp_gym.scene import TABLE, Obstacle
from smp_planner.planners import make_planner
from smp_planner.planning import assessment
from smp_planner.planning.assessment import assess, make_plan
from smp_planner.planning.problem import arm_problem
from smp_planner.planning.ranking import Merits, rank
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_goals import GoalRegion

SETTINGS = {"particles": 12, "iterations": 12, "samples": 60, "retries": 0}


@pytest.fixture(scope="module")
def planner():
    return make_planner("smp", "Placement", settings=SETTINGS)


@pytest.fixture(scope="module")
def problem(planner):
    """From the demonstrations' mean start to their mean end, with a ball between."""
    mean = planner.prior.single.trajectory(planner.prior.single.mean, 3).numpy()
    paths = arm_problem(
        mean[0],
        (),
        finger_spheres(np.zeros(4)),
        (GoalRegion(np.zeros(3), np.zeros(3), np.ones(3)),),
        0,
    ).body.paths(mean[None], None)[0]
    middle, end = paths[1], paths[2]
    ball = Obstacle(shape="sphere", position=tuple(middle), size=(0.05,) * 3)
    goal = GoalRegion(np.zeros(3), end - 0.02, end + 0.02)
    return arm_problem(
        mean[0], (TABLE, ball), finger_spheres(np.zeros(4)), (goal,), seed=3, movable=(ball,)
    )


def test_the_number_of_threads_changes_no_bit(planner, problem):
    alone, shared = (planner.plan([problem], threads=n)[0] for n in (1, 3))
    np.testing.assert_array_equal(alone.trajectories, shared.trajectories)
    np.testing.assert_array_equal(alone.costs["prior"], shared.costs["prior"])
    assert alone.chosen == shared.chosen


def noisy_candidates(problem, planner, seed):
    """Trajectories of which many collide, and how unlikely each is."""
    rng = np.random.default_rng(seed)
    straight = np.linspace(problem.start, problem.start + rng.normal(0.0, 0.5, 6), 40)
    bends = np.sin(np.linspace(0.0, np.pi, 40))[:, None] * rng.normal(0.0, 0.8, (20, 1, 6))
    return straight + bends, {"prior": rng.uniform(0.0, 60.0, 20)}


def drifting(problem):
    """Return a problem whose ball moves along y, at 0.1 m/s."""
    (ball,) = problem.movable
    moving = ball.model_copy(update={"velocity": (0.0, 0.1, 0.0)})
    return replace(
        problem,
        stages=tuple(
            replace(s, obstacles=tuple(moving if o == ball else o for o in s.obstacles))
            for s in problem.stages
        ),
        movable=(moving,),
    )


def test_nothing_that_moves_may_meet_the_arm_where_it_stays_at_the_end(planner, problem):
    """A ball that comes to the hand after the end counts, and only as far as one looks ahead."""
    trajectory = planner.prior.single.trajectory(planner.prior.single.mean, 60).numpy()[None]
    settings = PlanSettings(duration_limit=30.0, forecast_horizon=60.0, forecast_growth=0.0)
    arrival = float(problem.clock.times(trajectory, problem.robot.velocity)[0, -1])
    hand = problem.body.paths(trajectory, None)[0, -1]
    (ball,) = problem.movable

    def apart(late, **changed):
        """Return the clearance if the ball is in the hand so many seconds after the end."""
        speed, radius = 0.5, ball.size[0]
        start = hand + np.array([0.0, 0.0, radius + speed * (arrival + late)])
        coming = ball.model_copy(
            update={"position": tuple(start.tolist()), "velocity": (0.0, 0.0, -speed)}
        )
        stages = tuple(replace(s, obstacles=(TABLE, coming)) for s in problem.stages)
        met = replace(problem, stages=stages, movable=(coming,), **changed)
        return float(assess(met, trajectory, settings).apart[0])

    assert apart(0.3) < 0.0
    assert apart(0.9 * assessment.HOLD) < 0.0
    assert apart(0.9 * assessment.HOLD, foresight=arrival) > 0.2
    assert apart(3.0 * assessment.HOLD) > 0.2


def preferred(classes, duration):
    """Return a bonus that depends on the homotopy class and the duration."""
    return 5.0 * classes[:, -1] - duration


@pytest.mark.parametrize("bonus", [None, preferred])
@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_the_best_is_found_without_checking_the_rest(
    planner, problem, seed, moves, bonus, monkeypatch
):
    trajectories, costs = noisy_candidates(problem, planner, seed)
    problem = drifting(problem) if moves else problem
    settings = PlanSettings(duration_limit=30.0)
    checked = []
    standing = assessment._standing

    def counting(problem, trajectories, settings):
        checked.append(len(trajectories))
        return standing(problem, trajectories, settings)

    monkeypatch.setattr(assessment, "_standing", counting)
    plan = make_plan(problem, trajectories, costs, settings, bonus=bonus)
    chosen, solved, asked = plan.chosen, plan.solved, sum(checked)
    verdict = assess(problem, trajectories, settings)
    added = 0.0
    if bonus is not None:
        added = bonus(assessment.signatures(problem, trajectories), verdict.duration)
    expected = rank(
        Merits(
            verdict.free,
            verdict.passing,
            verdict.executable,
            verdict.clearance,
            verdict.missed,
            costs,
            added,
        )
    )
    assert chosen == expected.argmin()
    assert solved == verdict.good.any()
    assert solved or asked == len(trajectories)
    np.testing.assert_array_equal(plan.ranks, expected)
    np.testing.assert_array_equal(plan.collision_free, verdict.free)
    np.testing.assert_array_equal(plan.standing_free, verdict.standing_free)
    np.testing.assert_array_equal(plan.clearance, verdict.clearance)
    np.testing.assert_array_equal(plan.good, verdict.good)
    assert (plan.apart is not None) == moves
    if moves:
        np.testing.assert_array_equal(plan.apart, verdict.apart)
    assert plan.chosen == chosen


def test_a_plan_leaves_its_open_fields_alone_until_they_are_asked_for(planner, problem):
    (plan,) = planner.plan([problem])
    timed = plan.changed(timings={"all": 1.0})
    assert "unknown good" in repr(timed)
    assert "ranks" not in timed.__dict__
    assert timed.collision_free.shape == (12,)
    assert "ranks" in timed.__dict__
    assert "unknown" not in repr(timed)
    with pytest.raises(AttributeError, match="no attribute 'colour'"):
        _ = plan.colour


def test_a_deadline_is_kept(planner, problem):
    patient = make_planner(
        "smp", "Placement", settings=SETTINGS | {"iterations": 100_000, "particles": 42}
    )
    planner.plan([problem], deadline=10.0)
    begin = time.perf_counter()
    (plan,) = patient.plan([problem], deadline=2.0)
    # Without the deadline it would take minutes; a busy machine may be late, not that late.
    assert time.perf_counter() - begin < 20.0
    assert plan.trajectories.shape[0] == 42
    assert np.isfinite(plan.trajectories).all()
    assert plan.solved == bool(
        assess(problem, plan.trajectories, patient.plan_settings).good[plan.chosen]
    )


def test_a_far_deadline_changes_nothing(planner, problem):
    (free,), (hurried,) = planner.plan([problem]), planner.plan([problem], deadline=1e4)
    np.testing.assert_array_equal(free.trajectories, hurried.trajectories)


def test_a_deadline_that_is_over_at_once_still_gives_a_plan(planner, problem):
    (plan,) = planner.plan([problem], deadline=1e-6)
    assert plan.trajectories.shape == (12, 60, 6)
    if not plan.solved:
        assert "before the deadline" in plan.message
    assert plan.ranks[plan.chosen] == 0


@pytest.mark.parametrize("deadline", [0.0, -1.0, float("nan"), float("inf"), "soon", True])
def test_a_deadline_that_is_no_time_is_refused(planner, problem, deadline):
    message = f"deadline must be a positive number of seconds, got {deadline!r}"
    with pytest.raises(ValueError, match=message):
        planner.plan([problem], deadline=deadline)


def test_only_what_can_stop_early_takes_a_deadline(problem):
    baseline = make_planner("cpromp", "Placement", settings={"particles": 2})
    with pytest.raises(ValueError, match="deadline must be None for this adaptation, got 1"):
        baseline.plan([problem], deadline=1.0)


def test_threads_are_checked(planner, problem):
    with pytest.raises(ValueError, match="threads must be a positive integer, got 0"):
        planner.plan([problem], threads=0)
