"""Rows from a Ray cluster are those of processes, also where workers and nodes are lost."""

import os
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fake_episodes import fails_at_seed_two, fake_play, manifest, slow_play, without_times
from typer.testing import CliRunner

from smp_planner.benchmark import ray_pool, runner
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow
from smp_planner.benchmark.manifest import read_results
from smp_planner.benchmark.results_folder import ResultsError

NODE: dict[str, Any] = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
VARIABLES = {
    "PYTHONPATH": os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parents[3]))),
    "RAY_USAGE_STATS_ENABLED": "0",
    # Otherwise workers stand back behind all else that the machine does.
    "RAY_worker_niceness": "0",
}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    """A cluster of two nodes on this machine, of one core each, and a folder that both see."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    marks = tmp_path_factory.mktemp("marks")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**VARIABLES, "MARKS": str(marks)}.items():
            patch.setenv(name, value)
        nodes = Cluster(initialize_head=True, head_node_args={**NODE, "include_dashboard": False})
        second = nodes.add_node(**NODE)
        patch.setenv("RAY_ADDRESS", nodes.address)
        yield SimpleNamespace(nodes=nodes, second=second, marks=marks)
        nodes.shutdown()


def is_killed_once(key: EpisodeKey) -> EpisodeRow:
    """Kill the worker when it first comes to seed 2 of a method."""
    folder = Path(os.environ["MARKS"])
    (folder / f"{key.method}_{key.seed}_{os.getpid()}").touch()
    if key.seed == 2 and len(list(folder.glob(f"{key.method}_2_*"))) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return fake_play(key)


def test_an_episode_whose_worker_is_killed_is_played_by_another(
    cluster: SimpleNamespace, tmp_path: Path
) -> None:
    rows = runner.run(manifest(), tmp_path, jobs=2, backend="ray", player=is_killed_once)
    assert len(list(cluster.marks.glob("smp_2_*"))) == 2
    assert without_times(rows) == without_times([fake_play(k) for k in manifest().episode_keys()])
    assert without_times(read_results(tmp_path)[1]) == without_times(rows)


def test_an_exception_names_the_episode_and_keeps_the_rest(
    cluster: SimpleNamespace, tmp_path: Path
) -> None:
    with pytest.raises(runner.EpisodeFailedError, match=r"seed=2.*a goal out of reach") as told:
        runner.run(manifest(), tmp_path, jobs=2, backend="ray", player=fails_at_seed_two)
    assert "\n" not in str(told.value)
    assert {row.seed for row in read_results(tmp_path)[1]} >= {0, 1}


def test_a_node_that_is_lost_loses_no_row(cluster: SimpleNamespace, tmp_path: Path) -> None:
    def lose(done: int, total: int) -> None:
        if done == 4:
            cluster.nodes.remove_node(cluster.second)

    made = manifest(8)
    rows = runner.run(made, tmp_path, jobs=2, backend="ray", player=slow_play, on_progress=lose)
    assert len(cluster.nodes.worker_nodes) == 0
    assert without_times(rows) == without_times([fake_play(k) for k in made.episode_keys()])


def test_a_node_of_other_code_plays_nothing() -> None:
    code, packages = ray_pool._code_here()
    assert ray_pool._checked_call((code, packages), len, ("abc",), {}) == 3
    with pytest.raises(ResultsError, match=rf"other code or packages.*code {code}, not 0000"):
        ray_pool._checked_call(("0000", packages), len, ("abc",), {})
    with pytest.raises(ResultsError, match=rf"{{'torch': '{re.escape(packages['torch'])}'}}"):
        ray_pool._checked_call((code, {**packages, "torch": "1.0"}), len, ("abc",), {})


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["run", *arguments], env={"COLUMNS": "500"})
    assert result.exit_code == 2
    return result.output


def test_without_ray_the_backend_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    out = str(tmp_path / "out")
    assert 'pip install "smp-gym[ray]"' in run("--backend", "ray", "--out", out)
    assert not (tmp_path / "out").exists()
    assert "must be of processes, ray; got 'slurm'" in run("--backend", "slurm", "--out", out)
