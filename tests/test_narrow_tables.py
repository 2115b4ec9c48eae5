"""The tables of narrow places are counted from rows that are shipped, which today's code gives."""

import json
import runpy
from collections import defaultdict

import numpy as np
import pytest
import typer
from printed_tables import ROOT, lines_of, page, shipped
from typer.testing import CliRunner

from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeKey, PlayMethods
from smp_planner.benchmark.statistics import rate_interval
from smp_planner.experiments.narrow_places import FAMILIES, METHODS, narrow_markdown
from smp_planner.experiments.public_arms import PUBLIC_ARMS

PAGE = "docs/results.md"
HEADING = "## Narrow places"
ARMS = ("ur5", "panda")
CAGES = Cell("Placement", "hard", "cage")


@pytest.fixture(scope="module")
def rows():
    return shipped("narrow_places.csv.gz")


@pytest.fixture(scope="module")
def problems(rows):
    """What each method has solved, by problem; without a method where it is not posed."""
    found = {}
    for row in rows:
        solved = found.setdefault((row["arm"], row["family"], row["seed"]), {})
        if row["posed"] == "1":
            solved[row["method"]] = int(row["solved"])
    return found


@pytest.fixture(scope="module")
def text():
    return " ".join(page(PAGE).split(HEADING, 1)[1].split("## The paper's", 1)[0].split())


def test_problems_are_those_of_all_families_and_seeds(problems):
    every = {(arm, f, str(seed)) for arm in ARMS for f in FAMILIES for seed in range(10)}
    assert set(problems) == every
    assert all(solved.keys() in ({*METHODS}, set()) for solved in problems.values())


def test_cells_are_counted(problems):
    (methods, *_), *lines = [line for line in lines_of(PAGE, HEADING) if "---" not in line]
    assert tuple(methods.split(" · ")) == METHODS
    assert len(lines) == len(FAMILIES) + 1
    for (title, *cells), family in zip(lines, (*FAMILIES, None), strict=True):
        assert (title == "all") == (family is None)
        for arm, cell in zip(ARMS, cells, strict=True):
            posed = [
                solved
                for (of, its_family, _), solved in problems.items()
                if of == arm and family in (its_family, None) and solved
            ]
            counts = [str(sum(solved[method] for solved in posed)) for method in METHODS]
            assert cell == f"{' · '.join(counts)} of {len(posed)}", (arm, family)


def test_the_script_writes_the_table_as_it_is_printed(problems):
    # Problems stand in the order in which they are solved.
    results = {
        " ".join(problem): {"posed": bool(solved), **solved} for problem, solved in problems.items()
    }
    written = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in narrow_markdown(results).splitlines()
        if "---" not in line
    ]
    assert written == [line for line in lines_of(PAGE, HEADING) if "---" not in line]


def test_what_is_said_of_all_problems_is_counted(problems, rows, text):
    posed = [solved for solved in problems.values() if solved]
    searched = [solved["smp"] for solved in posed if solved["rrt_connect"]]
    rate = rate_interval(sum(searched), len(searched))
    assert (
        f"`smp` solves {sum(searched)} of the {len(searched)} that the search solves "
        f"({100 * rate['low']:.0f}–{100 * rate['high']:.0f} %), and one more"
    ) in text
    pairs = {
        method: [(solved["smp"], solved[method]) for solved in posed]
        for method in ("rrt_connect", "cpromp")
    }
    assert pairs["rrt_connect"].count((1, 0)) == 1
    alone = f"{pairs['cpromp'].count((1, 0))} : {pairs['cpromp'].count((0, 1))}"
    assert f"nothing to tell ({alone})" in text
    smp, cpromp, search = (
        np.median([float(row["seconds"]) for row in rows if row["method"] == method])
        for method in ("smp", "cpromp", "rrt_connect")
    )
    assert (
        f"takes {smp:.1f} s of processor time in the median, of `cpromp` {cpromp:.1f} s, "
        f"a search {search:.2f} s"
    ) in text


@pytest.mark.parametrize(("arm", "family"), [("panda", "bookshelf_thin"), ("ur5", "cage")])
def test_a_problem_is_solved_again_by_the_same_methods(arm, family, problems, tmp_path):
    try:
        PUBLIC_ARMS[arm].path()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    app = typer.Typer()
    app.command()(runpy.run_path(str(ROOT / "scripts" / "narrow_places.py"))["main"])
    out = tmp_path / "results.json"
    # On the shelf all particles of smp are good and none of promp, which no rounding turns.
    methods = ("rrt_connect", "smp", "promp")
    options = ["--arms", arm, "--families", family, "--methods", ",".join(methods)]
    done = CliRunner().invoke(app, [*options, "--problems", "1", "--out", str(out)])
    assert done.exit_code == 0, done.output
    (again,) = json.loads(out.read_text())["results"].values()
    solved = problems[arm, family, "0"]
    assert again["posed"] == bool(solved)
    counts = [int(solved[method]) if solved else 0 for method in methods]
    if solved:
        assert [again[method] for method in methods] == counts
        *_, of_all = out.with_suffix(".md").read_text().splitlines()
        assert of_all == f"| all | {' · '.join(map(str, counts))} of 1 |"


def test_the_file_of_results_is_not_that_of_the_table(tmp_path):
    app = typer.Typer()
    app.command()(runpy.run_path(str(ROOT / "scripts" / "narrow_places.py"))["main"])
    out = tmp_path / "results.md"
    done = CliRunner().invoke(app, ["--out", str(out)], env={"COLUMNS": "120"})
    assert done.exit_code == 2
    assert "must not end in .md" in done.output
    assert not out.exists()


def test_cages_of_placement_are_counted(text):
    played = defaultdict(dict)
    for row in shipped("cages.csv.gz"):
        assert row["difficulty"] == "hard"
        played[int(row["seed"])][row["method"]] = row
    assert min(played) == 88_000
    methods = {method for found in played.values() for method in found}
    equal = [found for found in played.values() if set(found) == methods]
    won = {m: sum(int(found[m]["success"]) for found in equal) for m in methods}
    assert set(won) == {"smp", "rrt_connect", "promp_diff", "cpromp", "prompt_o"}
    assert won["cpromp"] == won["prompt_o"] == 0
    assert (
        f"On the {len(equal)} scenes that all have played `smp` succeeds in {won['smp']}, "
        f"`rrt_connect` in {won['rrt_connect']}, `promp_diff` in {won['promp_diff']}, "
        "`cpromp` and `prompt_o` in none"
    ) in text
    of_smp = [found["smp"] for found in played.values()]
    successes = sum(int(row["success"]) for row in of_smp)
    rate = rate_interval(successes, len(of_smp))
    interval = f"{100 * rate['low']:.0f}–{100 * rate['high']:.0f} %"
    assert f"on {len(of_smp)} scenes `smp` succeeds in {successes} ({interval})" in text
    failures = [float(row["share_good"]) for row in of_smp if row["success"] == "0"]
    assert len(failures) == 4
    assert failures.count(0.0) == 3
    assert "In three of the four others it has no good particle" in text


def test_an_episode_in_a_cage_ends_again_as_it_did():
    row = next(row for row in shipped("cages.csv.gz") if row["method"] == "smp")
    again = PlayMethods()(EpisodeKey.of(CAGES, "smp", int(row["seed"])))
    # All particles are good in this scene, which no rounding turns.
    assert (str(int(again.success)), again.cause) == (row["success"], row["cause"])
    assert again.share_good == pytest.approx(float(row["share_good"]), abs=0.1)
