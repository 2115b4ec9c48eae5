"""Trainings of one agent, taken together: real rows under the names of three trainings."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from real_rows import METHODS, TASKS, real_rows, write_folder

from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.joined_results import join_results
from smp_planner.benchmark.report.findings import Findings, find
from smp_planner.benchmark.report.markdown import markdown
from smp_planner.benchmark.report.page import page

NAMES = {"cpromp": "sac-seed0", "rrt_connect": "sac-seed1", "smp": "sac-seed2"}


@pytest.fixture(scope="module")
def findings(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    folder = tmp_path_factory.mktemp("results") / "trainings"
    write_folder(
        folder,
        methods=tuple(NAMES.values()),
        change=lambda row: replace(row, method=NAMES[row.method]),
    )
    return find(join_results([folder]))


def _rate(method: str, task: str | None = None) -> float:
    rows = [r for r in real_rows() if r.method == method and task in (None, r.task)]
    return float(np.mean([row.success for row in rows]))


def test_rates_are_those_of_the_rows_and_the_middle_is_trimmed(findings: Findings) -> None:
    (found,) = findings.trainings
    assert (found.agent, set(found.methods)) == ("sac", set(NAMES.values()))
    rates = {NAMES[method]: _rate(method) for method in METHODS}
    assert dict(zip(found.methods, found.rates, strict=True)) == pytest.approx(rates)
    assert found.range == pytest.approx((min(rates.values()), max(rates.values())))
    of_cells = sorted(_rate(method, task) for method in METHODS for task in TASKS)
    assert found.typical["value"] == pytest.approx(np.mean(of_cells[3:-3]))
    assert found.typical["count"] == 12
    assert found.typical["low"] < found.typical["value"] < found.typical["high"]


def test_page_and_tables_tell_of_them(findings: Findings) -> None:
    text = re.sub(r"\s+", " ", page(findings))
    worst, best = (f"{100 * rate:.1f}" for rate in findings.trainings[0].range)
    row = f'<th scope="row">sac</th><td class="n">3</td> <td class="n">{worst}</td>'
    assert f'{row} <td class="n">{best}</td>' in text
    assert '<a href="#trainings">' in text
    assert f"| sac | 3 | {worst} | {best} |" in markdown(findings)


def _as_seed_7(row: EpisodeRow) -> EpisodeRow:
    return replace(row, method="x-seed7") if row.method == "smp" else row


def test_one_training_alone_is_an_agent_like_any(hard: Path, tmp_path: Path) -> None:
    assert find(join_results([hard])).trainings == ()
    assert "#trainings" not in page(find(join_results([hard])))
    write_folder(tmp_path / "one", methods=["x-seed7"], change=_as_seed_7)
    assert find(join_results([tmp_path / "one"])).trainings == ()
