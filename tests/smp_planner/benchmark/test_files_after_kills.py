"""Files of every kind are whole after a kill at any moment: the old content or the new."""

import json
import tempfile
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from killed import MID_WRITE, killed
from PIL import Image

from smp_gym.atomic_files import replacing
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.datasets.frozen import read_header, write_episodes
from smp_gym.suites import Cell
from smp_planner.benchmark.results_folder import write_json
from smp_planner.occupancy.archive import read_archive, write_archive
from smp_planner.policy.policy_file import SavedPolicy, read_policy, write_policy


@pytest.fixture(scope="module")
def demonstrations():
    return Demonstrations.load("DrawS")


def _picture(path, number):
    with replacing(path) as aside:
        Image.new("L", (64, 64), number).save(aside)


def _read_picture(path):
    with Image.open(path) as image:
        return image.convert("L").getpixel((63, 63))


KINDS = {
    "rows.json": (
        lambda path, number, _: write_json(path, {"number": number, "padding": "x" * 200}),
        lambda path: json.loads(path.read_text())["number"],
    ),
    "primitive.npz": (
        lambda path, number, _: write_archive(path, {}, {"number": np.array(number)}),
        lambda path: int(read_archive(path.read_bytes(), "", {})["number"]),
    ),
    "demonstrations.npz": (
        lambda path, number, learned: replace(learned, metadata={"number": number}).save(path),
        lambda path: Demonstrations.load(path).metadata["number"],
    ),
    "policy.zip": (
        lambda path, number, learned: write_policy(path, SavedPolicy("smp", {}, number, learned)),
        lambda path: read_policy(path).seed,
    ),
    "standard/Placement_easy.jsonl.gz": (
        lambda path, number, _: write_episodes(path, {"number": number, "x": str(KINDS)}, [], []),
        lambda path: read_header(Cell("Placement", "easy"), path.parents[1])["number"],
    ),
    "picture.png": (lambda path, number, _: _picture(path, number), _read_picture),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_kill_leaves_the_old_or_the_new(kind, tmp_path, demonstrations, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    write, read = KINDS[kind]
    path = tmp_path / kind
    write(path, 1, demonstrations)
    assert killed(lambda: write(path, 2, demonstrations), MID_WRITE)
    assert read(path) == 1
    found = []
    for moment in count(1):
        if not killed(lambda: write(path, 2, demonstrations), moment):
            break
        found.append(read(path))
    assert found == sorted(found)
    assert set(found) == {1, 2}
    assert read(path) == 2


def test_an_error_leaves_the_old_and_nothing_beside_it(tmp_path):
    path = tmp_path / "rows.json"
    path.write_text("old")
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"number": float("nan")})
    with pytest.raises(TypeError), replacing(path) as aside:
        json.dump({"half": "of it", "other": object()}, aside.open("w"))
    assert [each.name for each in tmp_path.iterdir()] == ["rows.json"]
    assert path.read_text() == "old"


def test_what_is_no_file_is_written_to(tmp_path):
    (tmp_path / "null").symlink_to("/dev/null")
    write_json(tmp_path / "null", {})
    assert (tmp_path / "null").resolve().is_char_device()
