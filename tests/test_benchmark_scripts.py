"""The scripts around the benchmark run from end to end, on the smallest input."""

import os
import re
import runpy
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner, Result

from smp_gym.datasets.frozen import load_episodes
from smp_gym.suites import Cell

ROOT = Path(__file__).parents[1]


def _run(script: str, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ROOT / "scripts" / script), *options],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"},
        timeout=300,
    )


def _run_here(script: str, *options: str) -> Result:
    """Run a script in this process, which spares importing all anew."""
    app = typer.Typer()
    app.command()(runpy.run_path(str(ROOT / "scripts" / script))["main"])
    return CliRunner().invoke(app, options, env={"COLUMNS": "120"})


def test_a_list_is_made_and_left_as_it_is(tmp_path: Path) -> None:
    options = ("--cells", "DrawS_easy", "--episodes", "2", "--seed", "40", "--out", str(tmp_path))
    result = _run_here("make_benchmark.py", *options)
    assert result.exit_code == 0, result.output
    assert "DrawS_easy: witness: 1 drawn, 1 kept, 0 unknown; placed: " in result.stdout
    path = tmp_path / "standard" / "DrawS_easy.jsonl.gz"
    before = path.read_bytes()
    episodes = load_episodes(Cell("DrawS", "easy"), tmp_path)
    assert episodes[0].scene == Cell("DrawS", "easy").scene(40)
    again = _run("make_benchmark.py", *options)
    assert again.returncode == 0, again.stderr
    assert "DrawS_easy: is there" in again.stdout
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--tasks", "Chess"), "Placement"),
        (("--suites", "loose"), "perception"),
        (("--suites", "standard", "--cells", "Placement_huge"), "Placement_hard"),
        (("--episodes", "3"), "even"),
    ],
)
def test_lists_that_cannot_be_made(tmp_path: Path, options: tuple[str, str], message: str) -> None:
    result = _run_here("make_benchmark.py", *options, "--out", str(tmp_path / "lists"))
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "lists").exists()


def test_speed_is_measured_in_several_processes() -> None:
    id = "smp_gym/Placement-v0"
    result = _run_here("speed_env.py", "--ids", id, "--processes", "2", "--seconds", "0.2")
    assert result.exit_code == 0, result.output
    rows = [
        re.findall(r"\d+", line.split(id)[1]) for line in result.stdout.splitlines() if id in line
    ]
    assert [row[0] for row in rows] == ["2"]
    assert all(int(rate) > 0 for row in rows for rate in row[1:])
    assert all(len(row) == 4 for row in rows)


def test_a_sheet_shows_its_scenes(tmp_path: Path) -> None:
    options = ("--cells", "Placement_easy", "--scenes", "5")
    result = _run_here("draw_scenes.py", *options, "--out", str(tmp_path))
    assert result.exit_code == 0, result.output
    assert [path.name for path in tmp_path.iterdir()] == ["Placement_easy.png"]
    with Image.open(tmp_path / "Placement_easy.png") as image:
        sheet = np.asarray(image.convert("RGB"), np.float64)
    height, width, _ = sheet.shape
    shown = [
        sheet[row * height // 2 :, column * width // 4 :][: height // 2, : width // 4]
        for row, column in ((0, 0), (0, 1), (1, 0), (1, 1))
    ]
    scenes, empty = shown[:3], shown[3]
    assert empty.std() < 0.3 * min(scene.std() for scene in scenes)
    for first, second in combinations(scenes, 2):
        assert np.abs(first - second).mean() > 2.0


def test_a_sheet_of_tuning_and_evaluation_scenes_is_refused(tmp_path: Path) -> None:
    result = _run_here("draw_scenes.py", "--seed", "99995", "--out", str(tmp_path / "sheets"))
    assert result.exit_code == 2
    assert "100000" in result.stderr
    assert not (tmp_path / "sheets").exists()
