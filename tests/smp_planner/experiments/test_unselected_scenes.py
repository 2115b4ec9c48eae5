"""Rows of methods on unselected scenes: what they hold, what controls score, what is executed."""

import runpy
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from smp_planner.experiments.unselected_scenes import (
    COLUMNS,
    FLOOR,
    MEAN,
    UNADAPTED,
    SceneCell,
    cells_of,
    measure_scene,
)
from smp_planner.inference.smc import SMCSettings

SCRIPT = Path(__file__).parents[3] / "scripts" / "unselected_scenes.py"
FEW = SMCSettings(200, moves=4, last_moves=20)


@pytest.fixture(scope="module")
def rows():
    methods = ("smp", "quick SVGD", UNADAPTED, MEAN)
    cell = SceneCell("Placement", "easy", 79_004, False, methods, reference=True, executed=2)
    return {row["method"]: row for row in measure_scene(cell, FEW)}


def test_rows_hold_what_the_table_shows(rows):
    assert list(rows) == [FLOOR, "smp", "quick SVGD", UNADAPTED, MEAN]
    for row in rows.values():
        assert {column.name for column in COLUMNS} | {"seed"} == row.keys()
    assert rows["smp"]["good"] > 80.0
    assert rows["smp"]["chosen"] == 100.0
    assert rows["smp"]["success"] in (0.0, 50.0, 100.0)
    assert rows[FLOOR]["good"] == 100.0
    assert rows[FLOOR]["success"] is None


def test_no_set_covers_the_posterior_as_little_as_the_mean(rows):
    assert rows[MEAN]["coverage"] == min(row["coverage"] for row in rows.values())
    assert rows[MEAN]["wasserstein"] > rows[FLOOR]["wasserstein"]
    assert rows[MEAN]["demonstrations"] < rows[FLOOR]["demonstrations"]
    assert abs(rows[FLOOR]["energy"]) < rows["quick SVGD"]["energy"]


def test_the_first_scenes_alone_have_references():
    cells = cells_of(["DrawS", "Placement"], "medium", range(5, 9), ["smp"], references=1)
    assert [(cell.number, cell.task) for cell in cells] == [
        (number, task) for number in range(5, 9) for task in ("DrawS", "Placement")
    ]
    assert [cell.reference for cell in cells] == [True] * 2 + [False] * 6
    (row,) = measure_scene(cells_of(["DrawS"], "none", [79_005], ["smp"], references=0)[0])
    assert row["energy"] is row["coverage"] is row["success"] is None
    assert row["good"] > 90.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--frozen", "--scenes", "101"], "--scenes"),
        (["--frozen", "--first", "80", "--scenes", "21"], "21 from 80"),
        (["--first", "3"], "--frozen"),
        (["--seed", "200000"], "seed"),
        (["--methods", "smp;nonsense"], "nonsense"),
    ],
)
def test_scenes_that_there_are_not_are_refused(options, message, tmp_path):
    app = typer.Typer()
    app.command()(runpy.run_path(str(SCRIPT))["main"])
    found = CliRunner().invoke(app, [*options, "--out", str(tmp_path / "out")])
    assert found.exit_code == 2
    assert message in found.output
    assert not (tmp_path / "out").exists()
