"""Table II: what is played in which order, kept, continued, summarised and written."""

import csv
import json
import sqlite3
from contextlib import closing

import gymnasium
import numpy as np
import pytest
from PIL import Image
from scipy import stats

from smp_gym.registration import environment_id
from smp_gym.rollout import play
from smp_gym.scene import TASKS
from smp_planner.agents.posed_scenes import posed
from smp_planner.benchmark import runner
from smp_planner.benchmark.metrics import Metrics
from smp_planner.benchmark.results_folder import RESULTS, ResultsError
from smp_planner.experiments.table_two import repetitions, running
from smp_planner.experiments.table_two.figure import draw_table
from smp_planner.experiments.table_two.repetitions import (
    METHODS,
    RepetitionKey,
    RepetitionRow,
    methods_of,
    play_repetition,
)
from smp_planner.experiments.table_two.report import paper_rows, summarise, write_report
from smp_planner.experiments.table_two.scenes import load_scenes, shared_prior
from smp_planner.planning.conditioning import condition
from smp_planner.planning.settings import PlanSettings


def fake_repetition(key: RepetitionKey) -> RepetitionRow:
    """Return a row that follows from the key, without an environment."""
    rng = np.random.default_rng([key.repetition, METHODS.index(key.method)])
    similarity = Metrics(*rng.uniform(0.1, 1.0, 6).tolist())
    if key.method == "floor":
        return RepetitionRow(key.repetition, key.task, key.method, all=similarity)
    success = rng.random(42) < (0.0 if key.method == "promp" else 0.6)
    return RepetitionRow(
        key.repetition,
        key.task,
        key.method,
        success=tuple(success.tolist()),
        causes=tuple("" if done else "collision: palm – obstacle_0" for done in success),
        steps=tuple(rng.integers(100, 400, 42).tolist()),
        planned=tuple(success.tolist()),
        lengths=tuple(rng.uniform(1.0, 2.0, 42).tolist()),
        free_waypoints=float(rng.random()),
        all=similarity,
        successful=similarity if success.any() else None,
        floor=similarity if success.any() else None,
        modes=int(rng.integers(1, 5)),
        entropy=float(rng.random()),
        planning_time=0.5,
    )


@pytest.fixture
def inline(monkeypatch):
    """Play in this process: workers have tests of their own."""

    def play_all(keys, player, jobs, done, backend):
        for key in keys:
            done(player(key))

    monkeypatch.setattr(runner, "play_all", play_all)


@pytest.fixture(scope="module")
def rows():
    keys = running.keys_of(("Placement", "DrawS"), ("floor", "promp", "smp", "cpromp"), 3)
    return [fake_repetition(key) for key in keys]


@pytest.mark.parametrize("task", TASKS)
def test_in_each_scene_the_conditioned_mean_collides_in_the_physics(task):
    scene = load_scenes()[task]
    assert scene.seed < 100_000
    (problem,) = posed([scene])
    env = gymnasium.make(environment_id(task), difficulty="none")
    for component in shared_prior(task).components():
        (posterior, _), *_ = condition(component, problem.constraints, PlanSettings())
        mean = posterior.trajectory(posterior.mean, 200).numpy()
        assert play(env, scene, mean)["failure"] == "collision"
    env.close()


def test_one_gaussian_is_asked_for_where_there_are_two_modes():
    assert methods_of("DoubleSidedPlacement") == list(METHODS)
    assert not any(name.endswith("_matched") for name in methods_of("DrawS"))


def test_the_first_of_all_comes_before_the_second_of_any():
    keys = running.keys_of(TASKS, METHODS, 2)
    half = len(keys) // 2
    assert {key.repetition for key in keys[:half]} == {0}
    assert {key.repetition for key in keys[half:]} == {1}
    assert {key.task for key in keys[:half]} == set(TASKS)
    assert len(set(keys)) == len(keys)


def test_a_run_goes_on_where_it_was_cut(tmp_path, inline):
    keys = running.keys_of(("Placement",), ("floor", "smp"), 3)
    seen: list[tuple[int, int]] = []
    running.run(keys[:3], tmp_path, player=fake_repetition)
    running.run(
        keys,
        tmp_path,
        jobs=2,
        player=fake_repetition,
        on_progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(3, 6), (4, 6), (5, 6), (6, 6)]
    found = running.read(tmp_path)
    assert [row.key for row in found] == sorted(keys)
    assert found == sorted((fake_repetition(key) for key in keys), key=lambda row: row.key)


def test_a_folder_of_other_code_is_refused(tmp_path, inline):
    keys = running.keys_of(("Placement",), ("floor",), 1)
    running.run(keys, tmp_path, player=fake_repetition)
    with closing(sqlite3.connect(tmp_path / RESULTS)) as database, database:
        database.execute("UPDATE manifest SET value = '\"0\"' WHERE entry = 'code'")
    with pytest.raises(ResultsError, match="code"):
        running.run(keys, tmp_path, player=fake_repetition)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"frechet": ', '"frechet": "', "delimiter"),
        (
            '"wasserstein": ',
            '"wasserstein": 1.0, "wasserstein": ',
            "it was changed after it was written",
        ),
        ('"mmd": ', '"colour": ', "all.mmd: "),
    ],
)
def test_a_damaged_row_is_named(tmp_path, inline, old, new, message):
    keys = running.keys_of(("Placement",), ("smp",), 2)
    running.run(keys, tmp_path, player=fake_repetition)
    with closing(sqlite3.connect(tmp_path / RESULTS)) as database, database:
        changed = 'UPDATE repetitions SET "all" = replace("all", ?, ?) WHERE repetition = 1'
        database.execute(changed, (old, new))
    with pytest.raises(ResultsError, match=f"{RESULTS} is damaged: row 2.*{message}"):
        running.read(tmp_path)


def test_estimates_are_those_of_scipy(rows):
    summary = summarise(rows)["tasks"]["Placement"]["smp"]
    of_method = [row for row in rows if (row.task, row.method) == ("Placement", "smp")]
    successes = sum(sum(row.success) for row in of_method)
    interval = stats.binomtest(successes, 126).proportion_ci(method="wilson")
    assert summary["success"]["value"] == pytest.approx(successes / 126)
    assert summary["success"]["low"] == pytest.approx(interval.low)
    assert summary["success"]["high"] == pytest.approx(interval.high)
    values = [row.all.wasserstein for row in of_method]
    assert summary["all"]["wasserstein"]["value"] == pytest.approx(np.mean(values))
    assert summary["successful"]["wasserstein"]["count"] == 3


def test_what_never_succeeded_has_no_similarity_of_successful_ones(rows):
    summary = summarise(rows)["tasks"]["Placement"]["promp"]
    assert summary["success"]["value"] == 0.0
    assert summary["successful"]["mmd"] is None
    assert summary["causes"] == {"collision: palm – obstacle_0": 126}


def test_the_report_holds_a_row_of_each_trajectory_and_the_paper_s_figures(rows, tmp_path):
    summary = write_report(rows, tmp_path)
    executed = sum(len(row.success) for row in rows)
    with (tmp_path / "trajectories.csv").open(newline="") as file:
        trajectories = list(csv.DictReader(file))
    assert len(trajectories) == executed
    assert sum(row["success"] == "True" for row in trajectories) == sum(
        sum(row.success) for row in rows
    )
    with (tmp_path / "repetitions.csv").open(newline="") as file:
        kept = list(csv.DictReader(file))
    assert len(kept) == len(rows)
    text = (tmp_path / "table_two.md").read_text()
    assert "98.61% ± 0.18%" in text
    assert json.loads((tmp_path / "summary.json").read_text())["rule"] in text
    draw_table(summary, tmp_path / "table.png")
    with Image.open(tmp_path / "table.png") as image:
        assert image.width > 1000


def test_the_paper_has_four_methods_on_each_task():
    rows = paper_rows()
    assert len(rows) == 16
    for task in TASKS:
        methods = [row["method"] for row in rows if row["task"] == task]
        assert methods == ["smp", "cpromp", "prompt_o", "promp_diff"]


def test_draws_of_the_unadapted_primitive_are_at_the_floor(monkeypatch):
    """The control's particles are such draws; the physics finds them all blocked."""
    monkeypatch.setattr(repetitions, "PARTICLES", 14)
    floor = play_repetition(RepetitionKey(0, "Placement", "floor"))
    control = play_repetition(RepetitionKey(0, "Placement", "promp"))
    again = play_repetition(RepetitionKey(1, "Placement", "floor"))
    assert floor.all != again.all
    assert control.all.wasserstein == pytest.approx(floor.all.wasserstein, rel=0.3)
    assert control.all.frechet == pytest.approx(floor.all.frechet, rel=0.3)
    assert len(control.success) == 14
    assert not any(control.success)
    assert all(cause for cause in control.causes)
    assert control.successful is None
    assert control.free_waypoints < 1.0
