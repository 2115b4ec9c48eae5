"""A folder of results: its one file survives kills, full disks and damage, or says what it is."""

import dataclasses
import json
import os
import resource
import shutil
import signal
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from fake_episodes import HARD, fake_play, manifest
from killed import MID_WRITE, killed

from smp_gym.folder_lock import FolderInUseError
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, read_results
from smp_planner.benchmark.old_results import import_results
from smp_planner.benchmark.results_folder import RESULTS, ResultsError

ROOM = 100_000
"""Bytes in a file that are enough for some rows' log, and not for that of twenty."""


def append(store: EpisodeStore, rows: list[EpisodeRow]) -> None:
    for row in rows:
        store.append(row)


def rows_of(count: int) -> list[EpisodeRow]:
    return [fake_play(key) for key in manifest(count).episode_keys()]


def filled(folder: Path, rows: list[EpisodeRow], episodes: int = 4) -> Path:
    """Keep rows in a folder and return its file."""
    with EpisodeStore(folder, manifest(episodes)) as store:
        append(store, rows)
    return folder / RESULTS


@pytest.fixture(scope="module")
def two_rows(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A file of the first two rows."""
    return filled(tmp_path_factory.mktemp("two"), rows_of(1)).read_bytes()


def change(path: Path, *statements: str) -> None:
    """Change a file of results as no part of the package does."""
    with closing(sqlite3.connect(path)) as database, database:
        for statement in statements:
            database.execute(statement)


@contextmanager
def no_file_over(size: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size in bytes, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


# What is kept


def test_rows_survive_the_disk_in_one_file(tmp_path: Path) -> None:
    rows = [dataclasses.replace(row, scene="") for row in rows_of(1)] + rows_of(4)[2:]
    filled(tmp_path, rows)
    assert read_results(tmp_path) == (manifest(), rows)
    assert [path.name for path in tmp_path.iterdir()] == [RESULTS]


def test_any_program_can_ask_the_file(tmp_path: Path) -> None:
    rows = rows_of(4)
    path = filled(tmp_path, rows)
    with closing(sqlite3.connect(path)) as database:
        asked = "SELECT count(*), sum(success), min(goal_error) FROM episodes WHERE method = 'smp'"
        (answer,) = database.execute(asked).fetchall()
        (texts,) = database.execute("SELECT count(*) FROM texts").fetchone()
    of_smp = [row for row in rows if row.method == "smp"]
    errors = [row.goal_error for row in of_smp]
    assert answer == (4, sum(row.success for row in of_smp), min(errors))
    # Both methods meet the same scenes.
    assert texts == 4


def test_a_file_is_read_while_it_is_written(tmp_path: Path) -> None:
    rows = rows_of(4)
    with EpisodeStore(tmp_path, manifest()) as store:
        for number, row in enumerate(rows, start=1):
            store.append(row)
            assert read_results(tmp_path)[1] == rows[:number]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal_error": float("nan")}, "JSON compliant"),
        ({"steps": 1.5}, "steps: .*got 1.5"),
        ({"success": None}, "success: "),
        ({"seed": 99}, "does not belong"),
        ({"seed": 1}, "twice"),
    ],
)
def test_a_row_that_cannot_be_read_again_is_not_written(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    first, _, second, *_ = (fake_play(key) for key in manifest().episode_keys())
    with EpisodeStore(tmp_path, manifest()) as store:
        store.append(second)
        with pytest.raises(ResultsError, match=message):
            store.append(dataclasses.replace(first, **change))
        store.append(dataclasses.replace(first, goal_error=1))
    assert read_results(tmp_path)[1] == [second, dataclasses.replace(first, goal_error=1.0)]


# What is refused


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE episodes SET method = 'prompt' WHERE method = 'promp'", "row 2.*was changed"),
        ("UPDATE episodes SET goal_error = goal_error + 1e-15", "was changed after it was"),
        ("UPDATE episodes SET seed = 'a'", "seed: .* got 'a'"),
        ("UPDATE episodes SET success = 2", "success: .*got 2"),
        ("UPDATE episodes SET noise = 1e999", "JSON compliant"),
        ("UPDATE episodes SET noise = NULL", "noise: "),
        ("UPDATE episodes SET stage_times = '{'", "row 1 of the table 'episodes'"),
        ("UPDATE episodes SET stage_times = '{\"map\": 1}'", "was changed"),
        ("UPDATE episodes SET stage_times = '[1]'", "stage_times: "),
        ("UPDATE episodes SET scene = 'abc'", "no text has the digest 'abc'"),
        ("UPDATE texts SET content = x'00'", "is damaged"),
        ("UPDATE texts SET content = 'a'", "is damaged"),
        ("ALTER TABLE episodes ADD COLUMN colour TEXT", "not known: .'colour'."),
        ("DROP TABLE episodes", "lacks some"),
        ("DROP TABLE texts", "no such table: texts"),
        ("DROP TABLE manifest", "no such table: manifest"),
        ("UPDATE manifest SET value = '{' WHERE entry = 'seed'", "no manifest"),
        ("UPDATE manifest SET value = '[' || replace(hex(zeroblob(50000)), '00', '[')", "no man"),
        ("UPDATE manifest SET value = '\"4\"' WHERE entry = 'episodes'", "no manifest"),
        ("UPDATE manifest SET value = '5' WHERE entry = 'versions'", "no manifest"),
        ("UPDATE manifest SET value = '[]' WHERE entry = 'cells'", "no manifest"),
        ("UPDATE manifest SET value = replace(value, ': \"medium\"', ': \"hard\"')", "no manifest"),
        ("UPDATE manifest SET value = '1.5' WHERE entry = 'latency'", "no manifest"),
        ("INSERT INTO manifest VALUES ('extra', '1')", "no manifest"),
        ("DELETE FROM manifest WHERE entry = 'methods'", "no manifest"),
        ("PRAGMA user_version=1", "format must be 2, got 1"),
        ("PRAGMA application_id=0", "something else than results"),
    ],
)
def test_what_somebody_else_wrote_into_the_file_is_named(
    tmp_path: Path, two_rows: bytes, statement: str, message: str
) -> None:
    path = tmp_path / RESULTS
    path.write_bytes(two_rows)
    change(path, statement)
    before = path.read_bytes()
    for read in (lambda: read_results(tmp_path), lambda: EpisodeStore(tmp_path, manifest())):
        with pytest.raises(ResultsError, match=message) as raised:
            read()
        assert "\n" not in str(raised.value)
        assert str(path) in str(raised.value)
    assert path.stat().st_size == len(before)


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("INSERT INTO episodes SELECT * FROM episodes", "UNIQUE"),
        ("UPDATE episodes SET success = NULL", "NOT NULL"),
    ],
)
def test_the_file_itself_refuses_double_rows_and_gaps(
    tmp_path: Path, two_rows: bytes, statement: str, message: str
) -> None:
    path = tmp_path / RESULTS
    path.write_bytes(two_rows)
    with pytest.raises(sqlite3.IntegrityError, match=message):
        change(path, statement)


@pytest.mark.parametrize("damage", ["text", "cut", "zeros", "overwritten"])
def test_a_torn_file_is_named_and_left_as_it_is(tmp_path: Path, damage: str) -> None:
    path = filled(tmp_path, rows_of(20), 20)
    content = path.read_bytes()
    middle = len(content) // 2
    damaged = {
        "text": b"task,method\nPlacement,smp\n" * 100,
        "cut": content[: middle + 100],
        "zeros": bytes(len(content)),
        "overwritten": content[:5000] + os.urandom(middle) + content[5000 + middle :],
    }[damage]
    path.write_bytes(damaged)
    for read in (lambda: read_results(tmp_path), lambda: EpisodeStore(tmp_path, manifest(20))):
        with pytest.raises(ResultsError, match=RESULTS) as raised:
            read()
        assert "\n" not in str(raised.value)
    assert path.read_bytes() == damaged


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cells": (HARD,)}, "cell of Placement_hard: None there"),
        ({"suite": "standard"}, "suite: '' there, 'standard' now"),
        ({"seed": 1}, "seed: 0 there, 1 now"),
        ({"methods": ("smp",)}, "methods"),
        ({"versions": {"numpy": "3"}}, "version of numpy: 2 there, 3 now"),
        ({"code": "xyz"}, "code: 'abc' there, 'xyz' now"),
        ({"episodes": 3}, "episodes: 4 there, only 3 now"),
    ],
)
def test_other_settings_are_refused_or_start_anew(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    row = fake_play(manifest().episode_keys()[0])
    with EpisodeStore(tmp_path, manifest()) as store:
        store.append(row)
    with pytest.raises(ResultsError, match=message):
        EpisodeStore(tmp_path, manifest(**change))
    assert read_results(tmp_path) == (manifest(), [row])
    with EpisodeStore(tmp_path, manifest(**change), restart=True) as store:
        assert store.rows == []
    assert read_results(tmp_path) == (manifest(**change), [])


def test_restart_continues_where_the_settings_are_the_same(tmp_path: Path) -> None:
    row = fake_play(manifest().episode_keys()[0])
    with EpisodeStore(tmp_path, manifest()) as store:
        store.append(row)
    with EpisodeStore(tmp_path, manifest(), restart=True) as store:
        assert store.rows == [row]


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    with (
        EpisodeStore(tmp_path, manifest()),
        pytest.raises(FolderInUseError, match="another process is writing"),
    ):
        EpisodeStore(tmp_path, manifest())
    EpisodeStore(tmp_path, manifest()).close()


def test_no_results_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="holds no results"):
        read_results(tmp_path / "nowhere")


def test_a_row_of_another_run_is_named(tmp_path: Path) -> None:
    path = filled(tmp_path, rows_of(1))
    change(path, "UPDATE manifest SET value = '1' WHERE entry = 'seed'")
    with pytest.raises(ResultsError, match=r"does not belong to this run: .*seed=0"):
        read_results(tmp_path)


def test_a_file_that_a_kill_left_empty_is_begun_anew(tmp_path: Path) -> None:
    (tmp_path / RESULTS).touch()
    with pytest.raises(ResultsError, match="holds no results yet"):
        read_results(tmp_path)
    filled(tmp_path, rows_of(1))
    assert len(read_results(tmp_path)[1]) == 2


# What goes wrong in mid-run


def test_a_full_disk_loses_nothing(tmp_path: Path) -> None:
    rows = rows_of(20)
    with EpisodeStore(tmp_path, manifest(20)) as store:
        with no_file_over(ROOM), pytest.raises(ResultsError, match=RESULTS) as told:
            append(store, rows)
        assert "\n" not in str(told.value)
        kept = len(store.rows)
        assert 0 < kept < len(rows)
        assert read_results(tmp_path)[1] == rows[:kept]
        # There is room again.
        append(store, rows[kept:])
    assert read_results(tmp_path)[1] == rows


def test_a_disk_that_stays_full_leaves_a_folder_that_goes_on(tmp_path: Path) -> None:
    rows = rows_of(20)
    with no_file_over(ROOM), pytest.raises(ResultsError, match=RESULTS):
        filled(tmp_path, rows, 20)
    kept = read_results(tmp_path)[1]
    assert kept == rows[: len(kept)] != []
    filled(tmp_path, rows[len(kept) :], 20)
    assert read_results(tmp_path)[1] == rows


@pytest.mark.parametrize("gone", ["folder", "file", "log", "replaced", "cut", "written"])
def test_a_folder_that_changes_in_mid_run_is_noticed(tmp_path: Path, gone: str) -> None:
    out = tmp_path / "out"
    first, second, third, *_ = rows_of(4)
    with EpisodeStore(out, manifest()) as store:
        store.append(first)
        if gone == "folder":
            shutil.rmtree(out)
        elif gone == "replaced":
            out.rename(tmp_path / "other")
            shutil.copytree(tmp_path / "other", out)
        elif gone == "cut":
            os.truncate(out / RESULTS, 10)
        elif gone == "written":
            change(out / RESULTS, "DELETE FROM episodes")
        else:
            (out / (RESULTS if gone == "file" else f"{RESULTS}-wal")).unlink()
        with pytest.raises(ResultsError, match="removed, replaced or changed"):
            store.append(second)
    if gone == "replaced":
        # The copy is whole: its log is not the run's to remove.
        filled(out, [second])
        assert read_results(out)[1] == [first, second]
        filled(tmp_path / "other", [third])
        assert read_results(tmp_path / "other")[1] == [first, third]


def test_a_kill_within_a_write_loses_no_row_that_was_kept(tmp_path: Path) -> None:
    rows = rows_of(5)
    kept = []
    # The database, what tells readers of the log, and the log: each is torn at some of these.
    for size in (0, 100, 20_000, 35_000, 50_001, 62_000, 77_777, 90_000, 111_111):
        folder = tmp_path / str(size)

        def write(folder: Path = folder, size: int = size) -> None:
            with EpisodeStore(folder, manifest(5)) as store:
                for row in rows:
                    store.append(row)
                    (folder / "told").write_text(str(len(store.rows)))

        assert killed(write, MID_WRITE, size)
        told = int((folder / "told").read_text()) if (folder / "told").exists() else 0
        with EpisodeStore(folder, manifest(5)) as store:
            assert store.rows == rows[: len(store.rows)]
            assert len(store.rows) in (told, told + 1)
            kept.append(len(store.rows))
            append(store, rows[len(store.rows) :])
        assert read_results(folder)[1] == rows
    assert len(set(kept)) > 4


def test_a_kill_at_any_moment_loses_no_row_that_was_kept(tmp_path: Path) -> None:
    rows = rows_of(40)
    kept = 0
    for wanted in (1, 2, 20, 21, 40, 79):
        told, telling = os.pipe()
        child = os.fork()
        if child == 0:
            with EpisodeStore(tmp_path, manifest(40)) as store:
                for row in rows[len(store.rows) :]:
                    store.append(row)
                    os.write(telling, b".")
            os._exit(0)
        os.close(telling)
        while kept < wanted and (dots := os.read(told, wanted - kept)):
            kept += len(dots)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        kept += len(os.read(told, 100))
        os.close(told)
        found = read_results(tmp_path)[1]
        assert found == rows[: len(found)]
        assert len(found) in (kept, kept + 1)
        kept = len(found)
    filled(tmp_path, rows[kept:], 40)
    assert read_results(tmp_path)[1] == rows


# What older versions wrote


def old_folder(folder: Path, lines: list[str], **changes: Any) -> Path:
    """Write a folder as older versions did."""
    folder.mkdir()
    content = {"format": 1, **manifest().to_json(), **changes}
    (folder / "manifest.json").write_text(json.dumps(content))
    (folder / "episodes.jsonl").write_text("".join(f"{line}\n" for line in lines))
    return folder


def old_lines(rows: list[EpisodeRow]) -> list[str]:
    """Return lines without the fields of today."""
    content = [dataclasses.asdict(row) for row in rows]
    return [json.dumps({k: v for k, v in row.items() if k != "scene"}) for row in content]


def test_an_old_folder_is_refused_by_name_and_imported(tmp_path: Path) -> None:
    rows = rows_of(4)[:5]
    old = old_folder(tmp_path / "old", old_lines(rows))
    with (old / "episodes.jsonl").open("a") as file:
        file.write('{"task": "Placem')
    for read in (lambda: read_results(old), lambda: EpisodeStore(old, manifest())):
        with pytest.raises(ResultsError, match=r"older version.*smp-bench import"):
            read()
    before = {path.name: path.read_bytes() for path in old.iterdir()}
    for _ in range(2):
        assert import_results(old, tmp_path / "new")[0] == manifest()
        stored, found = read_results(tmp_path / "new")
        assert stored == manifest()
        assert found == [dataclasses.replace(row, scene="") for row in rows]
    assert {path.name: path.read_bytes() for path in old.iterdir()} == before
    with pytest.raises(ResultsError, match="code: 'abc' there, 'xyz' now"):
        EpisodeStore(tmp_path / "new", manifest(code="xyz"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (lambda lines: [lines[0], lines[0]], "line 2.*twice"),
        (lambda lines: [lines[0], lines[1].replace('"seed": 0', '"seed": 9')], "line 2.*belong"),
        (lambda lines: [lines[0].replace('"seed": 0', '"seed": "0"')], "line 1.*got '0'"),
        (lambda lines: [lines[0][:40]], "line 1.*Invalid JSON"),
    ],
)
def test_a_damaged_old_row_is_named(
    tmp_path: Path, lines: Callable[[list[str]], list[str]], message: str
) -> None:
    old = old_folder(tmp_path / "old", lines(old_lines(rows_of(1))))
    with pytest.raises(ResultsError, match=rf"episodes\.jsonl, {message}"):
        import_results(old, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("changes", [{"format": 9}, {"episodes": "4"}, {"extra": 1}, {"cells": 1}])
def test_a_damaged_old_manifest_is_named(tmp_path: Path, changes: dict[str, Any]) -> None:
    old = old_folder(tmp_path / "old", [], **changes)
    with pytest.raises(ResultsError, match=r"manifest\.json is not a manifest"):
        import_results(old, tmp_path / "new")
    with pytest.raises(ResultsError, match="no results of an older version"):
        import_results(tmp_path, tmp_path / "new")
