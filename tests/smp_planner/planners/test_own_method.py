"""A method of one's own runs in the benchmark, without a change of the package."""

import importlib
import json
import shutil
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.suites import Cell
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.manifest import make_manifest, read_results
from smp_planner.benchmark.runner import run
from smp_planner.planners import registry
from smp_planner.planners.registry import resolve
from smp_planner.policy.planner_policy import PlannerPolicy

SPEC = "straight=my_planner:StraightLine"
NONE = Cell("Placement", "none")


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return the file of a module that can be imported, here and in the workers."""
    path = tmp_path / "modules" / "my_planner.py"
    path.parent.mkdir()
    shutil.copy(Path(__file__).with_name("straight_line.py"), path)
    monkeypatch.syspath_prepend(path.parent)
    yield path
    sys.modules.pop("my_planner", None)


@pytest.fixture
def installed(module, monkeypatch):
    """Offer the planner as an installed package does."""
    entry = metadata.EntryPoint("straight", "my_planner:StraightLine", registry.GROUP)
    found = metadata.entry_points

    def entry_points(**selection):
        if selection == {"group": registry.GROUP}:
            return metadata.EntryPoints([entry])
        return found(**selection)

    monkeypatch.setattr(metadata, "entry_points", entry_points)


def bench(out, *options, episodes=2):
    arguments = ["run", "--out", str(out), "--difficulty", "none", "--seed", "0", "--jobs", "1"]
    drawing = ["--no-figure", "--no-video", "--episodes", str(episodes)]
    return CliRunner().invoke(app, [*arguments, *drawing, *options])


def test_it_runs_and_a_changed_file_is_not_mixed_with_its_rows(module, tmp_path):
    out = tmp_path / "results"
    first = bench(out, "--methods", SPEC)
    assert first.exit_code == 0, first.output
    manifest, rows = read_results(out)
    assert manifest.methods == ("straight",)
    assert manifest.specs == {"straight": SPEC}
    assert [row.method for row in rows] == ["straight"] * 2
    assert all(row.success for row in rows), rows
    assert all(row.share_collision_free == 1.0 for row in rows)
    again = bench(out, "--methods", SPEC, episodes=3)
    assert again.exit_code == 0, again.output
    # Their times tell them from rows that were played again.
    assert read_results(out)[1][:2] == rows
    module.write_text(module.read_text().replace("samples: int = 100", "samples: int = 50"))
    refused = bench(out, "--methods", SPEC, episodes=4)
    assert refused.exit_code == 2
    assert "method_code of straight" in refused.output.replace("\n", " ")
    assert len(read_results(out)[1]) == 3
    # Looking at results imports nothing of what they name.
    sys.modules.pop("my_planner", None)
    module.unlink()
    shown = CliRunner().invoke(app, ["show", str(out)])
    assert shown.exit_code == 0
    assert "straight" in shown.output


def test_an_installed_method_is_listed_and_runs_by_its_name(installed, tmp_path):
    assert "straight" in CliRunner().invoke(app, ["list"]).output
    assert "my_planner" not in sys.modules
    made = make_manifest([NONE], ["straight"], 3, 1)
    assert made.specs == {"straight": "straight"}
    assert made.method_codes == {"straight": resolve("straight").digest}
    assert PlannerPolicy.make("straight", "Placement").planner.samples == 100


def test_a_digest_is_of_the_file_or_the_whole_package(module, tmp_path, monkeypatch):
    alone = resolve(SPEC).digest
    assert resolve(SPEC).digest == alone
    (module.parent / "other.py").write_text("a = 1")
    assert resolve(SPEC).digest == alone
    package = module.parent / "my_package"
    package.mkdir()
    shutil.copy(module, package / "__init__.py")
    within = resolve("straight=my_package:StraightLine").digest
    (package / "help.py").write_text("a = 1")
    assert resolve("straight=my_package:StraightLine").digest != within
    sys.modules.pop("my_package")


def test_settings_reach_the_class():
    method = registry.Method("mine", "mine", importlib.import_module("straight_line").StraightLine)
    demonstrations = Demonstrations.load("Placement")
    assert method.make(demonstrations, {"samples": 7}).samples == 7
    with pytest.raises(ValueError, match=r"'mine'.*\['colour'\].*colour"):
        method.make(demonstrations, {"colour": 1})


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("a=b=my_planner:StraightLine", "letters, digits.*got 'a=b'"),
        ("a,b=my_planner:StraightLine", "letters, digits.*got 'a,b'"),
        ("../a=my_planner:StraightLine", "letters, digits"),
        ("=my_planner:StraightLine", "got ''"),
        ("smp=my_planner:StraightLine", "name 'smp' of a method is taken"),
        ("a=my_planner", "given as module:Class, got 'my_planner'"),
        ("a=nowhere:StraightLine", "no module 'nowhere' to import"),
        ("a=my_planner:Curve", "module 'my_planner' has no 'Curve'"),
        ("a=my_planner:Sequence", "must be a planner, which has plan"),
        ("a=my_planner:np", "must be a class"),
        ("teleport", "unknown method 'teleport'; there are: smp, promp.*or name=module:Class"),
    ],
)
def test_what_names_no_method_is_refused(module, spec, message):
    with pytest.raises(ValueError, match=message):
        resolve(spec)


def test_a_taken_name_of_an_installed_method_and_a_double_one_are_refused(installed, tmp_path):
    with pytest.raises(ValueError, match="name 'straight' of a method is taken"):
        resolve(SPEC)
    twice = ["a=my_planner:StraightLine"] * 2
    with pytest.raises(ValueError, match="each method once"):
        make_manifest([NONE], twice, 0, 1)


def test_a_factory_that_makes_no_planner_is_refused(module):
    module.write_text("def make(demonstrations):\n    return 3\n")
    with pytest.raises(ValueError, match=r"'a' must make a planner.*got int"):
        PlannerPolicy.make("a=my_planner:make", "Placement")


def test_a_broken_method_is_an_error_of_the_run(module, tmp_path):
    module.write_text(module.read_text().replace("problem.goals[0]", "problem.aims[0]"))
    manifest = make_manifest([NONE], [SPEC], 0, 1)
    with pytest.raises(RuntimeError, match="no attribute 'aims'"):
        run(manifest, tmp_path / "results")


def test_a_file_of_a_policy_never_runs_what_it_names(module, tmp_path):
    path = tmp_path / "policy.zip"
    PlannerPolicy.make(SPEC, "Placement", settings={"samples": 9}, seed=3).save(path)
    StraightLine = sys.modules.pop("my_planner").StraightLine
    with pytest.raises(ValueError, match=r"policy\.zip.*StraightLine.*factory=Class"):
        PlannerPolicy.load(path)
    assert "my_planner" not in sys.modules
    loaded = PlannerPolicy.load(path, factory=StraightLine)
    assert (loaded.planner.samples, loaded.seed) == (9, 3)
    loaded.save(tmp_path / "again.zip")
    with pytest.raises(ValueError, match="given its planner cannot be saved"):
        PlannerPolicy(loaded.planner, loaded.demonstrations).save(path)
    np.testing.assert_array_equal(
        loaded.demonstrations.configurations, Demonstrations.load("Placement").configurations
    )


def test_the_header_names_the_method(tmp_path):
    import zipfile

    path = tmp_path / "policy.zip"
    PlannerPolicy.make("smp", "DrawS").save(path)
    with zipfile.ZipFile(path) as archive:
        header = json.loads(archive.read("policy.json"))
    assert header["method"] == "smp"
    # All settings, so that the file means the same when defaults have changed.
    assert header["settings"]["smooth_std"] == 0.4
    assert header["settings"]["particles"] == 42
