"""Exports: rows as CSV and Parquet, and the particle sets of episodes that are played again."""

import csv
import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_episodes import fake_play, manifest
from typer.testing import CliRunner

from smp_gym.robot.kinematics import end_effector_pose
from smp_gym.scene import Scene
from smp_gym.suites import Cell
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow, PlayMethods
from smp_planner.benchmark.exports import export_episode
from smp_planner.benchmark.manifest import EpisodeStore
from smp_planner.benchmark.results_folder import ResultsError

KEY = EpisodeKey.of(Cell("Placement", "easy"), "promp", 3)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results, not finished."""
    folder = tmp_path_factory.mktemp("results")
    with EpisodeStore(folder, manifest(40)) as store:
        for key in manifest(20).episode_keys():
            store.append(fake_play(key))
    return folder


def export(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["export", *map(str, arguments)], env={"COLUMNS": "500"})
    assert result.exit_code == 0, result.output
    return result.output


def test_rows_go_to_a_csv(results: Path, tmp_path: Path) -> None:
    assert "wrote 40 episodes" in export(results)
    with (results / "episodes.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 40
    path = tmp_path / "some.csv"
    assert str(path) in export(results, "--methods", "smp", "--seeds", "3,11", "--out", path)
    with path.open() as file:
        assert [(r["method"], r["seed"]) for r in csv.DictReader(file)] == [
            ("smp", "3"),
            ("smp", "11"),
        ]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--format", "xls"], "must be of csv, parquet, npz; got 'xls'"),
        (["--methods", "promp_diff"], "must be of promp, smp; got 'promp_diff'"),
        (["--cells", "DrawS_easy"], "must be of Placement_medium; got 'DrawS_easy'"),
        (["--seeds", "3,99"], "no row has the seed '99'"),
        (["--out", "/dev/null/file.csv"], "lies under '/dev/null', which is no folder"),
    ],
)
def test_what_is_not_there_cannot_be_exported(
    results: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        app(["export", str(results), *options])
    assert ended.value.code == 2
    said = " ".join(capsys.readouterr().err.replace("\u2502", " ").split())
    assert message in said


def test_rows_go_to_parquet_with_their_types(results: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "rows.parquet"
    export(results, "--format", "parquet", "--out", path)
    read = parquet.read_table(path).to_pylist()
    rows = [EpisodeRow(**{**row, "stage_times": dict(row["stage_times"])}) for row in read]
    wanted = sorted((fake_play(key) for key in manifest(20).episode_keys()), key=lambda r: r.key)
    times = {"planning_time": 0.0}
    assert [dataclasses.replace(row, **times) for row in rows] == [
        dataclasses.replace(row, **times) for row in wanted
    ]
    assert [row.scene for row in rows] == [row.scene for row in wanted]


def test_without_pyarrow_parquet_says_what_to_install(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    arguments = ["export", str(results), "--format", "parquet"]
    ended = CliRunner().invoke(app, arguments, env={"COLUMNS": "500"})
    assert ended.exit_code == 2
    assert 'pip install "smp-gym[parquet]"' in ended.output


def test_the_particles_of_an_episode_are_those_that_were_played(tmp_path: Path) -> None:
    player = PlayMethods({"promp": "promp"})
    row = player(KEY)
    path = export_episode(player, tmp_path, row)
    assert path.name == "Placement_easy_promp_3.npz"
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    assert EpisodeKey(**{name: header[name] for name in dataclasses.asdict(KEY)}) == KEY
    assert Scene.from_json(str(arrays["scene"])) == Cell("Placement", "easy").scene(3)
    assert row.scene == str(arrays["scene"])
    particles = len(arrays["trajectories"])
    assert arrays["good"].shape == arrays["cost_prior"].shape == (particles,)
    assert row.share_good == arrays["good"].mean()
    assert arrays["clearance"][arrays["chosen"]] == row.chosen_clearance
    # The hand is where forward kinematics has it, and its path as long as the row says.
    hand = end_effector_pose(arrays["configurations"])[:, :3, 3]
    np.testing.assert_allclose(arrays["end_effector_path"], hand, atol=1e-4)
    steps = np.linalg.norm(np.diff(arrays["end_effector_path"], axis=0), axis=1)
    assert len(steps) == row.steps
    assert steps.sum() == pytest.approx(row.path_length)
    other = dataclasses.replace(row, steps=row.steps + 1)
    with pytest.raises(ResultsError, match=rf"not go as its row says.*'steps': .{other.steps}"):
        export_episode(player, tmp_path, other)
