"""Every script says in one line by which extra comes what it imports, and names all of them."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

from smp_gym.optional_packages import EXTRAS

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "scripts"
SCRIPTS = sorted(path for path in FOLDER.glob("*.py") if "__main__" in path.read_text())
ALWAYS = ("planner", "bench")
LOADED = ("pydantic", "scipy.optimize", "numba", "pybullet", "smp_planner.benchmark.options")
"""Beside what planner and bench bring, what most scripts import."""


def _declared(path: Path) -> tuple[str, ...]:
    """Return the extras that a script names beside planner and bench."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    (call,) = (each for each in calls if ast.unparse(each.func) == "require_for_script")
    return tuple(ast.literal_eval(each) for each in call.args)


def _without(modules: dict[str, list[str]], loaded: list[str]) -> dict[str, tuple[int, str]]:
    """Return exit status and standard error of each script, by its name."""
    arguments = [str(FOLDER), json.dumps(modules), json.dumps(loaded)]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", str(ROOT / "tests" / "missing_extras.py"), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, tuple[int, str]] = json.loads(done.stdout)
    return found


def test_a_script_without_extras_ends_in_one_line() -> None:
    optional = [module for modules in EXTRAS.values() for module in modules]
    found = _without({path.name: optional for path in SCRIPTS}, [])
    assert len(found) > 25
    for name, (status, said) in found.items():
        (line,) = said.splitlines()
        assert status == 2, name
        assert line.startswith(f"error: {name} needs torch, ")
        assert line.endswith('pip install "smp-gym[bench]"')


def test_a_script_imports_of_the_extras_that_it_names_alone() -> None:
    refused = {}
    for path in SCRIPTS:
        named = {*ALWAYS, *_declared(path)}
        refused[path.name] = [m for extra in EXTRAS if extra not in named for m in EXTRAS[extra]]
    everywhere = [module for extra in ALWAYS for module in EXTRAS[extra]]
    for name, (status, said) in _without(refused, [*everywhere, *LOADED]).items():
        assert (status, said) == (0, ""), (name, said)


def test_a_script_names_each_extra_that_is_missing() -> None:
    for extra in ("rl", "dev"):
        found = _without(
            {path.name: list(EXTRAS[extra]) for path in SCRIPTS if extra in _declared(path)}, []
        )
        assert found
        for name, (status, said) in found.items():
            assert status == 2
            assert said.startswith(f"error: {name} needs {EXTRAS[extra][0]}, ")
            assert said.endswith(f'pip install "smp-gym[{extra}]"\n')
