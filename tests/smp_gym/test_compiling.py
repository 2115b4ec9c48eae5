"""Compiled kernels: an edit anywhere takes effect, and a broken cache costs time only."""

import logging
import os
import pty
import shutil
import subprocess
import sys
import tempfile
import traceback
from contextlib import suppress
from pathlib import Path

import numba
import pytest
from numba.core import config

import smp_gym.compiling  # noqa: F401  (what copies of this process need not import anew)

ROOT = Path(__file__).parents[2]

CALLEE = """
from smp_gym.compiling import kernel
from toy.constants import OFFSET

@kernel
def inner(x):
    return {factor} * x + OFFSET
"""
CALLER = """
from smp_gym.compiling import kernel
from toy.callee import inner

@kernel
def outer(x):
    return inner(x)
"""
RUN = """
import logging
logging.basicConfig(format="LOGGED %(message)s")
from toy.caller import outer
print(outer(1.0), outer(1), "hits", sum(outer.stats.cache_hits.values()))
"""


def _made(folder):
    (folder / "toy").mkdir()
    (folder / "toy/__init__.py").touch()
    _write(folder, "constants", "OFFSET = 10.0")
    _write(folder, "callee", CALLEE.format(factor=2.0))
    _write(folder, "caller", CALLER)
    return folder


@pytest.fixture(scope="module", autouse=True)
def _compiler():
    """Let this process compile once, which spares its copies loading the compiler."""
    numba.njit(lambda x: 2.0 * x)(1.0)


@pytest.fixture
def package(tmp_path):
    return _made(tmp_path)


@pytest.fixture(scope="module")
def first_run(tmp_path_factory):
    """A folder with the package in which a process has compiled, and what that process gave."""
    folder = _made(tmp_path_factory.mktemp("compiled"))
    return folder, _run_anew(folder)


@pytest.fixture
def compiled(first_run, tmp_path):
    """The package with the entries that a process before has kept."""
    return shutil.copytree(first_run[0], tmp_path, dirs_exist_ok=True)


def _write(folder, name, text):
    (folder / f"toy/{name}.py").write_text(text)


def _environment(folder):
    return {
        "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}",
        # Without bytecode, so that edits within one tick of the clock count for Python itself too.
        "PYTHONDONTWRITEBYTECODE": "1",
        "XDG_CACHE_HOME": str(folder / "user"),
        "NUMBA_CACHE_DIR": "",
    }


def _given(output, errors):
    values, _, hits = output.partition("hits")
    return [float(value) for value in values.split()], int(hits), errors


def _run_anew(folder):
    """Use the package in a new process."""
    ended = subprocess.run(
        [sys.executable, "-c", RUN],
        env=os.environ | _environment(folder),
        capture_output=True,
        text=True,
        check=True,
    )
    return _given(ended.stdout, ended.stderr)


def _start(folder, **variables):
    """Use the package in a copy of this process, which has imported all but the package."""
    streams = [tempfile.TemporaryFile("w+") for _ in range(2)]  # noqa: SIM115
    child = os.fork()
    if child:
        return child, streams
    status = 1
    try:
        for number, stream in enumerate(streams, start=1):
            os.dup2(stream.fileno(), number)
        sys.stdout, sys.stderr = streams
        os.environ.update(_environment(folder) | variables)
        config.reload_config()
        sys.dont_write_bytecode = True
        sys.path.insert(0, str(folder))
        logging.root.handlers.clear()
        exec(RUN, {})
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in streams:
            stream.flush()
        os._exit(status)


def _ended(started):
    child, streams = started
    status = os.waitpid(child, 0)[1]
    output, errors = (stream.seek(0) or stream.read() for stream in streams)
    assert status == 0, errors
    return _given(output, errors)


def _run(folder, **variables):
    return _ended(_start(folder, **variables))


def _entries(folder, pattern="toy.*.nbc"):
    return sorted((folder / "toy/__pycache__").glob(f"kernels-*/{pattern}"))


def test_kept_for_the_next_process(first_run, compiled):
    assert first_run[1] == ([12.0, 12.0], 0, "")
    assert _run_anew(compiled) == ([12.0, 12.0], 2, "")


def test_an_edited_callee_in_another_file_counts(compiled):
    _write(compiled, "callee", CALLEE.format(factor=3.0))
    assert _run(compiled) == ([13.0, 13.0], 0, "")


def test_an_edited_constant_of_a_file_without_kernels_counts(compiled):
    _write(compiled, "constants", "OFFSET = 20.0")
    assert _run(compiled) == ([22.0, 22.0], 0, "")


def test_any_edited_kernel_file_counts(compiled):
    _write(compiled, "other", "from smp_gym.compiling import kernel\n@kernel\ndef f():\n    pass")
    assert _run(compiled)[1] == 0


def test_entries_of_few_digests_are_kept(package):
    home = package / "toy/__pycache__"
    for age in range(1, 6):
        (home / f"kernels-{age}").mkdir(parents=True)
        (home / f"kernels-{age}/toy.nbc").touch()
        os.utime(home / f"kernels-{age}", (0, 1000 - age))
    assert _run(package)[1] == 0
    assert {path.name for path in home.glob("kernels-?")} == {"kernels-1", "kernels-2"}
    assert _run(package)[1] == 2


def test_torn_entries_are_compiled_again_with_one_warning(compiled):
    for path, left in zip(_entries(compiled, "toy.caller.outer-*.nbc"), (0, -1), strict=True):
        path.write_bytes(path.read_bytes()[:left])
    values, hits, errors = _run(compiled)
    assert values == [12.0, 12.0]
    assert hits == 0
    assert errors.count("LOGGED") == 1
    assert "cannot be read" in errors
    assert _run(compiled) == ([12.0, 12.0], 2, "")


def test_an_entry_of_another_kernel_does_not_pass(compiled):
    first, second = _entries(compiled, "toy.caller.outer-*.nbc")
    first.write_bytes(second.read_bytes())
    values, hits, _ = _run(compiled)
    assert values == [12.0, 12.0]
    assert hits == 1


def test_falls_back_to_the_users_cache(package):
    # A file in the place of the folder keeps even the superuser from writing.
    (package / "toy/__pycache__").touch()
    assert _run(package) == ([12.0, 12.0], 0, "")
    assert list((package / "user").rglob("toy.caller.outer-*.nbc"))
    assert _run(package)[1] == 2


def test_without_any_writable_folder_it_compiles_with_one_warning(package):
    (package / "toy/__pycache__").touch()
    (package / "user").touch()
    values, hits, errors = _run(package)
    assert values == [12.0, 12.0]
    assert hits == 0
    assert errors.count("LOGGED") == 1
    assert "none of" in errors


def test_an_entry_that_cannot_be_written_is_no_error(compiled):
    for path in _entries(compiled):
        path.unlink()
        path.mkdir()
    values, _, errors = _run(compiled)
    assert values == [12.0, 12.0]
    assert errors.count("LOGGED") == 1
    assert "cannot be kept" in errors
    assert not list((compiled / "toy/__pycache__").rglob("tmp*"))


def test_the_folder_that_the_user_names(package):
    assert _run(package, NUMBA_CACHE_DIR=str(package / "named"))[1] == 0
    assert list((package / "named").rglob("toy.caller.outer-*.nbc"))
    assert not _entries(package)


def test_processes_at_once(package):
    for process in [_start(package) for _ in range(3)]:
        assert _ended(process)[0] == [12.0, 12.0]
    assert _run(package) == ([12.0, 12.0], 2, "")


def test_kernels_use_no_other_cache():
    for path in [*(ROOT / "smp_gym").rglob("*.py"), *(ROOT / "smp_planner").rglob("*.py")]:
        if path.name != "compiling.py":
            assert "njit" not in path.read_text(), path


def test_whoever_watches_a_terminal_is_told_of_the_first_compiling(package):
    """A process on a pseudo-terminal says so once when it compiles, and nothing when it loads."""
    told = []
    for _ in range(2):
        ours, theirs = pty.openpty()
        subprocess.run(
            [sys.executable, "-c", RUN],
            env=os.environ | _environment(package),
            stdout=subprocess.DEVNULL,
            stderr=theirs,
            check=True,
        )
        os.close(theirs)
        with suppress(OSError):  # that is how reading a closed terminal ends
            told.append(os.read(ours, 4096).decode())
        os.close(ours)
    assert [text.count("compiling for the first use") for text in told] == [1]
