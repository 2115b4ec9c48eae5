"""The experiments on LASA, one repetition of each, and their command line."""

import json
import re
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from smp_planner.adaptation import adaptation
from smp_planner.experiments import boxes, comparison, tuning
from smp_planner.experiments import lasa_modulation as modulation
from smp_planner.experiments.figures import draw_side_by_side
from smp_planner.experiments.lasa_scenes import (
    FIGURE_1,
    FIGURE_2A,
    FIGURE_2B,
    LASA_METHODS,
    TUNING_SCENES,
    LasaScene,
    Method,
    learn,
    settings,
)
from smp_planner.experiments.paths import clearances
from smp_planner.experiments.tables import Spread
from smp_planner.library.smp import SMP, Circle, ViaPoint

_SPEC = spec_from_file_location("script", Path(__file__).parents[3] / "scripts" / "lasa.py")
assert _SPEC is not None
assert _SPEC.loader is not None
script = module_from_spec(_SPEC)
_SPEC.loader.exec_module(script)

QUICK = Method(adaptation("smp", iterations=30), settings())


@pytest.fixture(scope="module")
def letter() -> SMP:
    return learn("Sshape")


@pytest.fixture(scope="module")
def letters() -> SMP:
    return learn("Sshape+WShape")


def test_scenes_are_no_trivial_ones(letter: SMP) -> None:
    """Few paths of the unadapted primitive are free, and the mean is not."""
    drawn = comparison.reference_of(letter)
    for scene in (FIGURE_1, *TUNING_SCENES):
        assert (clearances(drawn, scene.obstacles) > 0.0).mean() < 0.2
        assert clearances(drawn.mean(axis=0)[None], scene.obstacles)[0] < 0.0
    assert FIGURE_1 not in TUNING_SCENES
    assert not {o for s in TUNING_SCENES for o in s.obstacles} & set(FIGURE_1.obstacles)


def test_figure_1(letter: SMP) -> None:
    reference = comparison.reference_of(letter)[::10]
    rows = {"floor": comparison.noise_floor_row(letter, FIGURE_1, reference, 21, 0)}
    quicker = Method(adaptation("cpromp", iterations=100), LASA_METHODS["cpromp"].settings)
    for name, method in {**LASA_METHODS, "cpromp": quicker}.items():
        plan = comparison.adapted(letter, FIGURE_1, method, 21, 0)
        rows[name] = comparison.measure(plan.trajectories, letter, FIGURE_1, reference)
        assert rows[name]["free"] == plan.collision_free.sum()
    assert rows["smp"]["free"] == 21.0
    assert rows["smp"]["classes"] >= 2.0
    assert rows["cpromp"]["classes"] == 1.0
    assert rows["promp"]["free"] < 8.0
    assert rows["smp"]["entropy"] > rows["cpromp"]["entropy"] == 0.0
    for name in ("wasserstein", "frechet", "mmd"):
        assert rows["smp"][name] < min(rows[m][name] for m in ("promp_diff", "cpromp", "prompt_o"))
        assert rows["smp"][name] == rows["smp"][f"{name}_free"]
        assert rows["promp"][f"{name}_free"] > rows["floor"][name]


def test_nothing_is_measured_of_no_free_path(letter: SMP) -> None:
    blocked = LasaScene("Sshape", (Circle((20.0, 45.0), 12.0), Circle((20.0, 2.0), 12.0)))
    paths = letter.adapt(particles=5, method="promp").trajectories
    row = comparison.measure(paths, letter, blocked, comparison.reference_of(letter))
    assert (row["free"], row["classes"], row["entropy"], row["mmd_free"]) == (0.0, 0.0, None, None)


def test_figure_2(letters: SMP) -> None:
    for scene in (FIGURE_2A, FIGURE_2B):
        plan = comparison.adapted(letters, scene, QUICK, 20, 1)
        row = modulation.modulation_row("x", "smp", scene, plan, 1)
        # Both letters have paths, as many as are likely.
        assert np.bincount(plan.components).min() >= 5
        assert row["passed"] == row["reached"] == 20.0
        assert row["worst_end_error"] < 1e-6
        assert row["good"] == row["free"] > 15.0
    unmoved = letters.adapt(particles=20, method="promp")
    row = modulation.modulation_row("x", "promp", FIGURE_2A, unmoved, 1)
    assert row["passed"] == row["reached"] == row["good"] == 0.0


def test_via_points_are_judged_at_their_phase() -> None:
    x = np.linspace(0.0, 10.0, 21)
    paths = np.stack([np.stack([x, np.full(21, y)], axis=-1) for y in (0.0, 0.9, 1.1)])
    for phase, wanted in ((0.25, [True, True, False]), (0.75, [False, False, False])):
        scene = LasaScene("Sshape", via_points=(ViaPoint(phase, np.array([2.5, 0.0])),))
        assert modulation.passed_via_points(paths, scene).tolist() == wanted
    goal = LasaScene("Sshape", goal=(10.0, 0.0))
    assert modulation.end_errors(paths, goal) == pytest.approx([0.0, 0.9, 1.1])


def test_regions_hold_most_of_the_unadapted_primitive(letter: SMP, letters: SMP) -> None:
    """Of a Gaussian in the plane, a box of two standard deviations holds 0.954² = 0.911."""
    drawn = comparison.reference_of(letter)
    for phase, sample in ((0, 0), (1, -1)):
        (box,) = boxes.regions(letter, phase)
        at = drawn[:, sample]
        inside = ((box.lower <= at) & (at <= box.upper)).all(axis=1).mean()
        assert inside == pytest.approx(0.911, abs=0.03)
    assert len(boxes.regions(letters, 0)) == 2
    assert len(boxes.regions(letters, 1)) == 1


def test_table_1(letters: SMP) -> None:
    rows = {
        name: boxes.box_row(name, letters, FIGURE_2B, LASA_METHODS["smp"], 42, 0)
        for name in boxes.BOX_PRIORS
    }
    without, default, printed = rows.values()
    assert without["ends"] < 42.0
    assert default["ends"] == printed["ends"] == 42.0
    assert min(row["free"] for row in rows.values()) > 38.0


def test_tuning_takes_the_nearest_of_the_freest(letter: SMP) -> None:
    row = tuning.tuning_row(
        "smp",
        0,
        letter,
        TUNING_SCENES[0],
        comparison.reference_of(letter),
        10,
        tuning.FIRST_TUNING_SEED,
    )
    assert 0.0 <= row["free"] <= 10.0

    def summary(free: float, distance: float) -> dict[str, str | Spread]:
        return {"free": Spread.of([free]), "wasserstein": Spread.of([distance])}

    assert tuning.best([summary(30.0, 1.0), summary(41.8, 5.0), summary(42.0, 6.0)]) == 1
    for name, candidates in tuning.CANDIDATES.items():
        assert LASA_METHODS[name] in candidates


def test_figure_is_written(letter: SMP, tmp_path: Path) -> None:
    paths = letter.adapt(particles=3, method="promp").trajectories
    file = tmp_path / "deep" / "figure.png"
    draw_side_by_side({"a": paths, "b": paths}, letter.demonstrations, FIGURE_1, file)
    assert file.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="scenes must be 2, one for each panel, got 1"):
        draw_side_by_side({"a": paths, "b": paths}, letter.demonstrations, [FIGURE_1], file)


def _run(*arguments: str) -> str:
    result = CliRunner().invoke(script.app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def test_command_line_on_another_shape(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    quick = {"smp": QUICK, "cpromp": Method(adaptation("cpromp", iterations=5), settings())}
    monkeypatch.setattr(script, "LASA_METHODS", quick)
    _run(
        *("compare", "--shape", "GShape", "--obstacle", "-20,0,2", "--goal", "1,1"),
        *("--via", "0.5,-20,-9", "--method", "smp,cpromp", "--particles", "6"),
        *("--repetitions", "1", "--out", str(tmp_path)),
    )
    summary = json.loads((tmp_path / "comparison.json").read_text())
    assert [row["method"] for row in summary] == ["noise floor", "smp", "cpromp"]
    assert (tmp_path / "paths.png").exists()
    text = (tmp_path / "comparison.md").read_text()
    assert "(-20, 0) radius 2, via-point (-20, -9) at phase 0.5, end (1, 1)" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--shape", "Qshape"], "shape must be one of Angle"),
        (["--method", "magic"], "--method.? must be of promp, smp"),
        (["--obstacle", "1,2"], "obstacle must be 3 numbers"),
        (["--goal", "here"], "goal must be 2 numbers"),
        (["--goal", "0,1", "--obstacle", "0,0,2"], "goal .* inside or touches obstacles"),
        (["--modes", "4"], "modes must be 1 .. 3"),
    ],
)
def test_command_line_names_what_is_wrong(
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["lasa.py", "compare", *arguments])
    with pytest.raises(SystemExit) as stopped:
        script.app()
    assert stopped.value.code == 2
    assert re.search(message, re.sub(r"[\s│]+", " ", capsys.readouterr().err))
