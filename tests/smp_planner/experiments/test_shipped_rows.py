"""Rows that ship: their columns, their bytes, and what is refused."""

import csv
import gzip
import json
from dataclasses import replace

import pytest
from real_rows import FIRST_SEED, real_rows, write_folder

from smp_gym.suites import Cell
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest
from smp_planner.experiments import boxes, comparison, lasa_modulation, lasa_shapes
from smp_planner.experiments.lasa_posterior import VARIANTS
from smp_planner.experiments.shipped_rows import (
    cage_rows,
    lasa_rows,
    narrow_rows,
    ship,
    suite_rows,
)
from smp_planner.experiments.tables import Column, summarise, write_tables

POSTERIOR = (
    *("setting", "free", "classes", "variation", "wasserstein_exact", "diversity", "spread"),
    *("class_1", "class_2", "class_3", "class_4"),
)
TABLES = {
    "fig1/comparison": comparison.COLUMNS,
    "fig2/modulation": lasa_modulation.COLUMNS,
    "table1/boxes": boxes.COLUMNS,
    "shapes/shapes": (Column("shape", "Shape"), *lasa_shapes.COLUMNS),
    **{f"posterior/{name}": [Column(each, each) for each in POSTERIOR] for name in VARIANTS},
}
TEXTS = ("method", "scene", "shape", "prior", "paper", "setting")


@pytest.fixture
def folder(tmp_path):
    """A folder of the tables on handwriting, of two repetitions each."""
    for path, columns in TABLES.items():
        names = [column.name for column in columns]
        rows = [
            {name: f"a {name}" if name in TEXTS else 2 / 3 for name in names} | {"seed": seed}
            for seed in range(2)
        ]
        rows[1]["free"] = None
        by = [name for name in names if name in TEXTS]
        place = tmp_path / path
        write_tables(rows, summarise(rows, by), columns, place.parent, place.name)
    return tmp_path


def test_lines_say_of_which_table_they_are_and_hold_what_is_printed(folder):
    lines = lasa_rows(folder)
    assert len(lines) == 2 * len(TABLES)
    assert len({tuple(line) for line in lines}) == 1
    names = [(line["experiment"], line["scene"], line["method"]) for line in lines[::2]]
    assert names == [
        ("compare", "Sshape", "a method"),
        ("modulate", "a scene", "a method"),
        ("boxes", "a shape", "a prior"),
        ("shapes", "a shape", "a method"),
        *(("posterior", variant, "a setting") for variant in VARIANTS),
    ]
    first, second = lines[:2]
    assert (first["free"], second["free"], second["mmd"]) == ("0.666667", "", "0.666667")
    assert (first["passed"], first["seed"], second["seed"]) == ("", "0", "1")


def test_a_table_that_is_missing_or_another_is_refused(folder):
    table = folder / "shapes" / "shapes.csv"
    table.write_text(table.read_text().replace("entropy", "enthalpy"))
    with pytest.raises(ValueError, match=r"shapes\.csv must have the columns entropy"):
        lasa_rows(folder)
    table.unlink()
    with pytest.raises(FileNotFoundError):
        lasa_rows(folder)


def test_problems_that_are_not_posed_have_a_line(tmp_path):
    solved = {"posed": True, "smp": True, "smp_seconds": 2 / 3, "promp": False, "promp_seconds": 1}
    path = tmp_path / "narrow.json"
    path.write_text(json.dumps({"results": {"ur5 cage 0": {"posed": False}, "ur5 box 3": solved}}))
    problem = {"arm": "ur5", "family": "box", "seed": "3", "posed": "1"}
    nothing = dict.fromkeys(("method", "solved", "seconds"), "")
    assert narrow_rows(path) == [
        {"arm": "ur5", "family": "cage", "seed": "0", "posed": "0", **nothing},
        {**problem, "method": "smp", "solved": "1", "seconds": "0.666667"},
        {**problem, "method": "promp", "solved": "0", "seconds": "1"},
    ]


@pytest.mark.parametrize("text", ["", "[]", '{"results": [1]}', '{"results": {"ur5 box": {}}}'])
def test_a_file_of_something_else_is_refused(tmp_path, text):
    path = tmp_path / "narrow.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"narrow\.json is not a file of narrow places"):
        narrow_rows(path)


def test_the_bytes_are_those_of_the_lines(tmp_path):
    lines = [{"method": "with, 2 σ²", "free": "42"}, {"method": "smp", "free": ""}]
    paths = [tmp_path / "a" / "one.csv.gz", tmp_path / "two.csv.gz"]
    for path in paths:
        ship(lines, path)
    first, second = (path.read_bytes() for path in paths)
    assert first == second
    with gzip.open(paths[0], "rt", encoding="utf-8") as file:
        assert list(csv.DictReader(file)) == lines


def test_episodes_are_of_cages_alone(tmp_path):
    cage, folders = Cell("Placement", "hard", "cage"), [tmp_path / "one", tmp_path / "two"]
    for folder, method in zip(folders, ("smp", "cpromp"), strict=True):
        made = make_manifest([cage], [method], FIRST_SEED, 3)
        keys = set(made.episode_keys())
        rows = [replace(row, family="cage") for row in real_rows()]
        rows = [row for row in rows if row.key in keys]
        with EpisodeStore(folder, made) as store:
            for row in reversed(rows):
                store.append(row)
    lines = cage_rows(folders)
    assert [line["method"] for line in lines] == ["smp"] * 3 + ["cpromp"] * 3
    for line, row in zip(lines[3:], rows, strict=True):
        assert (line["seed"], line["success"]) == (str(row.seed), str(int(row.success)))
        assert float(line["share_good"]) == pytest.approx(row.share_good, abs=1e-6)
    write_folder(tmp_path / "other", ["Placement"], ["smp"], 3)
    with pytest.raises(ValueError, match="other must be a run of cages of Placement alone"):
        cage_rows([*folders, tmp_path / "other"])


def test_episodes_are_of_the_frozen_lists_of_standard(tmp_path):
    cell, folders = Cell("DrawS", "hard"), [tmp_path / "one", tmp_path / "two"]
    played = {}
    for folder, methods in zip(folders, (("smp", "cpromp"), ("rrt_connect",)), strict=True):
        made = make_manifest([cell], methods, 0, 3, frozen=True)
        with EpisodeStore(folder, made) as store:
            for key in reversed(made.episode_keys()):
                row = next(
                    each
                    for each in real_rows()
                    if (each.task, each.method) == ("DrawS", key.method)
                    and each.seed == FIRST_SEED + key.seed % 3
                )
                row = replace(row, seed=key.seed, half=key.half)
                played[key.method, key.half, str(key.seed)] = row
                store.append(row)
    lines = suite_rows("standard", folders).lines
    assert list(dict.fromkeys(line["method"] for line in lines)) == [
        "smp",
        "cpromp",
        "rrt_connect",
    ]
    assert len(lines) == len(played) == 9
    for line in lines:
        row = played[line["method"], line["half"], line["seed"]]
        assert (line["success"], line["cause"]) == (str(int(row.success)), row.cause)
        assert (line["steps"], line["difficulty"]) == (str(row.steps), "hard")
        assert float(line["planning_time"]) == pytest.approx(row.planning_time, rel=1e-5)
    # A run of more episodes of one of them adds those that the first has not played.
    made = make_manifest([cell], ("cpromp",), 0, 4, frozen=True)
    with EpisodeStore(tmp_path / "more", made) as store:
        for key in made.episode_keys():
            known = played.get((key.method, key.half, str(key.seed)), row)
            store.append(replace(known, method="cpromp", seed=key.seed, half=key.half, steps=1))
    found = suite_rows("standard", [*folders, tmp_path / "more"])
    (added,) = [line for line in found.lines if line not in lines]
    assert (added["method"], added["steps"]) == ("cpromp", "1")
    assert not found.left_out
    write_folder(tmp_path / "drawn", ["DrawS"], ["smp"], 3)
    with pytest.raises(ValueError, match="drawn must be a run of the frozen lists of the suite"):
        suite_rows("standard", [tmp_path / "drawn"])


def test_what_a_method_has_played_of_a_task_is_of_one_code(tmp_path):
    cells = [Cell("DrawS", "hard"), Cell("Placement", "hard")]
    folders = {name: tmp_path / name for name in ("newer", "older")}
    for (name, folder), own in zip(folders.items(), (cells[:1], cells), strict=True):
        made = make_manifest(own, ("smp", "cpromp"), 0, 2, frozen=True)
        row = real_rows()[0]
        with EpisodeStore(folder, replace(made, code=f"{name}5678abcdef")) as store:
            for key in made.episode_keys():
                known = replace(row, method=key.method, seed=key.seed, half=key.half)
                cell = key.cell
                store.append(
                    replace(
                        known,
                        task=cell.task,
                        difficulty=cell.difficulty,
                        family=cell.family,
                        steps={"newer": 1, "older": 2}[name],
                    )
                )
    found = suite_rows("standard", list(folders.values()))
    played = [(line["method"], line["task"], line["steps"]) for line in found.lines]
    expected = [("DrawS", "1"), ("DrawS", "1"), ("Placement", "2"), ("Placement", "2")]
    assert played == [(method, *rest) for method in ("smp", "cpromp") for rest in expected]
    assert found.left_out == {folders["older"]: 4}
