"""Suites: which cells they hold, what a cell makes, and what names are refused."""

import re

import gymnasium
import pytest

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_gym.scene import FAMILIES
from smp_gym.suites import SUITES, Cell, home_suite, suite_cells
from smp_gym.tasks.registry import task_families, task_names

CELLS = [cell for cells in SUITES.values() for cell in cells]


def test_cells_are_named_apart_and_by_what_file_names_may_hold():
    assert len({cell.name for cell in CELLS}) == len(set(CELLS)) == len(CELLS)
    assert all(re.fullmatch(r"\w+", cell.name) for cell in CELLS)
    assert Cell("Placement", "hard").name == "Placement_hard"
    assert Cell("Placement", "easy", "cage").name == "Placement_cage_easy"
    noisy = Cell("DrawS", "easy", sensing="noise", noise=0.015)
    assert noisy.name == "DrawS_easy_noise15mm"


def test_suites_hold_every_family_of_every_task_at_three_difficulties():
    assert list(SUITES) == ["standard", "tight", "perception", "dynamic"]
    for task in task_names():
        drawn = [cell for cell in CELLS if cell.task == task and cell.sensing == "exact"]
        expected = {(f, d) for f in task_families(task) for d in ("easy", "medium", "hard")}
        assert {(cell.family, cell.difficulty) for cell in drawn} == expected
        sensed = [cell for cell in SUITES["perception"] if cell.task == task]
        assert [(cell.sensing, cell.noise) for cell in sensed] == [
            ("noise", 0.01),
            ("noise", 0.02),
            ("noise", 0.03),
            ("depth", 0.0),
        ]
    assert {cell.family for cell in SUITES["standard"]} == {FAMILIES[0]}


def test_what_is_sensed_otherwise_has_the_scenes_of_the_exact_cell():
    depth = Cell("Placement", "easy", sensing="depth")
    assert depth.scene(3) == Cell("Placement", "easy").scene(3)
    assert home_suite(depth) == home_suite(Cell("Placement", "easy")) == "standard"
    assert home_suite(Cell("Placement", "medium", "shelf")) == "tight"
    assert home_suite(Cell("Placement", "none")) is None


@pytest.mark.parametrize("name", SUITES)
def test_an_environment_of_a_cell_draws_the_scenes_of_the_cell(name):
    for cell in SUITES[name][:1]:
        env = gymnasium.make(environment_id(cell.task), **cell.make_arguments())
        env.reset(seed=5)
        assert env.unwrapped.scene == cell.scene(5)
        env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("Chess", "easy"), "unknown task 'Chess'; there are: Placement"),
        (("Placement", "huge"), "unknown difficulty 'huge'; there are: none, easy"),
        (("DrawS", "easy", "cage"), "unknown family 'cage' of DrawS; there are: obstacles"),
        (("Placement", "none", "cage"), "unknown difficulty 'none' of cage; there are: easy"),
        (("Placement", "easy", "obstacles", "sonar"), "unknown sensing 'sonar'; there are: exact"),
        (("Placement", "easy", "obstacles", "noise"), "positive with sensing 'noise', got 0.0"),
        (("Placement", "easy", "obstacles", "noise", -0.1), "positive .* got -0.1"),
        (("Placement", "easy", "obstacles", "depth", 0.1), "0 with sensing 'depth', got 0.1"),
        (("Placement", "easy", "obstacles", "noise", float("nan")), "positive .* got nan"),
    ],
)
def test_cells_that_cannot_be(arguments, message):
    with pytest.raises(ValueError, match=message):
        Cell(*arguments)


def test_a_suite_is_narrowed_by_task_and_name():
    assert suite_cells("standard") == SUITES["standard"]
    drawn = suite_cells("standard", tasks=["DrawS"])
    assert [cell.name for cell in drawn] == ["DrawS_easy", "DrawS_medium", "DrawS_hard"]
    assert suite_cells("standard", cells=["DrawS_hard"]) == (Cell("DrawS", "hard"),)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("loose",), "unknown suite 'loose'; there are: standard, tight, perception, dynamic"),
        (("standard", ["Chess"]), "unknown task 'Chess'"),
        (("standard", [], ["Placement_huge"]), "'Placement_huge' of suite standard; .*DrawS_hard"),
        (("standard", ["DrawS"], ["Placement_hard"]), "no cells of DrawS among Placement_hard"),
    ],
)
def test_names_that_a_suite_has_not(arguments, message):
    with pytest.raises(ValueError, match=message):
        suite_cells(*arguments)
