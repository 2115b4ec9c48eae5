"""Attack the command lines with bad ones, drawn by kind, and print what came of them.

    python scripts/attack_commands.py --count 300 --seed 0

Every command of `smp-bench` and of the scripts is called in this process, in a folder that is
removed, with one thing wrong: a number, a name, a path, an unknown option, a missing value. Counted
is whether it was refused, with a message that names the option or its value, went to work or ended
all the same, or raised what ends in a traceback. A command that goes to work is stopped as soon as
it starts a process, opens a port, writes into the checkout, or has had its time.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import faulthandler
import io
import multiprocessing.process
import os
import resource
import runpy
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
import typer
from rich.console import Console

from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest
from smp_planner.benchmark.options import CommandLine, run_command
from smp_planner.benchmark.results_folder import RESULTS
from smp_planner.experiments.outcomes import print_outcomes

LIMIT = 2.0
"""Seconds that a command may take; then it has gone to work."""

MEMORY = 8 * 2**30
"""Bytes of address space."""

OUTCOMES = ("named", "unnamed", "worked", "ended", "traceback")
"""Refused with a message that names the option or its value, or does not; stopped at work; ended
well; an error that ends in a traceback."""

NUMBERS = ("", "one", "1.5.2", "nan", "inf", "-inf", "-1", "0", "1e400", "0x10", "9" * 30, "-" * 3)

NAMES = (
    "", ",", "nothing", "Placement,nothing", "smp,smp", "hard,hard", "Placement,Placement",
    "[/red]", "[bold", "\udcff", "\u202esmp", "naïve", "x" * 5000, "a=nothing:Class", "a=none.zip",
    "=", "a=", "a b", "-1", "../..", "0,1", "1,x", "0.5", "%s", "{0}", "nan,nan", "\n",
)  # fmt: skip

_ROOT = Path(__file__).resolve().parents[1]

_STARTS = ("subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.exec", "socket.bind")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a command.

    Attributes:
        option: its name on the command line; of an argument, without dashes.
        kind: int, float, str, bool or Path.
        required: whether it has no default.
        many: whether it is an argument that takes several values.
    """

    option: str
    kind: type
    required: bool
    many: bool = False

    @property
    def is_option(self) -> bool:
        """Whether it is no argument."""
        return self.option.startswith("-")

    def given(self, value: str) -> list[str]:
        """Return it with a value, as words of a command line."""
        return [f"{self.option}={value}"] if self.is_option else [value]


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        title: for the table.
        app: that it is of.
        words: its name in there; nothing where there is but one.
        parameters: without those that show help.
    """

    title: str
    app: CommandLine
    words: tuple[str, ...]
    parameters: tuple[Parameter, ...]


def commands() -> list[Command]:
    """Return the commands of `smp-bench` and of all scripts but this."""
    found = []
    for path in sorted((_ROOT / "scripts").glob("*.py")):
        if path.name != Path(__file__).name and "__main__" in (text := path.read_text()):
            content = runpy.run_path(str(path))
            app = content.get("app")
            if app is None:
                app = CommandLine(add_completion=False)
                app.command()(content["main"])
            title = "smp-bench" if "benchmark.cli" in text else path.name
            found += list(_commands_of(title, app))
    return found


def _commands_of(title: str, app: CommandLine) -> Iterator[Command]:
    top = typer.main.get_command(app)
    group = getattr(top, "commands", None)
    for info in app.registered_commands:
        assert info.callback is not None
        hints = get_type_hints(info.callback)
        name = info.name or info.callback.__name__.replace("_", "-")
        command = top if group is None else group[name]
        parameters = []
        for each in command.params:
            if each.name not in hints:
                continue
            hint = hints[each.name]
            kinds = {part for part in (hint, *get_args(hint)) for part in (part, *get_args(part))}
            (kind,) = kinds & {int, float, str, bool, Path}
            is_option = each.param_type_name == "option"
            option = each.opts[0] if is_option else each.metavar or each.name.upper()
            parameters.append(Parameter(option, kind, each.required, each.nargs == -1))
        words = () if group is None else (name,)
        yield Command(" ".join((title, *words)), app, words, tuple(parameters))


def bad_files(folder: Path) -> list[Path]:
    """Make files that are not what a command reads, and return the paths of these and of none."""
    manifest = make_manifest([Cell("Placement", "none")], ["promp"], 0, 1)
    (key,) = manifest.episode_keys()
    with EpisodeStore(folder / "run", manifest) as store:
        fields = (key.task, key.method, key.difficulty, key.seed)
        store.append(EpisodeRow(*fields, True, False, "", "", 0.1, 1.0, 0.02, 150))
    whole = (folder / "run" / RESULTS).read_bytes()
    contents = {"cut": whole[: len(whole) // 2], "empty": b"", "odd": b"\x00{[\xff"}
    for name, content in contents.items():
        (folder / name).mkdir()
        for file in (RESULTS, "agent.json", "final.zip", "trials.json", "manifest.json"):
            (folder / name / file).write_bytes(content)
        (folder / f"{name}.json").write_bytes(content)
    (folder / "list.json").write_text("[]")
    (folder / "deep.json").write_text("[" * 10**5)
    return [
        *sorted(folder.iterdir()),
        folder / "odd.json" / "under",
        folder / "none" / "deep",
        folder / ("x" * 300),
        folder / "[/red]",
        folder / "\udcff",
    ]


def drawn(
    command: Command, folder: Path, paths: list[Path], rng: np.random.Generator
) -> tuple[list[str], tuple[str, ...]]:
    """Return a bad command line, and the words that a message can name of what is wrong."""
    good = {
        parameter: _good(parameter, command, folder)
        for parameter in command.parameters
        if parameter.required or (parameter.kind is Path and parameter.option in _GIVEN)
    }
    # What else is wrong may be named first.
    also = (str(folder / "run"),) if command.title in _OTHER_FOLDERS else ()
    how = rng.random()
    if how < 0.15 or not command.parameters:
        word = str(rng.choice(["--no-such-option", "-Z", "--=", "surplus\udcff"]))
        return [*command.words, *_line(good), word], (word.strip("="), "surplus", *also)
    attacked = command.parameters[rng.integers(len(command.parameters))]
    if how < 0.2 and attacked.is_option and attacked.kind is not bool:
        return [*command.words, *_line(good), attacked.option], (attacked.option,)
    if how < 0.25 and attacked.required:
        left = {parameter: words for parameter, words in good.items() if parameter != attacked}
        return [*command.words, *_line(left)], (attacked.option,)
    if attacked.kind is Path:
        value = str(paths[rng.integers(len(paths))])
    else:
        values = {int: NUMBERS, float: NUMBERS, bool: ("maybe",)}.get(attacked.kind, NAMES)
        value = values[rng.integers(len(values))]
    words = attacked.given(value)
    if attacked.many and attacked.kind is str:
        words = [*_good(attacked, command, folder)[:-1], value]
    parts = [part.strip() for part in value.split(",")] if value.strip() else [""]
    named = (attacked.option, value, *parts, *also)
    return [*command.words, *_line({**good, attacked: words})], named


def _good(parameter: Parameter, command: Command, folder: Path) -> list[str]:
    """Return words that give a parameter a value which its command takes."""
    if parameter.many and parameter.kind is str:
        return [str(folder / "run"), "promp", "promp"]
    if parameter.option in ("--problems", "--particles"):
        return parameter.given(str(folder / "odd.json"))
    if parameter.option == "--task":
        return parameter.given("Placement")
    made = folder / "made" / ("file" if command.title in _WRITE_FILES else "folder")
    return parameter.given(str(made if parameter.is_option else folder / "run"))


_GIVEN = ("--out", "--folder", "--problems", "--particles")
"""Options that are always given, so that nothing is read or written elsewhere."""

_WRITE_FILES = (
    "record_demonstrations.py",
    "smp-bench export",
    "smp-bench report",
    "speed_batch.py prepare",
    "speed_plan.py",
    "train_shape_maps.py",
    "tune_methods.py",
)


_OTHER_FOLDERS = (
    "ship_rows.py lasa",
    "ship_rows.py narrow-places",
    "ship_rows.py sets",
    "ship_rows.py sides",
    "smp-bench import",
)
"""Commands that do not take what `smp-bench run` has written."""


def _line(given: dict[Parameter, list[str]]) -> list[str]:
    """Return arguments, then options, as words of a command line."""
    ordered = sorted(given, key=lambda parameter: parameter.is_option)
    return [word for parameter in ordered for word in given[parameter]]


_WHOLE = ("importlib._bootstrap", f"numba{os.sep}core", "llvmlite")
"""Parts of paths of what is not stopped within."""


class Stopped(BaseException):
    """A command has gone to work."""


_guarded = False


def _guard(event: str, arguments: tuple[Any, ...]) -> None:
    """Stop what starts processes, opens ports or writes into the checkout."""
    if not _guarded:
        return
    if event in _STARTS:
        raise Stopped(event)
    if event == "open":
        path, mode, flags = arguments
        writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) or set(mode or "") & set("wax+")
        # Compiled kernels are kept beside their sources.
        kept = isinstance(path, str) and "__pycache__" not in path
        if writes and kept and Path(path).absolute().is_relative_to(_ROOT):
            raise Stopped(path)


def _start(*_: Any, **__: Any) -> None:
    raise Stopped("multiprocessing")


@contextmanager
def guarded(limit: float) -> Iterator[list[str]]:
    """Stop a command that goes to work, and put back what it changed of this process.

    Yields:
        What is empty until the time is over; errors then are of the stop.
    """
    global _guarded

    over: list[str] = []

    def stop(_: int, frame: FrameType | None) -> None:
        # What is imported or compiled by half would break the commands that follow.
        while frame is not None:
            if any(place in frame.f_code.co_filename for place in _WHOLE):
                return
            frame = frame.f_back
        over.append("time")
        raise Stopped("time")

    start = multiprocessing.process.BaseProcess.start
    environment, modules, where = dict(os.environ), list(sys.path), os.getcwd()
    before = signal.signal(signal.SIGALRM, stop)
    faulthandler.dump_traceback_later(120.0, exit=True)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    multiprocessing.process.BaseProcess.start = _start  # type: ignore[method-assign]
    # Again, should the first come in an import or be swallowed where it comes.
    signal.setitimer(signal.ITIMER_REAL, limit, 0.5)
    os.environ |= {"COLUMNS": "200", "MINARI_DATASETS_PATH": f"{where}/minari"}
    _guarded = True
    try:
        yield over
    finally:
        _guarded = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        # A command may have lowered them for good.
        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        faulthandler.cancel_dump_traceback_later()
        multiprocessing.process.BaseProcess.start = start  # type: ignore[method-assign]
        os.environ.clear()
        os.environ.update(environment)
        sys.path[:] = modules
        os.chdir(where)


def judged(
    command: Command, line: list[str], named: tuple[str, ...], limit: float = LIMIT
) -> tuple[str, str]:
    """Return what came of a command line, and what was said of it."""
    buffers = [io.BytesIO(), io.BytesIO()]
    written = [
        io.TextIOWrapper(buffer, "utf-8", errors)
        for buffer, errors in zip(buffers, _ENCODING, strict=True)
    ]
    what, said, over = "ended", "", []
    try:
        with guarded(limit) as over, redirect_stdout(written[0]), redirect_stderr(written[1]):
            command.app(line, prog_name=command.title)
    except Stopped as stopped:
        what, said = "worked", str(stopped)
    except SystemExit as end:
        for buffer, stream in zip(buffers, written, strict=True):
            stream.flush()
            said += buffer.getvalue().decode("utf-8", "replace")
        if end.code not in (0, None):
            what = "named" if _is_named(named, said) else "unnamed"
            if end.code not in (1, 2) or "Traceback" in said:
                what, said = "traceback", f"exit status {end.code!r}: {said}"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        said = f"{type(error).__name__}: {error} ({place.filename}:{place.lineno})"
        what = "worked" if over else "traceback"
    return what, said


_ENCODING = ("strict", "backslashreplace")
"""How a terminal's two streams take what is no text."""


def _is_named(names: tuple[str, ...], said: str) -> bool:
    """Return whether a message says one of some names or values, an empty one by its quotes."""
    told = _squeezed(said)
    return any(_squeezed(_printable(name[:60])) in told if name else "''" in said for name in names)


def _printable(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _squeezed(text: str) -> str:
    """Return a text without blanks, frames and escapes, as lines are broken anywhere."""
    return "".join(letter for letter in text if letter.isalnum() or letter in "-=[,").casefold()


def attack(
    count: int,
    seed: int,
    report: Callable[[str], None] = lambda line: None,
    limit: float = LIMIT,
) -> dict[str, Counter[str]]:
    """Return how often what came of bad command lines, by command.

    Args:
        count: command lines to draw.
        seed: of what is drawn.
        report: is told of each that was not refused by name.
        limit: seconds that a command may take.
    """
    rng = np.random.default_rng(seed)
    outcomes: dict[str, Counter[str]] = {}
    known = commands()
    with tempfile.TemporaryDirectory() as name:
        folder, kept = Path(name, "given"), Path(name, "kept")
        folder.mkdir()
        paths, where = bad_files(folder), os.getcwd()
        shutil.copytree(folder, kept)
        sys.addaudithook(_guard)
        os.chdir(folder)
        try:
            for _ in range(count):
                command = known[rng.integers(len(known))]
                line, named = drawn(command, folder, paths, rng)
                what, said = judged(command, line, named, limit)
                # What it wrote is not there for the next.
                os.chdir(where)
                shutil.rmtree(folder)
                shutil.copytree(kept, folder)
                os.chdir(folder)
                outcomes.setdefault(command.title, Counter())[what] += 1
                if what != "named":
                    words = " ".join(word[:60] for word in line[len(command.words) :])
                    told = " ".join(said.split())[-300:]
                    report(_printable(f"{what}: {command.title} {words!r} {told}"))
        finally:
            os.chdir(where)
    return outcomes


def main(
    count: Annotated[int, typer.Option(help="Command lines to draw.", min=1)] = 300,
    seed: Annotated[int, typer.Option(help="Of what is drawn.", min=0)] = 0,
) -> None:
    """Attack the command lines, and print a table; the exit status is 1 if one ends in a traceback.

    Example: python scripts/attack_commands.py --count 300 --seed 0
    """
    warnings.simplefilter("ignore")
    console = Console()
    outcomes = attack(count, seed, partial(console.print, markup=False, highlight=False))
    total = print_outcomes(console, outcomes, OUTCOMES, "command", f"{count} bad command lines")
    if total["traceback"]:
        raise typer.Exit(1)


if __name__ == "__main__":
    run_command(main)
