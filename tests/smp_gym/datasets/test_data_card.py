"""The Croissant card of the data: it agrees with the files, and Croissant's own reader takes it."""

import gzip
import hashlib
import json
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from smp_gym.assets import asset_path
from smp_gym.datasets.data_card import CARD, data_card, read_data_card, write_data_card
from smp_gym.datasets.frozen import load_episodes, load_unknown
from smp_gym.suites import Cell

ROOT = asset_path()
REPOSITORY = Path(__file__).parents[3]
COMMAND = "the card is made anew by: python scripts/data_card.py"
LIST = "benchmark/standard/Placement_medium.jsonl.gz"


@pytest.fixture(scope="module")
def card() -> dict:
    return json.loads((ROOT / CARD).read_text())


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A folder with one list and one file of demonstrations."""
    for name in (LIST, "demonstrations/DrawS.npz"):
        (tmp_path / name).parent.mkdir(parents=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def _objects(card: dict) -> dict[str, dict]:
    return {
        each["contentUrl"]: each
        for each in card["distribution"]
        if each["@type"] == "cr:FileObject"
    }


def test_the_card_names_all_files_with_their_digests(card: dict) -> None:
    there = {
        path.relative_to(ROOT).as_posix(): path.read_bytes()
        for pattern in ("benchmark/*/*", "demonstrations/*")
        for path in ROOT.glob(pattern)
        if path.is_file()
    }
    objects = _objects(card)
    assert set(objects) == set(there), COMMAND
    for name, content in there.items():
        assert objects[name]["sha256"] == hashlib.sha256(content).hexdigest(), COMMAND
        assert objects[name]["contentSize"] == f"{len(content)} B", COMMAND
    given = {"url": card.get("url", ""), "published": card.get("datePublished", "")}
    assert card == data_card(**given), COMMAND


def test_the_card_counts_the_episodes_of_each_list(card: dict) -> None:
    for name, about in _objects(card).items():
        if name.endswith(".gz"):
            lines = gzip.decompress((ROOT / name).read_bytes()).decode().splitlines()[1:]
            solved = Counter(bool(json.loads(line)["solver"]) for line in lines)
            found = re.search(r": (\d+) episodes, then (\d+) that no", about["description"])
            assert found is not None
            assert (solved[True], solved[False]) == tuple(map(int, found.groups())), COMMAND


def test_the_fields_are_in_the_files(card: dict) -> None:
    sets = {
        each["name"]: {
            field["name"]: field["source"]["extract"]["column"] for field in each["field"]
        }
        for each in card["recordSet"]
    }
    for path in ROOT.glob("benchmark/*/*.gz"):
        with gzip.open(path, "rt") as file:
            next(file)
            episode = json.loads(next(file))
        for field, column in sets["episodes"].items():
            assert field in (episode if column == field else episode[column])
        assert set(episode) == set(sets["episodes"].values())
    for path in ROOT.glob("demonstrations/*.npz"):
        with np.load(path) as arrays:
            assert set(arrays) == set(sets["demonstrations"])


def test_the_card_has_what_croissant_demands(card: dict) -> None:
    """Properties that the specification requires, a publication's own ones excepted."""
    assert card["@type"] == "sc:Dataset"
    assert card["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    for name in ("name", "description", "license", "creator", "version", "citeAs"):
        assert card[name], name
    ids = [each["@id"] for each in (*card["distribution"], *card["recordSet"])]
    ids += [field["@id"] for each in card["recordSet"] for field in each["field"]]
    assert len(set(ids)) == len(ids)
    for each in card["distribution"]:
        wanted = ("contentUrl", "sha256") if each["@type"] == "cr:FileObject" else ("includes",)
        assert all(each[name] for name in ("name", "encodingFormat", *wanted))
    for each in card["recordSet"]:
        for field in each["field"]:
            assert field["dataType"].startswith("sc:")
            assert field["source"]["fileSet"]["@id"] in ids


def test_licence_version_and_citation_are_those_of_the_repository(card: dict) -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    assert f'license = "{Path(card["license"]).stem}"' in project
    assert f'version = "{card["version"]}"' in project
    citation = (REPOSITORY / "CITATION.cff").read_text()
    (title,) = re.findall(r"title = \{(.*?)\}", card["citeAs"])
    assert f'title: "{title}"' in citation


def test_croissants_own_reader_takes_the_card(small: Path) -> None:
    mlcroissant = pytest.importorskip("mlcroissant", reason="needs the extra dev")
    whole = mlcroissant.Dataset(jsonld=str(ROOT / CARD))
    assert not whole.metadata.issues.errors
    write_data_card(small, url="https://example.org/data", published="2026-01-31")
    data = mlcroissant.Dataset(jsonld=str(small / CARD))
    assert not data.metadata.issues.errors
    assert not data.metadata.issues.warnings
    header, *records = data.records("episodes")
    assert set(header.values()) == {None}
    cell = Cell("Placement", "medium")
    listed = (*load_episodes(cell), *load_unknown(cell))
    assert len(records) == len(listed)
    for record, episode in zip(records, listed, strict=True):
        texts = (episode.half, episode.solver, cell.task, cell.family, cell.difficulty)
        names = ("half", "solver", "task", "family", "difficulty")
        assert tuple(record[f"episodes/{name}"].decode() for name in names) == texts
        assert record["episodes/seed"] == episode.seed
        # Its parser of JSON rounds the last bit.
        assert record["episodes/start"] == pytest.approx(episode.scene.start, rel=1e-12)


def test_a_new_card_keeps_where_and_when_it_was_published(small: Path) -> None:
    path = write_data_card(small, url="https://example.org/data")
    assert "datePublished" not in read_data_card(path)
    write_data_card(small, published="2026-01-31")
    again = read_data_card(path)
    assert (again["url"], again["datePublished"]) == ("https://example.org/data", "2026-01-31")
    before = path.read_bytes()
    write_data_card(small)
    assert path.read_bytes() == before


def test_what_is_no_data_is_refused(small: Path, tmp_path: Path) -> None:
    (small / CARD).write_text("[1]")
    with pytest.raises(ValueError, match=r"croissant\.json must hold a JSON object, got \[1\]"):
        write_data_card(small)
    (small / CARD).unlink()
    (small / LIST).write_bytes(b"torn")
    with pytest.raises(ValueError, match="is not a list of episodes"):
        write_data_card(small)
    assert not (small / CARD).exists()
    with pytest.raises(ValueError, match="root must hold benchmark and demonstrations, got"):
        data_card(tmp_path / "nowhere")
