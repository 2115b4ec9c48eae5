from itertools import pairwise

import numpy as np
import pytest
import torch
from shipped_planners import planners_of

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import UnreachableError, box_spheres, concatenate, end_effector_pose
from smp_gym.robot.kinematics import finger_spheres as fingers
from smp_gym.sampling import sample_scene
from smp_gym.scene import BIN_HEIGHT, Obstacle, fixtures
from smp_planner.inference import SETTINGS
from smp_planner.planners import make_planner
from smp_planner.planning.problem import Planner, arm_problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.target import SceneTarget
from smp_planner.planning.tool_goals import GoalRegion

HELD = np.eye(4)
HELD[0, 3] = 0.022
FINGERS = (0.9, 0.9, 0.3, 0.3)


def region(center, half=(0.02, 0.02, 0.015)):
    return GoalRegion(HELD[:3, 3], np.subtract(center, half), np.add(center, half))


def problem_of(scene, seed=0, extra=(), goals=None):
    spheres = concatenate(fingers(FINGERS), box_spheres((0.025, 0.025, 0.03), HELD))
    if goals is None:
        x, y, z = scene.goals[0].position
        goals = (region((x, y, z + BIN_HEIGHT + 0.055)),)
    obstacles = (*scene.obstacles, *extra, *fixtures(scene))
    return arm_problem(np.array(scene.start), obstacles, spheres, goals, seed)


@pytest.fixture(scope="module")
def smp():
    return make_planner("smp", "Placement")


@pytest.fixture(scope="module")
def scene():
    return sample_scene("Placement", "medium", 3)


@pytest.fixture(scope="module")
def plan(smp, scene):
    return smp.plan([problem_of(scene)])[0]


def test_every_planner_fulfils_the_protocol():
    for name in planners_of("Placement"):
        planner = make_planner(name, "Placement")
        assert isinstance(planner, Planner)


def test_shapes_are_those_that_the_plan_promises(plan):
    assert plan.weights.shape == (42, 15, 6)
    assert plan.trajectories.shape == (42, 200, 6)
    for values in (plan.collision_free, plan.clearance, plan.goal_error, plan.duration):
        assert values.shape == (42,)
    for cost in plan.costs.values():
        assert cost.shape == (42,)
        assert np.isfinite(cost).all()
    assert set(plan.timings) == {"map", "conditioning", "inference", "verification"}
    assert plan.planning_time > 0
    assert plan.message == ""


def test_trajectories_begin_at_rest_in_the_present_configuration(plan, scene):
    np.testing.assert_allclose(plan.trajectories[:, 0], np.tile(scene.start, (42, 1)), atol=1e-9)
    speed = np.abs(np.diff(plan.trajectories, axis=1))
    assert (speed[:, [0, -1]].max(axis=(1, 2)) < 0.1 * speed.max(axis=(1, 2))).all()


def test_the_chosen_particle_reaches_the_goal_and_touches_nothing(plan, scene):
    """Checked here by sampling the path finely, with nothing of the planner's own checker."""
    from smp_gym.geometry.distance import signed_distance
    from smp_gym.robot.kinematics import sphere_centers

    problem = problem_of(scene)
    path = plan.trajectories[plan.chosen]
    fine = np.concatenate([np.linspace(a, b, 5, endpoint=False) for a, b in pairwise(path)])
    spheres = problem.robot.spheres
    moving = spheres.link > 0
    centers = sphere_centers(fine, spheres)[:, moving]
    clearance = (signed_distance(centers, problem.obstacles) - spheres.radius[moving]).min()
    assert clearance > 0
    assert clearance == pytest.approx(plan.clearance[plan.chosen], abs=2e-3)
    end = (end_effector_pose(path[-1]) @ HELD)[:3, 3]
    goal = problem.goals[0]
    assert (end >= goal.lower - 5e-3).all()
    assert (end <= goal.upper + 5e-3).all()
    assert plan.executable[plan.chosen]


def test_the_same_problem_gives_the_same_plan_whatever_came_before(smp, scene, plan):
    other = problem_of(sample_scene("Placement", "hard", 5), seed=9)
    again = smp.plan([other, problem_of(scene)])[1]
    np.testing.assert_array_equal(again.trajectories, plan.trajectories)
    assert again.chosen == plan.chosen
    different = smp.plan([problem_of(scene, seed=1)])[0]
    assert not np.array_equal(different.trajectories, plan.trajectories)


def test_adaptation_is_what_frees_the_particles(smp):
    """In four unselected scenes on average; of single ones it may free few."""
    control = make_planner("promp", "Placement")
    problems = [problem_of(sample_scene("Placement", "medium", seed)) for seed in range(4)]
    adapted, drawn = smp.plan(problems), control.plan(problems)
    assert np.mean([plan.collision_free for plan in adapted]) > 0.6
    assert np.mean([plan.collision_free for plan in drawn]) < 0.02
    # Both come from the same draws of the same primitive, the control's as they were drawn.
    assert np.mean([plan.costs["obstacles"] < 1.0 for plan in adapted]) > 0.6


@pytest.mark.parametrize("inference", [name for name in SETTINGS if name != "svgd"])
def test_the_other_settings_plan_too(inference, scene):
    planner = make_planner("smp", "Placement", settings={"inference": inference})
    plan = planner.plan([problem_of(scene)])[0]
    np.testing.assert_allclose(plan.trajectories[:, 0], np.tile(scene.start, (42, 1)), atol=1e-9)
    assert plan.collision_free.any()


def test_an_inference_that_is_none_is_an_error_that_names_those_that_are():
    with pytest.raises(ValueError, match=r"one of svgd, paper, .*, cyclic; got 'fast'"):
        make_planner("smp", "Placement", settings={"inference": "fast"})


def test_the_map_trained_from_the_scene_s_points_plans_too(scene):
    settings = {"map": "points", "map_points": 30_000, "map_steps": 1000}
    planner = make_planner("smp", "Placement", settings=settings)
    plan = planner.plan([problem_of(scene)])[0]
    assert plan.collision_free[plan.chosen]
    assert plan.timings["map"] > plan.timings["conditioning"]


def test_the_gradient_is_that_of_the_costs(scene):
    settings = PlanSettings(margin=0.0, edge_width=(0.02, 0.02), sigma=0.05)
    likelihood = SceneTarget(problem_of(scene), settings)
    rng = np.random.default_rng(0)
    path = Demonstrations.load("Placement").configurations[2, ::4]
    trajectories = path + 0.1 * np.cumsum(rng.normal(size=(1, 50, 6)), axis=1) / 5
    weights = {
        "obstacles": settings.obstacle_weight,
        "self_collision": settings.self_collision_weight,
        "goal": 1.0,
        "velocity": settings.velocity_weight,
        "joint_limits": settings.limit_weight,
    }

    def total(q):
        return sum(weights[name] * value[0] for name, value in likelihood.costs(q).items())

    gradient = likelihood.gradient(trajectories, progress=1.0)
    for _ in range(10):
        direction = rng.normal(size=trajectories.shape)
        direction /= np.linalg.norm(direction)
        # Costs are summed in single precision: a shorter step shows its rounding.
        step = 1e-3
        slope = (
            total(trajectories + step * direction) - total(trajectories - step * direction)
        ) / (2 * step)
        assert (gradient * direction).sum() == pytest.approx(slope, rel=2e-2, abs=0.2)


def test_a_scene_without_a_way_is_said_to_have_none(smp, scene):
    x, y, _ = scene.goals[0].position
    lid = Obstacle(shape="box", position=(x, y, 0.2), size=(0.2, 0.2, 0.05))
    plan = smp.plan([problem_of(scene, extra=(lid,))])[0]
    assert not plan.good.any()
    assert "no particle" in plan.message
    assert plan.clearance[plan.chosen] < 0


def test_of_several_goals_one_is_reached(smp, scene):
    x, y, z = scene.goals[0].position
    far, near = region((x, y, 3.0)), region((x, y, z + BIN_HEIGHT + 0.055))
    plan = smp.plan([problem_of(scene, goals=(far, near))])[0]
    assert plan.goal_error[plan.chosen] < 5e-3
    assert plan.collision_free[plan.chosen]


def test_a_goal_out_of_reach_is_named(smp, scene):
    with pytest.raises(UnreachableError, match=r"2\.5"):
        smp.plan([problem_of(scene, goals=(region((2.5, 0.0, 0.3)),))])


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("teleport", "Placement"), "smp, promp"),
        (("smp", None), "neither"),
        (("smp", "Juggling"), "Placement"),
    ],
)
def test_what_does_not_exist_is_answered_with_what_does(arguments, named):
    with pytest.raises((ValueError, FileNotFoundError), match=named):
        make_planner(*arguments)


@pytest.mark.parametrize(
    "settings",
    [
        {"particles": 0},
        {"iterations": -3},
        {"margin": -0.1},
        {"colour": 1},
        {"map": "crystal ball"},
    ],
)
def test_settings_are_checked(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        make_planner("smp", "Placement", settings=settings)


@pytest.mark.parametrize(
    "change",
    [
        {"start": np.zeros(5)},
        {"start": np.full(6, np.nan)},
        {"goals": ()},
    ],
)
def test_a_problem_checks_what_it_is_made_of(change, scene):
    problem = problem_of(scene)
    values = {"start": problem.start, "goals": problem.goals} | change
    with pytest.raises(ValueError, match=next(iter(change))):
        arm_problem(obstacles=(), attached=fingers(FINGERS), seed=0, **values)


def test_a_goal_region_has_its_corners_in_order():
    with pytest.raises(ValueError, match="lower"):
        GoalRegion(np.zeros(3), np.ones(3), np.zeros(3))


def test_planning_leaves_the_number_of_threads_alone(smp, scene):
    torch.set_num_threads(2)
    try:
        smp.plan([problem_of(scene)])
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)


def test_a_batch_of_unequal_problems_gives_the_plans_of_each(smp, scene, plan):
    """Of two scenes and another number of goals, each as if it were planned alone."""
    x, y, z = scene.goals[0].position
    other = problem_of(sample_scene("Placement", "easy", 5), seed=9)
    goals = (region((x, y, z + BIN_HEIGHT + 0.055)), region((x, y, 3.0)))
    plans = smp.plan([problem_of(scene), other, problem_of(scene, seed=4, goals=goals)])
    np.testing.assert_array_equal(plans[0].trajectories, plan.trajectories)
    np.testing.assert_array_equal(plans[1].trajectories, smp.plan([other])[0].trajectories)
    assert plans[2].good[plans[2].chosen]


@pytest.mark.parametrize(
    "own", [{"inference": "path_kernel"}, {"inference": "svgd", "early_stop": True}]
)
def test_runs_with_a_metric_or_an_end_of_their_own_do_not_see_the_batch(own, scene):
    planner = make_planner("smp", "Placement", settings={"iterations": 30, "retries": 0, **own})
    problems = [problem_of(scene), problem_of(sample_scene("Placement", "easy", 5), seed=9)]
    together = planner.plan(problems)
    for problem, plan in zip(problems, together, strict=True):
        np.testing.assert_array_equal(planner.plan([problem])[0].trajectories, plan.trajectories)
