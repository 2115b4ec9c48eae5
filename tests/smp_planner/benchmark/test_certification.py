"""Frozen lists in the making: who certifies what, and what a list says of itself."""

import gzip
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.frozen import list_path, load_episodes, load_unknown, read_header
from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.suites import Cell
from smp_planner.benchmark import certification
from smp_planner.benchmark.certification import (
    Candidate,
    certified,
    halves_of,
    make_list,
    make_lists,
    solvers,
)
from smp_planner.planners.ompl_search import ompl_is_installed

EASY = Cell("Placement", "easy")


def test_a_reference_trajectory_certifies_its_scene():
    episode = certified(Candidate(EASY, "witness", 5, ()))
    assert (episode.solver, episode.half, episode.seed) == ("reference", "witness", 5)
    assert episode.scene == sample_scene("Placement", "easy", 5)


def test_without_a_reference_trajectory_solvers_certify():
    assert certified(Candidate(EASY, "placed", 5, ("rrt_connect",))).solver == "rrt_connect"
    episode = certified(Candidate(EASY, "placed", 5, ()))
    assert episode.solver == ""
    assert episode.scene == place_without_witness("Placement", "easy", 5)


@pytest.mark.skipif(not ompl_is_installed(), reason="OMPL is not installed")
def test_ompl_certifies():
    assert certified(Candidate(EASY, "placed", 5, ("ompl",))).solver == "ompl"


def test_solvers_that_are_not_installed_are_left_out(monkeypatch):
    assert ("ompl" in solvers()) == ompl_is_installed()
    monkeypatch.setattr(certification, "ompl_is_installed", lambda: False)
    assert solvers() == ("smp", "rrt_connect")


def test_halves_follow_what_a_task_can_place():
    assert halves_of(EASY, 10) == {"witness": 5, "placed": 5}
    assert halves_of(Cell("Placement", "easy", "shelf"), 10) == {"witness": 10}


def test_a_list_keeps_the_first_that_are_solved_and_the_others_apart(tmp_path, monkeypatch):
    """Where only reference trajectories solve, all that is placed is unknown, and that is said."""
    monkeypatch.setattr(certification, "solvers", lambda: ())
    monkeypatch.setattr(certification, "MOST_DRAWN", 2)
    path = list_path(EASY, tmp_path)
    with ThreadPoolExecutor(1) as pool:
        message = "Placement_easy, placed half: only 0 of 2 scenes were solved"
        with pytest.raises(RuntimeError, match=message):
            make_list(path, EASY, 2, pool, 1, seed=20)
        assert not path.exists()
        shelf = Cell("Placement", "easy", "shelf")
        counted: list[int] = []
        header = make_list(
            list_path(shelf, tmp_path),
            shelf,
            2,
            pool,
            1,
            seed=20,
            on_kept=lambda: counted.append(1),
        )
    assert len(counted) == 2
    kept, unknown = load_episodes(shelf, tmp_path), load_unknown(shelf, tmp_path)
    assert header["halves"]["witness"] == {
        "drawn": 2 + len(unknown),
        "kept": 2,
        "unknown": len(unknown),
    }
    drawn = sorted([*kept, *unknown], key=lambda episode: episode.seed)
    assert [episode.seed for episode in drawn] == list(range(20, 20 + len(drawn)))
    assert [episode.scene for episode in drawn] == [shelf.scene(e.seed) for e in drawn]
    assert header["solvers"] == {"reference": 2}
    assert header["left_out"] == ["smp", "rrt_connect", "ompl"]


def test_lists_that_are_there_are_left_as_they_are(tmp_path):
    cells = [EASY, Cell("Placement", "easy", sensing="depth")]
    ((cell, header, made),) = make_lists(tmp_path, cells, 2, 1, seed=30)
    assert (cell, made) == (EASY, True)
    assert [e.half for e in load_episodes(EASY, tmp_path)] == ["witness", "placed"]
    assert [e.solver for e in load_episodes(EASY, tmp_path)] == ["reference", "smp"]
    assert sum(header["solvers"].values()) == 2
    path = list_path(EASY, tmp_path)
    before = path.read_bytes()
    counted: list[int] = []
    again = list(make_lists(tmp_path, cells, 2, 1, seed=30, on_kept=counted.append))
    assert again == [(EASY, read_header(EASY, tmp_path), False)]
    assert counted == [2]
    assert path.read_bytes() == before
    with pytest.raises(ValueError, match=r"holds 2 episodes from seed 30, asked are 2 from 31"):
        next(make_lists(tmp_path, cells, 2, 1, seed=31))


def test_a_list_of_an_older_format_in_the_folder_is_an_error(tmp_path: Path):
    path = list_path(EASY, tmp_path)
    path.parent.mkdir(parents=True)
    path.write_bytes(gzip.compress(b'{"format": "smp_gym.episodes", "version": 1}'))
    with pytest.raises(ValueError, match=r"its format is smp_gym.episodes 1, allowed is"):
        next(make_lists(tmp_path, [EASY], 2, 1))


@pytest.mark.parametrize("episodes", [0, 3])
def test_lists_of_odd_length_are_refused(tmp_path, episodes):
    with pytest.raises(ValueError, match=f"even and at least 2, got {episodes}"):
        next(make_lists(tmp_path / "lists", [EASY], episodes, 1))
    assert not (tmp_path / "lists").exists()
