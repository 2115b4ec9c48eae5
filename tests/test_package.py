"""The built wheel, installed into an environment of its own, works without the repository."""

import os
import re
import shutil
import site
import subprocess
import sys
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = ("smp_gym", "smp_planner", "envs_assets")

USE = """
import sys
from pathlib import Path

import gymnasium as gym
import smp_gym, smp_planner, envs_assets
from smp_planner.policy.planner_policy import PlannerPolicy

for package in (smp_gym, smp_planner, envs_assets):
    assert Path(package.__file__).is_relative_to(sys.prefix), package.__file__
for package in (smp_gym, smp_planner):
    assert (Path(package.__file__).parent / "py.typed").exists()
env = gym.make("smp_gym/Placement-v0", difficulty="easy")
policy = PlannerPolicy.make("promp", "Placement")
observation, _ = env.reset(seed=3)
state = None
for _ in range(5):
    action, state = policy.predict(observation, state, deterministic=True)
    observation, reward, terminated, truncated, info = env.step(action)
print(reward, len(state[0].plan.trajectories), smp_gym.__version__, smp_planner.__version__)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a wheel built from a copy of the sources, so that no build leaves traces in them."""
    source = tmp_path_factory.mktemp("source")
    for name in SOURCES:
        shutil.copytree(ROOT / name, source / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    folder = tmp_path_factory.mktemp("wheel")
    _run(
        [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index"],
        ["--quiet", "--wheel-dir", str(folder), "."],
        cwd=source,
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the interpreter of a fresh environment with the wheel and this one's dependencies.

    A path file lends it the packages that are installed here, which spares installing torch anew;
    path files inside those are not read, so an editable install here stays invisible. It is lent
    the kernels that are compiled here, too: an entry counts for equal sources only.
    """
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    interpreter = folder / "bin" / "python"
    packages = _run([str(interpreter), "-c", "import site; print(site.getsitepackages()[0])"])
    _run(
        [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--quiet"],
        ["--target", packages.strip(), str(wheel)],
    )
    lent = "\n".join(site.getsitepackages())
    (Path(packages.strip()) / "lent.pth").write_text(lent + "\n")
    for entry in ROOT.glob("smp_*/__pycache__/kernels-*/*.nbc"):
        copy = Path(packages.strip()) / entry.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(entry, copy)
    return interpreter


def _run(command: Sequence[str], more: Sequence[str] = (), cwd: Path | None = None) -> str:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    environment["OMP_NUM_THREADS"] = "1"
    done = subprocess.run(
        [*command, *more], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_wheel_holds_all_data_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for package in SOURCES:
        for path in (ROOT / package).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                assert str(path.relative_to(ROOT)) in names
    foreign = [
        name for name in names if name.split("/")[0] not in SOURCES and ".dist-info/" not in name
    ]
    assert foreign == []
    assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]


def test_wheel_is_small_enough_to_ship(wheel: Path) -> None:
    assert wheel.stat().st_size < 20e6


def test_installed_wheel_plans_and_acts_and_says_its_version(python: Path, tmp_path: Path) -> None:
    reward, particles, *said = _run([str(python), "-c", USE], cwd=tmp_path).split()
    assert float(reward) == 0.0
    assert int(particles) > 1
    text = (ROOT / "pyproject.toml").read_text()
    (declared,) = re.findall(r'^version = "(.+)"$', text, re.MULTILINE)
    assert said == [declared, declared]


def test_installed_command_answers(python: Path, tmp_path: Path) -> None:
    entry = "(entry,) = entry_points(group='console_scripts', name='smp-bench')"
    code = f"from importlib.metadata import entry_points; {entry}; entry.load()()"
    assert "Placement" in _run([str(python), "-c", code], ["list"], cwd=tmp_path)
