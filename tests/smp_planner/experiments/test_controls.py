"""Controls against the exact check, the physics and closed forms."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from smp_gym.robot.kinematics import end_effector_pose
from smp_gym.sampling import sample_scene
from smp_gym.scene import Obstacle
from smp_planner.agents.posed_scenes import posed, primitive_of
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.collision.sampled_clearance import sampled_clearance
from smp_planner.collision.verification import check_collisions
from smp_planner.experiments.controls.control_table import (
    ControlCell,
    Request,
    markdown,
    measure,
    write_table,
)
from smp_planner.experiments.controls.detour import (
    SearchSettings,
    conditioned_course,
    detours_free,
    learn_detour,
)
from smp_planner.experiments.controls.measuring import (
    detour_outcomes,
    random_outcomes,
    search_iterations,
    unadapted_outcomes,
)
from smp_planner.planning.assessment import assess

QUICK = SearchSettings(generations=6, restarts=1, population=24, scenes=6, screened=48)


def _scenes(task: str, difficulty: str, count: int, first: int = 300):
    seeds = range(first, first + count)
    return [sample_scene(task, difficulty, seed) for seed in seeds]


@pytest.fixture(scope="module")
def placements(blocked):
    return posed([blocked(seed) for seed in range(300, 312)])


def test_a_detour_is_added_as_it_is_where_only_the_ends_are_held(placements) -> None:
    course = conditioned_course("Placement", placements[0])
    phase = np.linspace(0.0, 1.0, 200)
    for order in range(3):
        function = np.sin(math.pi * phase) * np.sin((order + 1) * math.pi * phase)
        function /= np.abs(function).max()
        for joint in range(6):
            expected = np.zeros((200, 6))
            expected[:, joint] = function
            np.testing.assert_allclose(
                course.directions[6 * order + joint], expected, rtol=0.0, atol=0.05
            )


def test_a_detour_keeps_the_conditions_of_the_mean() -> None:
    """Start, rests and the poses of the push stay, whatever the detour."""
    (problem,) = posed(_scenes("PushLiftBox", "none", 1))
    course = conditioned_course("PushLiftBox", problem)
    numbers = np.random.default_rng(0).normal(0.0, 0.5, (4, 18))
    trajectories = course.trajectories(numbers)
    assert np.abs(trajectories - course.mean).max() > 0.1
    np.testing.assert_allclose(trajectories[:, 0], np.tile(problem.start, (4, 1)), atol=1e-9)
    np.testing.assert_allclose(np.diff(trajectories, axis=1)[:, [0, -1]], 0.0, atol=2e-3)
    settings = primitive_of("PushLiftBox").plan_settings
    for constraint in problem.constraints:
        assert (constraint.missed(trajectories) <= constraint.slack(settings)).all()


def test_the_sampled_clearance_agrees_with_the_exact_check(placements) -> None:
    """It is that of the samples: at least the whole path's, and equal to theirs alone."""
    problem = placements[0]
    course = conditioned_course("Placement", problem)
    numbers = np.random.default_rng(1).normal(0.0, 0.4, (8, 18))
    trajectories = course.resampled(40).trajectories(numbers)
    sampled = sampled_clearance(trajectories, problem.robot, problem.obstacles, -1.0, 1.0)
    exact = check_collisions(trajectories, problem.robot, problem.obstacles)
    touching = ~exact.self_free
    assert (sampled[~touching] >= exact.clearance[~touching] - 1e-9).all()
    still = [
        min(
            check_collisions(
                np.repeat(q[None, None], 2, axis=1), problem.robot, problem.obstacles
            ).clearance[0]
            for q in trajectory
        )
        for trajectory in trajectories
    ]
    np.testing.assert_allclose(sampled[sampled > -1.0], np.array(still)[sampled > -1.0], atol=1e-9)
    floored = sampled_clearance(trajectories, problem.robot, problem.obstacles, -0.01, 0.01)
    assert floored.min() >= -0.01
    assert floored.max() <= 0.01
    np.testing.assert_array_equal(floored > 0.0, sampled > 0.0)


def test_a_learned_detour_solves_more_than_none(placements) -> None:
    """Before columns that block the mean, and the same one again with the same seed."""
    detour = learn_detour("Placement", placements, QUICK)
    again = learn_detour("Placement", placements, QUICK)
    np.testing.assert_allclose(detour.numbers, again.numbers, rtol=0.0, atol=1e-6)
    assert detour.curve.shape == (1, 6)
    courses = [conditioned_course("Placement", problem) for problem in placements]
    both = np.stack([np.zeros(18), detour.numbers])
    without, with_detour = detours_free(courses, both, "Placement").mean(axis=1)
    assert without == 0.0
    assert with_detour > 0.0
    good = assess(
        placements[0],
        courses[0].trajectories(both),
        primitive_of("Placement").plan_settings,
    ).good
    np.testing.assert_array_equal(good, detours_free(courses[:1], both, "Placement")[:, 0])
    with pytest.raises(ValueError, match="at least 2, got 1"):
        learn_detour("Placement", placements[:1], QUICK)


def test_what_the_exact_check_frees_succeeds_in_the_physics() -> None:
    scenes = _scenes("Placement", "none", 2)
    detour = learn_detour("Placement", posed(scenes), QUICK)
    for outcome in detour_outcomes(scenes, detour, physics=True):
        assert outcome.solved
        assert outcome.executed
    (unadapted,) = unadapted_outcomes(scenes[:1], physics=True)
    assert unadapted.solved
    assert unadapted.executed


def test_a_search_counts_more_iterations_where_a_wall_stands() -> None:
    scene = _scenes("Placement", "none", 1)[0]
    (empty,) = search_iterations([scene])
    assert empty.solved
    start = end_effector_pose(np.array(scene.start))[:2, 3]
    x, y = ((start + np.array(scene.goals[0].position[:2])) / 2).tolist()
    wall = Obstacle(shape="box", position=(x, y, 0.2), size=(0.03, 0.03, 0.2))
    (blocked,) = search_iterations([scene.model_copy(update={"obstacles": (wall,)})])
    assert blocked.solved
    assert blocked.iterations >= empty.iterations >= 1
    (given_up,) = search_iterations([scene], iterations=1)
    assert given_up.iterations == 1


def test_random_actions_solve_nothing() -> None:
    (outcome,) = random_outcomes(_scenes("Placement", "hard", 1))
    assert outcome.executed is False
    assert outcome.solved is None


def _request(folder: Path, **changed) -> Request:
    cell = ControlCell("Placement", "obstacles", "easy")
    quick = {"episodes": 3, "training": 6, "generations": 2, "restarts": 1, **changed}
    return Request(cell, folder, ("detour", "search"), **quick)


def test_a_cell_is_continued_and_its_table_says_what_its_file_says(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="no results"):
        markdown(tmp_path)
    path = measure(_request(tmp_path))
    before = path.read_text()
    assert measure(_request(tmp_path)).read_text() == before
    content = json.loads(before)
    assert set(content["outcomes"]) == {"detour", "search"}
    solved = sum(outcome["solved"] for outcome in content["outcomes"]["detour"])
    assert f"{solved / 3:.0%} (" in write_table(tmp_path).read_text()
    with pytest.raises(ResultsError, match="other settings"):
        measure(_request(tmp_path, episodes=4))
    search = content["outcomes"]["search"]
    for damage in (
        {"outcomes": {"search": search[1:]}},
        {"outcomes": {"search": [*search[1:], {**search[0], "iterations": 1.5}]}},
        {"outcomes": {"luck": search}},
        {"outcomes": 5},
        {"cell": "Placement"},
    ):
        path.write_text(json.dumps(content | damage))
        with pytest.raises(ResultsError, match="not a file of controls"):
            markdown(tmp_path)
    path.write_text("{}")
    with pytest.raises(ResultsError, match="not a file of controls"):
        markdown(tmp_path)
