"""What an install without extras can do, and what it says where a part is missing."""

import importlib
import re
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from smp_gym.optional_packages import EXTRAS, require, require_pybullet

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

IMPORT = re.compile(
    r"^ *(?:import (?=\w+(?:\.\w+)*(?: as \w+)?(?:  #.*)?$)|from (?=\S+ import ))(\w+)", re.M
)

REFUSING = """
import sys

class Refusing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {refused}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refusing())
"""

STEPPING = """
import gymnasium
import smp_gym

env = gymnasium.make("smp_gym/DrawS-v0", difficulty="none")
env.reset(seed=3)
print(env.step(env.action_space.sample())[1])
try:
    import smp_planner
except ModuleNotFoundError as error:
    print(error)
"""

PLANNING = """
import gymnasium
import numpy as np
import smp_gym
from smp_planner import SMP, Circle

phase = np.linspace(0.0, 1.0, 30)
paths = [np.stack([phase, bend * np.sin(np.pi * phase)], axis=1) for bend in (0.2, 0.25, 0.3)]
plan = SMP.fit(paths).adapt([Circle((0.5, 0.25), 0.05)], particles=6)
print(len(plan.trajectories))
for failing in (lambda: gymnasium.make("smp_gym/DrawS-v0"), plan.plot):
    try:
        failing()
    except ModuleNotFoundError as error:
        print(error)
"""


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _distributions(requirements: list[str]) -> set[str]:
    return {_normal(re.split(r"[^\w.-]", requirement)[0]) for requirement in requirements}


def _printed(refused: set[str], code: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", REFUSING.format(refused=refused) + code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def _modules(*extras: str) -> set[str]:
    return {module for extra in extras for module in EXTRAS[extra]}


COMMAND = """
from smp_gym.console_script import smp_bench

try:
    smp_bench()
except SystemExit as end:
    print(end.code)
"""


def test_the_command_says_in_one_line_what_it_needs() -> None:
    for refused in (_modules("bench"), _modules("planner"), {"typer"}):
        done = subprocess.run(
            [sys.executable, "-c", REFUSING.format(refused=refused) + COMMAND],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout == "2\n"
        (line,) = done.stderr.splitlines()
        assert line.startswith("error: smp-bench needs ")
        assert line.endswith('pip install "smp-gym[bench]"')


def test_environments_need_no_extra() -> None:
    refused = {*_modules(*EXTRAS), "pandas", "rich", "collada"}
    *_, reward, error = _printed(refused, STEPPING)
    assert float(reward) == 0.0
    assert 'pip install "smp-gym[planner]"' in error


def test_planning_needs_no_physics() -> None:
    refused = {"pybullet", "pybullet_data", *_modules("rl", "bench")}
    particles, physics, drawing = _printed(refused, PLANNING)
    assert int(particles) == 6
    assert "need PyBullet" in physics
    assert "Python 3.10 and 3.11" in physics
    assert "drawing a plan needs matplotlib" in drawing
    assert 'pip install "smp-gym[bench]"' in drawing


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_is_named_where_one_of_its_modules_is_missing(extra, monkeypatch):
    monkeypatch.setitem(sys.modules, EXTRAS[extra][-1], None)
    with pytest.raises(ModuleNotFoundError) as raised:
        require(extra, "This")
    assert EXTRAS[extra][-1] in str(raised.value)
    assert str(raised.value).startswith("This needs ")
    assert f'pip install "smp-gym[{extra}]"' in str(raised.value)


def test_nothing_is_raised_where_all_is_installed() -> None:
    require("planner", "this")
    require("bench", "this", "matplotlib", "typer")
    require_pybullet()


def test_the_extras_bring_what_their_names_promise() -> None:
    homes = packages_distributions()
    for extra, modules in EXTRAS.items():
        brought = _distributions(PROJECT["optional-dependencies"][extra])
        for module in modules:
            # What is not installed here is brought by the distribution of its own name.
            assert brought & {_normal(home) for home in homes.get(module, [module])}, module


def test_every_import_is_of_the_dependencies_or_of_an_extra() -> None:
    optional = PROJECT["optional-dependencies"]
    brought = _distributions([*PROJECT["dependencies"], *(r for e in optional.values() for r in e)])
    homes = packages_distributions()
    seen: set[str] = set()
    for package in ("smp_gym", "smp_planner"):
        for path in (ROOT / package).rglob("*.py"):
            for top in set(IMPORT.findall(path.read_text())) - sys.stdlib_module_names:
                # Triton comes with torch's build for GPUs.
                if top not in {"smp_gym", "smp_planner", "envs_assets", "triton"}:
                    found = {_normal(home) for home in homes.get(top, [top])}
                    assert brought & found, f"{path} imports {top}"
                seen.add(top)
    assert {"numpy", "torch", "pybullet", "ray", "stable_baselines3"} <= seen


def test_the_rooms_that_need_an_extra_say_so(monkeypatch):
    """They ask when they are imported."""
    for room, extra, module in (
        ("smp_planner.benchmark", "bench", "typer"),
        ("smp_planner.experiments", "bench", "ot"),
        ("smp_gym.jaco_assets", "planner", "trimesh"),
        ("smp_planner.agents.training", "rl", "stable_baselines3"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        for name in [name for name in sys.modules if name.startswith(room)]:
            monkeypatch.delitem(sys.modules, name)
        with pytest.raises(ModuleNotFoundError, match=rf"{room} needs .*smp-gym\[{extra}\]"):
            importlib.import_module(room)
