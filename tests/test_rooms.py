"""The rules of the house that no single room can check: who may import what, and no pickle."""

import ast
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("smp_gym", "smp_planner", "envs_assets")
MAKING = ("agents", "benchmark", "experiments")
TRAINING = (("smp_planner", "agents"), ("smp_gym", "inspection"))
ALLOWED_OF_GYM = {
    "atomic_files",
    "arrays",
    "scene",
    "compiling",
    "observation",
    "control",
    "robot",
    "geometry",
    "datasets",
    "sensing",
    "assets",
    "untrusted_files",
    "optional_packages",
}
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
SCRIPTS = sorted((ROOT / "scripts").glob("*.py"))


def _imports(tree: ast.AST) -> Iterator[str]:
    """Yield the full dotted names that a module imports, wherever in it the import stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute, so that they can be checked"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _violations(path: Path, source: str) -> list[str]:
    """Return what a file of one of the packages breaks, given by its path below the root."""
    package, *rooms = path.with_suffix("").parts
    in_benchmark = rooms[0] in MAKING
    tree = ast.parse(source)
    found = []
    for name in _imports(tree):
        top, *rest = name.split(".")
        if top in {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}:
            found.append(f"imports {name}: no file runs code")
        if package == "smp_gym" and top == "smp_planner":
            found.append(f"imports {name}: the tasks know nothing of planning")
        if package == "smp_planner" and top in {"pybullet", "pybullet_data"}:
            found.append(f"imports {name}: planning never touches the physics")
        if package == "smp_planner" and not in_benchmark:
            if top == "smp_gym" and (not rest or rest[0] not in ALLOWED_OF_GYM):
                found.append(f"imports {name}: only {sorted(ALLOWED_OF_GYM)} of smp_gym")
            if name in {"gymnasium.make", "gymnasium.make_vec"}:
                found.append(f"imports {name}: only {MAKING} make environments")
        if top == "stable_baselines3" and (package, rooms[0]) not in TRAINING:
            found.append(f"imports {name}: only agents/ and inspection/")
        if package == "envs_assets" and top in PACKAGES:
            found.append(f"imports {name}: data only")
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if package == "smp_planner" and not in_benchmark and called.split(".")[-1] == "make":
            owner = called.rpartition(".")[0]
            if owner in {"gym", "gymnasium"}:
                found.append(f"calls {called}: only {MAKING} make environments")
        for keyword in node.keywords:
            safe = {"allow_pickle": "False", "weights_only": "True"}.get(keyword.arg or "")
            if safe is not None and ast.unparse(keyword.value) != safe:
                found.append(f"calls {called} with {keyword.arg}: no file runs code")
        if called == "torch.load" and "weights_only" not in {k.arg for k in node.keywords}:
            found.append("calls torch.load without weights_only=True: no file runs code")
    return found


def test_no_two_files_of_tests_have_one_name() -> None:
    """pytest imports a test by its file name alone and refuses the second of that name."""
    names = [path.name for path in sorted((ROOT / "tests").rglob("test_*.py"))]
    assert len(names) > 100
    assert [name for name in names if names.count(name) > 1] == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports(path: Path) -> None:
    assert _violations(path.relative_to(ROOT), path.read_text()) == []


@pytest.mark.parametrize("path", [*FILES, *SCRIPTS], ids=lambda path: str(path.relative_to(ROOT)))
def test_every_module_says_what_it_is(path: Path) -> None:
    if path.stat().st_size:
        assert ast.get_docstring(ast.parse(path.read_text()))


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("smp_gym/env.py", "from smp_planner.planning.problem import Plan"),
        ("smp_gym/env.py", "def f():\n    import smp_planner"),
        ("smp_planner/collision/costs.py", "import pybullet as p"),
        ("smp_planner/collision/costs.py", "from smp_gym.physics.world import BulletWorld"),
        ("smp_planner/collision/costs.py", "import smp_gym"),
        ("smp_planner/collision/costs.py", "import gymnasium as gym\ngym.make('a')"),
        ("smp_planner/collision/costs.py", "from gymnasium import make"),
        ("smp_planner/benchmark/runner.py", "import pybullet"),
        ("smp_planner/benchmark/runner.py", "from stable_baselines3 import SAC"),
        ("smp_planner/policy_file.py", "import pickle"),
        ("smp_planner/policy_file.py", "np.load(path, allow_pickle=True)"),
        ("smp_planner/policy_file.py", "np.load(path, allow_pickle=flag)"),
        ("smp_planner/policy_file.py", "torch.load(path)"),
        ("smp_planner/policy_file.py", "torch.load(path, weights_only=False)"),
    ],
)
def test_the_check_sees_violations(path: str, source: str) -> None:
    assert _violations(Path(path), source)


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("smp_planner/collision/costs.py", "from smp_gym.scene import Obstacle"),
        ("smp_planner/collision/costs.py", "import smp_gym.robot.kinematics"),
        ("smp_planner/collision/costs.py", "PlannerPolicy.make('smp')"),
        (
            "smp_planner/benchmark/episodes.py",
            "import smp_gym\nimport gymnasium as gym\ngym.make('a')",
        ),
        ("smp_planner/policy_file.py", "np.load(path, allow_pickle=False)"),
        ("smp_planner/policy_file.py", "torch.load(path, weights_only=True)"),
    ],
)
def test_the_check_lets_the_allowed_pass(path: str, source: str) -> None:
    assert _violations(Path(path), source) == []


PLANNER_ROOMS = (
    ("torch_threads", "strict_settings", "movement_primitives", "inference", "occupancy"),
    ("collision",),
    ("adaptation",),
    ("planning", "batch"),
    ("planners", "library"),
    ("policy",),
    ("benchmark", "agents"),
    ("experiments",),
)
"""Rooms of the planner, from the lowest: each imports of its own and of those before it."""


def _modules() -> dict[str, ast.Module]:
    found = {}
    for path in FILES:
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text())
    return found


def _at_import(tree: ast.Module) -> Iterator[ast.stmt]:
    """Yield the statements that run when a module is imported."""
    for node in tree.body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node


def _imported(modules: dict[str, ast.Module], nodes: Iterator[ast.AST]) -> set[str]:
    """Return the modules of the packages that statements import."""
    found = set()
    for node in nodes:
        for name in _imports(node):
            while name and name not in modules:
                name = name.rpartition(".")[0]
            if name:
                found.add(name)
    return found


def test_no_module_needs_itself_to_be_imported() -> None:
    modules = _modules()
    graph = {name: _imported(modules, _at_import(tree)) - {name} for name, tree in modules.items()}
    # A package is imported before what is in it, and what it re-exports is no circle of ideas.
    graph = {
        name: {other for other in others if not name.startswith(f"{other}.")}
        for name, others in graph.items()
    }
    order = graphlib.TopologicalSorter(graph)
    assert len(list(order.static_order())) >= len(modules)


def test_the_planner_s_rooms_import_downwards_only() -> None:
    modules = _modules()
    floor = {room: number for number, rooms in enumerate(PLANNER_ROOMS) for room in rooms}
    for name, tree in modules.items():
        parts = name.split(".")
        if parts[0] != "smp_planner" or len(parts) < 2:
            continue
        assert parts[1] in floor, f"{name} stands in no room of PLANNER_ROOMS"
        for other in _imported(modules, iter([tree])):
            target = other.split(".")
            if target[0] == "smp_planner" and len(target) > 1:
                assert floor[target[1]] <= floor[parts[1]], f"{name} imports {other}"


def test_a_file_s_name_says_one_thing_in_a_package() -> None:
    """But for the parts that every task's folder has."""
    for package in ("smp_gym", "smp_planner"):
        stems = [
            path.stem
            for path in FILES
            if path.is_relative_to(ROOT / package)
            and path.stem != "__init__"
            and not path.is_relative_to(ROOT / "smp_gym" / "tasks")
        ]
        assert sorted(stems) == sorted(set(stems))


HARMING = {"atomic_files.py", "attack.py", "attack_commands.py", "compiling.py", "upgrade.py"}
WRITING = {"write_text", "write_bytes", "savefig", "savez", "savez_compressed", "get_writer"}


def _torn_by_kills(tree: ast.AST, whole: bool = False) -> Iterator[str]:
    """Yield calls that write a file in place, and not beside it first as `replacing` has it."""
    if isinstance(tree, ast.With):
        whole = whole or any("replacing(" in ast.unparse(item) for item in tree.items)
    if isinstance(tree, ast.Call) and not whole:
        called = ast.unparse(tree)
        if (isinstance(tree.func, ast.Attribute) and tree.func.attr in WRITING) or (
            ast.unparse(tree.func).endswith("open") and re.search(r"['\"][wx]b?['\"]", called)
        ):
            yield called
    for child in ast.iter_child_nodes(tree):
        yield from _torn_by_kills(child, whole)


def _in_memory(call: str, source: str) -> bool:
    """Return whether a call writes to what its source makes a buffer of."""
    written = re.search(r"\((\w+)", call)
    return written is not None and f"{written[1]} = io.BytesIO()" in source


def test_no_file_is_written_in_place() -> None:
    for path in [*FILES, *SCRIPTS]:
        # Attacks and an upgrade damage copies in folders that they remove.
        if path.name not in HARMING:
            source = path.read_text()
            torn = list(_torn_by_kills(ast.parse(source)))
            assert [call for call in torn if not _in_memory(call, source)] == [], path
    for source in (
        "path.write_text('')",
        "open(path, 'w')",
        "with path.open('wb') as f:\n    pass",
    ):
        assert list(_torn_by_kills(ast.parse(source)))
