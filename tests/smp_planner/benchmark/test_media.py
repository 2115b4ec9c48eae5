"""Pictures and videos of a page: which episodes they are of, and a real one, decoded again."""

import base64
import re
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest

from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeKey, PlayMethods
from smp_planner.benchmark.joined_results import Episode, join_results
from smp_planner.benchmark.report.findings import find
from smp_planner.benchmark.report.media import Shot, first_episodes, take, take_media
from smp_planner.benchmark.report.page import Media, Picture

# The unadapted primitive runs into an obstacle within a second here.
COLLIDES = EpisodeKey.of(Cell("Placement", "medium"), "promp", 73000)


def _content(picture: Picture, kind: str) -> bytes:
    head, _, content = picture.source.partition(",")
    assert head == f"data:{kind};base64"
    return base64.b64decode(content)


@pytest.fixture(scope="module")
def film() -> Picture:
    return take(Shot("promp@old", COLLIDES, PlayMethods(), True))


def test_a_failure_is_filmed_to_its_end_in_a_red_frame(film: Picture, tmp_path: Path) -> None:
    (tmp_path / "episode.mp4").write_bytes(_content(film, "video/mp4"))
    with imageio.get_reader(tmp_path / "episode.mp4") as reader:
        frames = [np.asarray(frame) for frame in reader]
        rate = reader.get_meta_data()["fps"]
    assert frames[0].shape == (film.height, film.width, 3)
    corners = [[int(value) for value in frame[3, 3]] for frame in (frames[0], frames[-1])]
    assert corners[1][0] > 150 > 90 > max(corners[1][1:])
    assert not corners[0][0] > 150 > 90 > max(corners[0][1:])
    (seconds,) = re.findall(r"collision, .* – .*, after ([\d.]+) s$", film.caption)
    # The first frame, one a step, and the last one for another second.
    assert len(frames) == pytest.approx(1 + rate * (float(seconds) + 1.0), abs=2)
    assert film.method == "promp@old"


def test_a_picture_says_how_many_of_its_lines_are_good() -> None:
    picture = take(Shot("promp", COLLIDES, PlayMethods(), False))
    pixels = imageio.imread(_content(picture, "image/webp"))
    assert pixels.shape == (picture.height, picture.width, 3)
    assert pixels.std() > 10.0
    assert picture.caption.startswith("0 of 42 trajectories good; collision, ")
    assert picture.caption in picture.description


def test_episodes_are_chosen_by_number_not_by_outcome() -> None:
    cells = [Cell("Placement", "easy"), Cell("DrawS", "easy")]
    episodes = [Episode(cell, "", seed) for cell in cells for seed in (4, 5, 6)]
    first = first_episodes(episodes[:-1], 4)
    assert [(e.cell.task, e.seed) for e in first] == [
        ("Placement", 4),
        ("DrawS", 4),
        ("Placement", 5),
        ("DrawS", 5),
    ]
    assert len(first_episodes(episodes[:-1], 9)) == 5
    assert first_episodes(episodes, 0) == []


def test_nothing_is_played_unless_asked_for(hard: Path) -> None:
    results = join_results([hard])
    assert take_media(find(results), results) == Media()
