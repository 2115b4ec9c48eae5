"""The scripts around the benchmark run from end to end, on the smallest input."""

import gzip
import json
import os
import re
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smp_gym.datasets.frozen import load_episodes

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


def test_a_list_made_again_begins_as_the_shipped_one(tmp_path: Path) -> None:
    """The shipped lists come from this script, and hold what is certified now, too."""
    result = _run(
        "make_benchmark.py", "--episodes", "4", "--difficulties", "hard", "--out", str(tmp_path)
    )
    assert result.returncode == 0, result.stderr
    text = gzip.decompress((tmp_path / "Placement_hard.jsonl.gz").read_bytes()).decode()
    header, *lines = map(json.loads, text.splitlines())
    assert header["episodes"] == len(lines) == 4
    shipped = load_episodes("Placement", "hard")
    for line, episode in zip(lines, shipped, strict=False):
        assert (line["half"], line["seed"]) == (episode.half, episode.seed)
        first, stored = line["scene"]["obstacles"][0], episode.scene.obstacles[0]
        assert first["position"] == pytest.approx(stored.position, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--tasks", "Chess"), "Placement"),
        (("--difficulties", "huge"), "hard"),
        (("--difficulties", "none"), "hard"),
        (("--episodes", "3"), "even"),
    ],
)
def test_lists_that_cannot_be_made(tmp_path: Path, options: tuple[str, str], message: str) -> None:
    result = _run("make_benchmark.py", *options, "--out", str(tmp_path / "lists"))
    assert result.returncode == 2
    assert message in result.stderr
    assert not (tmp_path / "lists").exists()


def test_speed_is_measured_in_several_processes() -> None:
    id = "smp_gym/Placement-v0"
    result = _run("speed_env.py", "--ids", id, "--processes", "1,2", "--seconds", "0.2")
    assert result.returncode == 0, result.stderr
    rows = [
        re.findall(r"\d+", line.split(id)[1]) for line in result.stdout.splitlines() if id in line
    ]
    assert [row[0] for row in rows] == ["1", "2"]
    assert all(int(rate) > 0 for row in rows for rate in row[1:])
    assert all(len(row) == 4 for row in rows)


def test_a_sheet_shows_its_scenes(tmp_path: Path) -> None:
    options = ("--tasks", "Placement", "--difficulties", "easy", "--scenes", "5")
    result = _run("draw_scenes.py", *options, "--out", str(tmp_path))
    assert result.returncode == 0, result.stderr
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
    result = _run("draw_scenes.py", "--seed", "99995", "--out", str(tmp_path / "sheets"))
    assert result.returncode == 2
    assert "100000" in result.stderr
    assert not (tmp_path / "sheets").exists()
