"""The search of settings: what is tried, how it is judged and ranked, and that it is continued."""

import csv
import json
import re
from itertools import groupby

import pytest
from rich.console import Console

from smp_gym.assets import asset_path
from smp_gym.sampling import place_without_witness
from smp_gym.scene import TASKS
from smp_planner.benchmark.manifest import code_digest
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.experiments import method_tuning
from smp_planner.experiments.kept_results import kept_results
from smp_planner.experiments.method_tuning import (
    GRIDS,
    SPACES,
    Cell,
    candidate,
    cells_of,
    ranked,
    trial,
    trials_csv,
    trials_table,
)
from smp_planner.planners import make_planner, task_settings

TERMS = {"difficulty": "easy", "seeds": [0, 3]}


@pytest.mark.parametrize("method", SPACES)
def test_every_value_is_one_that_its_method_takes(method):
    # What is drawn for any task is drawn for this one, too.
    assert candidate("DrawS", method, 0) == {}
    left = {
        (name, json.dumps(value))
        for name, values in SPACES[method].items()
        for several in values
        # A basis is several settings at once.
        for name, value in (several if isinstance(several, dict) else {name: several}).items()
    }
    for number in range(1, 200):
        settings = json.loads(json.dumps(candidate("DrawS", method, number)))
        shown = {(name, json.dumps(value)) for name, value in settings.items()}
        if shown & left:
            left -= shown
            taken = json.loads(
                json.dumps(make_planner(method, "DrawS", settings=settings).settings)
            )
            assert taken | settings == taken
    assert left == set()


def test_all_start_from_one_prior_with_as_many_tries():
    for method in SPACES:
        if method == "rrt_connect":
            continue
        assert not {"smooth_std", "retries"} & set(candidate("PushLiftBox", method, 1))
        assert task_settings(method, "PushLiftBox")["smooth_std"] == 0.6


def test_a_budget_is_the_same_for_all_and_more_keeps_the_first():
    few = cells_of(["DrawS"], list(SPACES), 3, "easy", range(2))
    more = cells_of(["DrawS"], list(SPACES), 5, "easy", range(2))
    assert len(few) == 3 * len(SPACES)
    assert set(few) < set(more)
    assert len({cell.name for cell in more}) == len(more)


@pytest.mark.parametrize("method", GRIDS)
def test_a_second_search_combines_two_settings_of_each_method(method):
    cells = cells_of(["PushLiftBox"], [method], None, "easy", range(2))
    assert len(cells) == 5
    tried = [candidate("PushLiftBox", method, cell.number, second=True) for cell in cells]
    assert tried[0] == {}
    (one, other) = GRIDS[method]
    pairs = {(settings[one], settings[other]) for settings in tried[1:]}
    assert pairs == {(a, b) for a in GRIDS[method][one] for b in GRIDS[method][other]}
    for settings in tried:
        make_planner(method, "PushLiftBox", settings=settings)


def test_every_second_scene_of_a_second_search_has_no_reference_trajectory(monkeypatch):
    placed = []

    def place(task, difficulty, seed):
        placed.append(seed)
        return place_without_witness(task, difficulty, seed)

    monkeypatch.setattr(method_tuning, "place_without_witness", place)
    cell = Cell("Placement", "promp_diff", 1, "easy", range(10, 14), second=True)
    found = trial(cell)
    assert placed == [11, 13]
    assert len(found["good"]) == 4
    assert found["settings"] == candidate("Placement", "promp_diff", 1, second=True)


def test_a_trial_counts_good_particles_by_scene():
    found = trial(Cell("Placement", "promp_diff", 1, "none", range(2)))
    assert found["settings"] == candidate("Placement", "promp_diff", 1)
    assert len(found["good"]) == len(found["free"]) == len(found["seconds"]) == 2
    assert all(0.0 < good <= free for good, free in zip(found["good"], found["free"], strict=True))
    assert min(found["seconds"]) > 0.0


def _found(good, **settings):
    return {"settings": settings, "good": good, "free": good, "seconds": [0.1] * len(good)}


def test_scenes_solved_come_before_shares():
    cells = cells_of(["Placement"], ["cpromp"], 3, "easy", range(2))
    trials = [_found([0.9, 0.0]), _found([0.1, 0.2], margin=0.02), _found([0.1, 0.1], margin=0.0)]
    (members,) = ranked(cells, trials).values()
    assert [cell.number for cell, _ in members] == [1, 2, 0]
    console = Console(width=140)
    with console.capture() as shown:
        console.print(trials_table(cells, trials, best=1))
    text = shown.get()
    assert re.search(r"1 of 3.*margin 0.02.*2 of 2.*15.0%", text)
    assert re.search(r"3 of 3.*as now.*1 of 2.*45.0%", text)
    assert "margin 0.0 " not in text


def _square(number: int) -> int:
    if number < 0:
        raise ValueError("no number below 0")
    return number**2


def _kept(path, numbers, terms=TERMS):
    items = {str(number): number for number in numbers}
    return kept_results(path, terms, _square, items, "squares", Console(quiet=True), 1)


def test_results_are_kept_as_they_come_and_continued(tmp_path):
    path = tmp_path / "new" / "squares.json"
    with pytest.raises(ValueError, match="no number below 0"):
        _kept(path, [3, 4, -1, 5])
    assert json.loads(path.read_text())["results"] == {"3": 9, "4": 16}
    # Had 4 been computed again, it would be 16.
    path.write_text(path.read_text().replace('"4": 16', '"4": 17'))
    assert _kept(path, [5, 4]) == {"5": 25, "4": 17}
    assert list(_kept(path, [4, 5])) == ["4", "5"]  # in the order asked for, none computed
    assert json.loads(path.read_text())["results"] == {"3": 9, "4": 17, "5": 25}


@pytest.mark.parametrize(
    "content", ["", "[]", '{"results": {}}', '{"terms": {}, "results": [1]}', "{" * 5000]
)
def test_damaged_files_are_refused(tmp_path, content):
    path = tmp_path / "squares.json"
    path.write_text(content)
    with pytest.raises(ResultsError, match="is not a file of kept results"):
        _kept(path, [1])
    assert path.read_text() == content


def test_results_of_other_terms_are_left_as_they_are(tmp_path):
    path = tmp_path / "squares.json"
    terms = {**TERMS, "code": code_digest()}
    path.write_text(json.dumps({"terms": terms, "results": {"1": 1}}))
    with pytest.raises(ResultsError, match=r"of other terms .*'easy'.*there.*'hard'.*now"):
        _kept(path, [1], {**TERMS, "difficulty": "hard"})
    assert _kept(path, [1]) == {"1": 1}
    path.write_text(path.read_text().replace(code_digest(), "of-before"))
    with pytest.raises(ResultsError, match=r"of-before.* there"):
        _kept(path, [1])


def logged(name):
    """Yield the rows of a search that is shipped, by task, method and number of scenes."""
    with asset_path("results", name).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for key, members in groupby(rows, lambda row: (row["task"], row["method"], row["scenes"])):
        yield key, list(members)


def _best(members):
    """Return the best row, or the first where that is better by a hundredth of the particles."""
    own = members[0]
    best = max(members, key=lambda row: (int(row["solved"]), float(row["good"])))
    margin = float(best["good"]) - float(own["good"])
    return own if best["solved"] == own["solved"] and margin < 0.01 else best


def _settings_of(method, task):
    return json.loads(json.dumps(make_planner(method, task).settings))


def test_methods_are_set_to_the_best_of_as_many_candidates_each():
    """But where that is better by a hundredth of the particles at most, which chance may be."""
    found, twice = set(), {(task, method) for (task, method, _), _ in logged("tuning_second.csv")}
    for (task, method, _), members in logged("tuning.csv"):
        found.add((task, method))
        assert [int(row["candidate"]) for row in members] == list(range(30))
        best = _best(members)
        settings = json.loads(best["settings"])
        assert settings == json.loads(json.dumps(candidate(task, method, int(best["candidate"]))))
        if (task, method) in twice:
            settings = {name: settings[name] for name in settings if name not in GRIDS[method]}
        taken = _settings_of(method, task)
        assert taken | settings == taken
    methods = set(SPACES) - {"cpromp_chance"}
    assert found == {(task, method) for task in TASKS for method in methods}


def test_margins_and_widths_of_push_lift_box_are_those_of_the_second_search():
    """Those of `smp`, of which two were alike, in the scenes of both of its searches."""
    tried = {}
    for (task, method, scenes), members in logged("tuning_second.csv"):
        assert task == "PushLiftBox"
        assert len(members) == 5
        for row in members:
            number = int(row["candidate"])
            given = json.loads(json.dumps(candidate(task, method, number, second=True)))
            assert json.loads(row["settings"]) == given
            tried.setdefault(method, {}).setdefault(int(scenes), []).append(row)
    assert set(tried) == set(GRIDS)
    for method, searches in tried.items():
        assert set(searches) == ({24, 40} if method == "smp" else {24})
        pooled = [
            {
                "settings": rows[0]["settings"],
                "solved": str(sum(int(row["solved"]) for row in rows)),
                "good": str(
                    sum(int(row["scenes"]) * float(row["good"]) for row in rows) / sum(searches)
                ),
            }
            for rows in zip(*searches.values(), strict=True)
        ]
        settings, taken = json.loads(_best(pooled)["settings"]), _settings_of(method, "PushLiftBox")
        assert taken | settings == taken


def test_a_log_holds_what_trials_came_to():
    cells = cells_of(["Placement"], ["cpromp"], 2, "easy", range(2))
    text = trials_csv(cells, [_found([0.9, 0.0]), _found([0.1, 0.2], margin=0.02)])
    rows = list(csv.DictReader(text.splitlines()))
    assert [(row["solved"], row["good"], json.loads(row["settings"])) for row in rows] == [
        ("1", "0.4500", {}),
        ("2", "0.1500", {"margin": 0.02}),
    ]
