"""Planning with two-modal demonstrations: both modes are planned, the open one is taken."""

import gymnasium
import numpy as np
import pytest

from smp_gym.observation import decode
from smp_gym.scene import PAD_HALF_WIDTH, fixtures
from smp_gym.tasks.double_sided_placement.rules import SIDES
from smp_planner.planners import make_planner
from smp_planner.policy.observed_problem import problem_from
from smp_planner.policy.planner_policy import PlannerPolicy

TASK = "DoubleSidedPlacement"


@pytest.fixture(scope="module")
def smp():
    return PlannerPolicy.make("smp", TASK)


@pytest.fixture(scope="module")
def envs():
    made = {d: gymnasium.make(f"smp_gym/{TASK}-v0", difficulty=d) for d in ("none", "easy", "hard")}
    yield made
    for env in made.values():
        env.close()


def sides_reached(problem, ends):
    """Return which goal region each end configuration is in, -1 for none."""
    robot = problem.robot
    sides = np.full(len(ends), -1)
    for number, goal in enumerate(problem.goals):
        points = robot.carried_points(ends, goal.point)[0]
        inside = (points > goal.lower - 0.005) & (points < goal.upper + 0.005)
        sides[inside.all(axis=1)] = number
    return sides


@pytest.mark.parametrize("seed", [7, 12])
def test_a_particle_of_either_component_goes_to_its_own_side(smp, envs, seed):
    observation, _ = envs["easy"].reset(seed=seed)
    used = set()
    for number in range(4):
        problem = problem_from(decode(observation, TASK), seed=number)
        (plan,) = smp.planner.plan([problem])
        assert plan.trajectories.shape == (42, 200, 6)
        sides = sides_reached(problem, plan.trajectories[:, -1])
        good = plan.good & (plan.goal_error < 0.005)
        assert (sides[good] == plan.components[good]).all()
        assert good[plan.chosen]
        used |= set(plan.components[good])
    # Obstacles leave both sides open here, and both are used, though one may be rare.
    assert used == {0, 1}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_with_one_side_closed_off_the_other_is_chosen(smp, envs, seed):
    env = envs["hard"]
    observation, info = env.reset(seed=seed)
    scene = env.unwrapped.scene
    (closed,) = [
        number
        for number, pad in enumerate(scene.goals)
        for o in scene.obstacles
        if np.abs(np.subtract(o.position, pad.position)[:2]).max() < PAD_HALF_WIDTH
    ]
    state, over = None, False
    while not over:
        action, state = smp.predict(observation, state, deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    plan = state[0].plan
    assert plan.components[plan.chosen] == 1 - closed
    reached = plan.goal_error < 0.005
    assert not (plan.good & reached)[plan.components == closed].any()
    assert info["is_success"], info
    assert info["side"] == SIDES[1 - closed]


def test_the_object_is_let_go_above_the_pad_and_nowhere_else(envs):
    observation, _ = envs["none"].reset(seed=4)
    decoded = decode(observation, TASK)
    problem = problem_from(decoded, seed=0)
    half = decoded.object.size[2]
    for region, pad in zip(problem.goals, fixtures(decoded.scene)[1:], strict=True):
        np.testing.assert_allclose(region.center[:2], pad.position[:2], atol=1e-6)
        surface = pad.position[2] + pad.size[2]
        # The object is held upright to a few hundredths of a radian.
        assert surface + half + 0.01 < region.lower[2] < region.upper[2] < surface + half + 0.04


def test_plain_draws_are_shared_out_too_and_one_particle_is_enough(envs):
    observation, _ = envs["easy"].reset(seed=1)
    problem = problem_from(decode(observation, TASK), seed=0)
    (plan,) = make_planner("promp", TASK).plan([problem])
    assert [int((plan.components == c).sum()) for c in (0, 1)] == [21, 21]
    (single,) = make_planner("promp", TASK, settings={"particles": 1}).plan([problem])
    assert len(single.components) == 1


def test_one_modal_demonstrations_have_no_components():
    planner = make_planner("promp", "Placement")
    assert len(planner.prior.mixture.components) == 1
    assert planner.prior.mixture.components[0] is planner.prior.single
    env = gymnasium.make("smp_gym/Placement-v0", difficulty="none")
    observation, _ = env.reset(seed=0)
    (plan,) = planner.plan([problem_from(decode(observation, "Placement"), seed=0)])
    env.close()
    assert plan.components is None
