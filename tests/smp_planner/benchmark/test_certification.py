"""Frozen lists: which scenes are certified, and what a list's file says of itself."""

import gzip
import json

import pytest

from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.benchmark import certification
from smp_planner.benchmark.certification import certified_half, make_lists, solves


class _Pool:
    """Solves in this process what the test says is solved, by the number of the call."""

    def __init__(self, solved):
        self.solved, self.calls = solved, 0

    def map(self, function, scenes):
        assert function is solves
        for _ in scenes:
            yield self.calls in self.solved
            self.calls += 1


def test_the_first_scenes_that_are_solved_are_kept_with_their_seeds():
    episodes, placed = certified_half("Placement", "easy", 2, _Pool({1, 4, 5}), jobs=1)
    seeds = [EVALUATION_SEEDS_START + k for k in (1, 4)]
    assert [episode.seed for episode in episodes] == seeds
    assert placed == 5
    assert [e.scene for e in episodes] == [
        place_without_witness("Placement", "easy", seed) for seed in seeds
    ]
    assert {episode.half for episode in episodes} == {"certified"}


def test_too_few_solved_scenes_are_an_error():
    with pytest.raises(RuntimeError, match="Placement, easy: only 1 of 20 scenes were certified"):
        certified_half("Placement", "easy", 2, _Pool({0}), jobs=1)


def test_halves_alternate_in_a_list(tmp_path, monkeypatch):
    def certified(task, difficulty, count, pool, jobs):
        scenes = [place_without_witness(task, difficulty, 7 + k) for k in range(count)]
        return [certification.FrozenEpisode("certified", 7, scene) for scene in scenes], 9

    monkeypatch.setattr(certification, "certified_half", certified)
    ((path, half, placed),) = make_lists(tmp_path / "lists", [("DrawS", "easy")], 4, 1)
    assert (half, placed) == (2, 9)
    header, *lines = map(json.loads, gzip.decompress(path.read_bytes()).decode().splitlines())
    assert [line["half"] for line in lines] == ["witness", "certified"] * 2
    first = sample_scene("DrawS", "easy", EVALUATION_SEEDS_START)
    assert lines[0]["scene"]["obstacles"][0]["position"] == list(first.obstacles[0].position)
    assert "2 of 9" in header["made"]["certified"]


def test_lists_of_odd_length_are_refused(tmp_path):
    with pytest.raises(ValueError, match="episodes must be even, got 3"):
        next(make_lists(tmp_path / "lists", [("DrawS", "easy")], 3, 1))
    assert not (tmp_path / "lists").exists()


def test_a_scene_is_solved_once_and_not_before_the_physics_agrees(monkeypatch):
    tried = []

    def plays(env, policy, scene):
        tried.append(policy)
        return len(tried) == 2

    monkeypatch.setattr(certification, "_plays", plays)
    scene = sample_scene("Placement", "easy", 3)
    assert solves(scene)
    assert len(tried) == 2
    monkeypatch.setattr(certification, "_plays", lambda *_: False)
    assert not solves(scene)
