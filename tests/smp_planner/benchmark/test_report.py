"""The report: its sentences, and its page parsed and held against the rows as the file has them."""

import csv
import gzip
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from real_rows import METHODS, TASKS, write_folder
from scipy import stats
from typer.main import get_command
from typer.testing import CliRunner

from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.joined_results import join_results
from smp_planner.benchmark.methods import AGENTS
from smp_planner.benchmark.report.answer import answer, least_certain, title
from smp_planner.benchmark.report.charts import interval_bar, time_chart
from smp_planner.benchmark.report.findings import Findings, find, replay_command
from smp_planner.benchmark.report.markdown import markdown
from smp_planner.benchmark.report.page import Media, Picture, page
from smp_planner.benchmark.report.training_costs import TrainingCost, training_costs
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.statistics import rate_interval
from smp_planner.planners import PLANNERS

HERE = Path(__file__).parent
VOID = {"meta", "link", "br", "img", "source"}


def _file() -> list[dict[str, str]]:
    with gzip.open(HERE / "hard_rows.csv.gz", "rt", newline="") as file:
        return list(csv.DictReader(file))


ROWS = _file()


@dataclass
class Table:
    """A table of a page: its caption and the texts of its cells."""

    caption: str = ""
    rows: list[list[str]] = field(default_factory=list)


class Page(HTMLParser):
    """Reads a page: whether its elements are closed, its tables, its links, what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tables: list[Table] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.found: Counter[str] = Counter()
        self.attributes: list[tuple[str, dict[str, str | None]]] = []
        self.text = self.style = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.found[tag] += 1
        self.attributes.append((tag, given))
        self.ids += [given["id"] or ""] if "id" in given else []
        self.links += [given["href"] or ""] if "href" in given else []
        self.loaded += [given["src"] or ""] if "src" in given else []
        if tag == "table":
            self.tables.append(Table())
        elif tag == "tr":
            self.tables[-1].rows.append([])
        elif tag in ("td", "th"):
            self.tables[-1].rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" in self.open:
            self.style += data
            return
        self.text += data
        if "caption" in self.open:
            self.tables[-1].caption += data
        elif "td" in self.open or "th" in self.open:
            self.tables[-1].rows[-1][-1] += data

    def table(self, caption: str) -> dict[str, list[str]]:
        """Return the rows of a table by the text of their first cells."""
        (found,) = [t for t in self.tables if re.sub(r"\s+", " ", t.caption).startswith(caption)]
        rows = [[re.sub(r"\s+", " ", cell).strip() for cell in row] for row in found.rows]
        return {row[0]: row[1:] for row in rows[1:]}


@pytest.fixture(scope="module")
def findings(hard: Path) -> Findings:
    return find(join_results([hard]))


@pytest.fixture(scope="module")
def shown(findings: Findings) -> Page:
    return Page(page(findings))


def _of(method: str, task: str = "") -> list[dict[str, str]]:
    return [row for row in ROWS if row["method"] == method and task in ("", row["task"])]


def _solved(rows: Sequence[dict[str, str]]) -> int:
    return sum(row["success"] == "True" for row in rows)


def test_the_page_is_whole_and_needs_nothing_else(shown: Page) -> None:
    assert shown.open == []
    assert shown.found["script"] == shown.found["link"] == 0
    assert shown.loaded == []
    assert {link.removeprefix("#") for link in shown.links} <= set(shown.ids)
    assert len(set(shown.ids)) == len(shown.ids)
    assert all("://" not in (v or "") for _, given in shown.attributes for v in given.values())
    assert shown.found["html"] == shown.found["h1"] == shown.found["main"] == 1


def test_the_page_can_be_read_aloud(shown: Page) -> None:
    for tag, given in shown.attributes:
        if tag == "svg":
            assert given.get("role") == "img" or given.get("aria-hidden") == "true"
        if tag == "th":
            assert "scope" in given
        if tag == "img":
            assert given["alt"]
    charts = [given for tag, given in shown.attributes if given.get("class") == "chart"]
    assert len(charts) == shown.found["desc"] == shown.found["title"] - 1 == 2
    assert all(table.caption for table in shown.tables)


def _typical(rows: Sequence[dict[str, str]]) -> float:
    """Return the mean of the middle half of the times to completion, failures the slowest."""
    done = sorted(
        float(r["planning_time"]) + int(r["steps"]) / 20 if r["success"] == "True" else np.inf
        for r in rows
    )
    return float(np.mean(done[len(done) // 4 : -(len(done) // 4)]))


def test_the_table_of_methods_says_what_the_rows_say(shown: Page) -> None:
    table = shown.table("All methods n = 48")
    assert list(table) == ["smp", "rrt_connect", "cpromp"]
    for method, cells in table.items():
        rows = _of(method)
        interval = stats.binomtest(_solved(rows), 48).proportion_ci(method="wilson")
        assert cells == [
            f"{_solved(rows)} of 48",
            "",
            f"{100 * _solved(rows) / 48:.1f}",
            f"{100 * interval.low:.1f}–{100 * interval.high:.1f}",
            str(sum(row["collision"] == "True" for row in rows)),
            f"{100 * np.mean([float(row['share_good']) for row in rows]):.1f}",
            cells[-1],
        ]


def test_the_table_of_times_says_what_the_rows_say(shown: Page) -> None:
    for method, cells in shown.table("Times in seconds n = 48").items():
        rows = _of(method)
        times = np.percentile([float(row["planning_time"]) for row in rows], [50, 75, 98])
        motion = np.mean([int(row["steps"]) / 20 for row in rows if row["success"] == "True"])
        assert cells == [
            *(f"{seconds:.2f}" for seconds in times),
            f"{motion:.1f}",
            f"{_typical(rows):.1f}",
            cells[-1],
        ]
        low, high = (float(end.replace("never", "inf")) for end in cells[-1].split(" to "))
        assert low <= _typical(rows) <= high


def test_every_cell_has_its_table(shown: Page) -> None:
    for task in TASKS:
        table = shown.table(f"{task}, hard n = 12")
        assert {name: int(cells[0]) for name, cells in table.items()} == {
            method: _solved(_of(method, task)) for method in METHODS
        }


def test_pairs_are_counted(shown: Page) -> None:
    found = next(t for t in shown.tables if t.caption.startswith("Pairs"))
    cells = [[re.sub(r"\s+", " ", cell).strip() for cell in row] for row in found.rows[1:]]
    assert [row[:2] for row in cells] == [
        ["smp", "rrt_connect"],
        ["smp", "cpromp"],
        ["rrt_connect", "cpromp"],
    ]
    for first, second, _, alone, *_ in cells:
        solved = {
            method: {(r["task"], r["seed"]) for r in _of(method) if r["success"] == "True"}
            for method in (first, second)
        }
        only = [len(solved[a] - solved[b]) for a, b in ((first, second), (second, first))]
        assert alone == f"{only[0]} : {only[1]}"
    assert [row[2] for row in cells] == ["better", "better", "cannot tell"]


def test_every_failure_has_its_cause_and_its_command(shown: Page) -> None:
    failed = [row for row in ROWS if row["success"] == "False"]
    for row in failed:
        command = (
            f"smp-bench draw --task {row['task']} --difficulty hard --method {row['method']} "
            f"--seed {row['seed']} --out replay"
        )
        assert shown.text.count(command) == 1
    assert shown.text.count("smp-bench draw") == len(failed) == 21
    causes = shown.table("Causes")
    for method in METHODS:
        counts = Counter(row["cause"] for row in _of(method) if row["success"] == "False")
        assert causes[method][:3] == [
            str(counts["collision"]),
            str(counts["timeout"]),
            str(sum(counts.values())),
        ]


def test_the_answer_is_three_sentences_of_the_numbers(findings: Findings, shown: Page) -> None:
    first, second, third = answer(findings)
    assert first == (
        "On the 48 episodes that all three methods played (Placement, DoubleSidedPlacement, DrawS "
        "and PushLiftBox; hard), smp succeeds most often: in 47 of 48 (97.9 %; 95 % interval "
        "89.1–99.6)."
    )
    assert second == (
        "Compared episode by episode, smp is better than rrt_connect by 14.6 points (3.5 to 27.4) "
        "and cpromp by 22.9 points (10.1 to 36.7), most of it on PushLiftBox."
    )
    assert third == (
        "Which is better cannot be told of rrt_connect and cpromp (8.3 points apart, −5.2 to "
        "21.8): a difference of fewer than 7 of 48 episodes is never beyond chance."
    )
    for sentence in (first, second, third):
        assert sentence.replace(" %", "\N{NARROW NO-BREAK SPACE}%") in shown.text
    assert title(findings) == "Three methods on four tasks"


def test_the_least_difference_is_where_the_exact_test_first_rejects() -> None:
    for comparisons in (1, 3, 10):
        least = least_certain(comparisons)
        assert comparisons * stats.binomtest(least, least).pvalue < 0.05
        assert comparisons * stats.binomtest(least - 1, least - 1).pvalue >= 0.05


def _found(folder: Path, change: dict[str, bool], methods: tuple[str, ...]) -> Findings:
    """Return the findings of real rows whose success is set by method."""

    def changed(row: EpisodeRow) -> EpisodeRow:
        return replace(row, success=change[row.method]) if row.method in change else row

    write_folder(folder, TASKS[:2], methods, 4, change=changed)
    return find(join_results([folder]), methods)


@pytest.mark.parametrize(
    ("change", "methods", "said"),
    [
        ({"smp": True, "cpromp": True}, ("smp", "cpromp"), ["all succeed equally often"]),
        (
            {"smp": True, "cpromp": True, "rrt_connect": False},
            METHODS,
            ["smp and cpromp succeed most often: each in 8 of 8", "rrt_connect by 100.0 points"],
        ),
        ({"smp": False, "cpromp": False}, ("smp", "cpromp"), ["in 0 of 8", "beyond chance"]),
        ({"smp": True}, ("smp",), ["smp succeeds in 8 of 8", "no other method"]),
    ],
)
def test_the_answer_knows_ties_and_solitude(
    tmp_path: Path, change: dict[str, bool], methods: tuple[str, ...], said: list[str]
) -> None:
    found = _found(tmp_path, change, methods)
    sentences = " ".join(answer(found))
    for words in said:
        assert words in sentences
    assert Page(page(found)).open == []
    assert markdown(found).startswith(sentences)


@pytest.mark.parametrize(("quicker", "said"), [("smp", True), ("cpromp", True), ("", False)])
def test_the_answer_says_who_is_done_soonest_where_success_is_equal(
    tmp_path: Path, quicker: str, said: bool
) -> None:
    """Among those that may be the best, and only where it is beyond chance."""

    def changed(row: EpisodeRow) -> EpisodeRow:
        if row.method == "rrt_connect":
            return replace(row, success=False, steps=10)
        odd = bool(row.seed % 2) if quicker == "" else False
        steps = 60 if (row.method == quicker) != odd else 100
        return replace(row, success=True, planning_time=0.5, steps=steps)

    write_folder(tmp_path, TASKS[:2], METHODS, 8, change=changed)
    sentences = answer(find(join_results([tmp_path]), METHODS))
    if said:
        (other,) = {"smp", "cpromp"} - {quicker}
        assert sentences[3] == (
            f"Of those that may be the best {quicker} is done soonest: typically 3.5 s after it "
            f"began to plan, {other} after 5.5 s."
        )
    else:
        assert len(sentences) == 3


def test_every_method_of_the_package_is_described(tmp_path: Path) -> None:
    names = [*PLANNERS, *AGENTS]
    for name in names:

        def renamed(row: EpisodeRow, name: str = name) -> EpisodeRow:
            return replace(row, method=name if row.method == "smp" else "other")

        write_folder(tmp_path / name, TASKS[:1], (name,), 1, change=renamed)
    found = find(join_results([tmp_path / name for name in names]))
    described = re.findall(r"<dt>.*?</dt><dd>(.+?)</dd>", page(found))
    assert len(set(described)) >= len(names)


def test_methods_that_share_no_episode_are_not_compared(tmp_path: Path) -> None:
    write_folder(tmp_path / "a", TASKS[:1], ("smp",), 3)
    write_folder(tmp_path / "b", TASKS[1:2], ("cpromp",), 3)
    found = find(join_results([tmp_path / "a", tmp_path / "b"]))
    first, second, _ = answer(found)
    assert "No episode was played by all of smp and cpromp" in first
    assert second == "No difference between them is certain."
    shown = Page(page(found))
    assert "which differ" in shown.text
    assert "Pairs of methods" not in shown.text


def test_what_users_name_is_text_in_a_page(tmp_path: Path) -> None:
    write_folder(
        tmp_path / "<b>&", TASKS[:1], ("smp",), 2,
        change=lambda row: replace(row, success=False, cause="<script>", contact="a<b – c_1"),
    )  # fmt: skip
    shown = Page(page(find(join_results([tmp_path / "<b>&"]))))
    assert shown.found["script"] == 0
    assert "a<b – c 1" in shown.text
    assert "the results in <b>&" in shown.text


def test_commands_say_what_an_episode_was(tmp_path: Path) -> None:
    write_folder(
        tmp_path, TASKS[:1], ("smp",), 1,
        change=lambda row: replace(row, success=False, replan_every=10, latency=2),
        specs={"smp": "smp=my module:Planner"}, replan_every=10, latency=2,
    )  # fmt: skip
    (failure,) = find(join_results([tmp_path])).failures["smp"]
    assert failure.command == (
        "smp-bench draw --task Placement --difficulty hard --method 'smp=my module:Planner' "
        "--seed 79400 --replan-every 10 --latency 2 --out replay"
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"family": "shelf", "sensing": "noise", "noise": 0.02},
        {"half": "placed", "sensing": "depth"},
        {"replan_every": 10, "latency": 3},
    ],
)
def test_draw_understands_the_commands(
    findings: Findings, tmp_path: Path, changes: dict[str, Any]
) -> None:
    (source,) = findings.sources
    lists = replace(source, manifest=replace(source.manifest, lists=str(tmp_path / "my lists")))
    row = replace(findings.failures["smp"][0].row, **changes)
    words = shlex.split(replay_command(row, lists))
    draw = get_command(app).commands[words[1]]  # type: ignore[attr-defined]
    given = draw.make_context(words[1], words[2:]).params
    assert {name: given[name] for name in changes} == changes
    for name in ("task", "difficulty", "method", "seed"):
        assert given[name] == getattr(row, name)
    assert given["lists"] == (tmp_path / "my lists" if row.half else None)


def test_draw_names_an_episode_that_no_list_holds(tmp_path: Path) -> None:
    options = ["--half", "placed", "--seed", "7", "--lists", str(tmp_path), "--out", str(tmp_path)]
    result = CliRunner().invoke(app, ["draw", *options])
    assert result.exit_code == 2
    assert "no frozen list of Placement_medium" in result.output


def test_lists_are_not_named_in_vain(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["draw", "--lists", str(tmp_path), "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "--lists needs --half, got it without" in result.output


def test_a_bar_stands_where_the_rate_is() -> None:
    svg = str(interval_bar(rate_interval(3, 4), 0))
    (x,) = re.findall(r'<circle cx="([\d.]+)"', svg)
    ends = [float(v) for v in re.findall(r'class="grid" x1="([\d.]+)"', svg)]
    assert float(x) == pytest.approx(ends[0] + 0.75 * (ends[-1] - ends[0]), abs=0.06)


def test_charts_stay_in_their_frame(findings: Findings) -> None:
    """Also where a method needs no time, and another a day."""
    smp, rrt, _ = findings.methods
    quick = replace(smp, solve=replace(smp.solve, median=0.0))
    slow = replace(rrt, solve=replace(rrt.solve, p98=86400.0))
    for methods in ([smp], [quick, slow], list(findings.methods)):
        svg = str(time_chart(methods))
        across = [float(v) for v in re.findall(r'\b(?:x|x1|x2|cx)="(-?[\d.]+)"', svg)]
        assert 0.0 <= min(across) <= max(across) <= 340.0


def test_pictures_and_videos_stand_in_the_page(findings: Findings) -> None:
    picture = Picture("smp", "data:image/webp;base64,AA", 4, 3, "a caption", "a description")
    media = Media((("Placement, hard, seed 1", (picture,)),), (picture,), 1, True)
    shown = Page(page(findings, media))
    assert shown.open == []
    assert shown.loaded == [picture.source] * 2
    assert {"pictures", "videos"} <= set(shown.ids)
    assert shown.text.count("another version of the code") == 2


def _luminance(colour: str) -> float:
    """Return the relative luminance of a colour #rrggbb, by WCAG 2."""
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_words_and_marks_stand_out_in_light_and_dark(shown: Page) -> None:
    light, dark = (
        dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", part))
        for part in shown.style.split("@media (prefers-color-scheme: dark)")[:2]
    )
    assert light.keys() == dark.keys()
    assert _luminance(light["paper"]) > 0.5 > 0.05 > _luminance(dark["paper"])
    for colours in (light, dark):
        paper = _luminance(colours["paper"])
        for name in ("ink", "soft", "link", "good", "bad", "open", *(f"m{k}" for k in range(10))):
            low, high = sorted((paper, _luminance(colours[name])))
            assert (high + 0.05) / (low + 0.05) >= 4.5, name


def test_what_training_has_cost_is_read_from_cards(findings: Findings, tmp_path: Path) -> None:
    (tmp_path / "smp_DrawS.json").write_text(
        '{"agent": "smp", "training": {"cpu_seconds": 90, "trajectories": 46000}}'
    )
    costs = training_costs(["smp@old", "cpromp"], TASKS, tmp_path)
    assert costs == [TrainingCost("smp@old", "DrawS", 90.0, 46000)]
    shown = Page(page(findings, training=[replace(costs[0], method="smp")]))
    assert shown.table("Training")["smp"] == ["DrawS", "1.5", "46 000"]
    for damaged in ("[]", "{}", '{"training": {"cpu_seconds": "1"}}'):
        (tmp_path / "smp_DrawS.json").write_text(damaged)
        with pytest.raises(ValueError, match=r"smp_DrawS\.json must"):
            training_costs(["smp"], TASKS, tmp_path)


def test_markdown_holds_the_same_numbers(findings: Findings) -> None:
    text = markdown(findings)
    plain = re.sub(r"^\| | \|$", "", text, flags=re.MULTILINE).replace(" | ", "|")
    tables = [
        {row[0]: row[1:] for row in csv.reader(part.splitlines(), delimiter="|")}
        for part in plain.split("\n\n")
        if "|" in part
    ]
    cells, methods, *_ = tables
    for task in TASKS:
        counts = [int(cell.split()[0]) for cell in cells[f"{task}, hard"][1:]]
        assert counts == [_solved(_of(m, task)) for m in ("smp", "rrt_connect", "cpromp")]
    assert methods["smp"][0] == "47 of 48"
    assert "code `d0de2010cfedd9c0`" in text


def test_report_writes_a_page_or_prints_tables(hard: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    result = CliRunner().invoke(app, ["report", str(hard), "--methods", "smp", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert Page(out.read_text()).open == []
    options = ["--methods", "smp", "--format", "markdown"]
    result = CliRunner().invoke(app, ["report", str(hard), *options])
    assert "| PushLiftBox, hard | 12 |" in result.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--format", "pdf"], "must be of html, markdown"),
        (["--format", "markdown", "--pictures", "1"], "are of the format html"),
        (["--pictures", "-1"], "--pictures"),
    ],
)
def test_report_names_what_it_cannot_do(hard: Path, options: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["report", str(hard), "--methods", "smp", *options])
    assert result.exit_code == 2
    assert message in result.output


def test_an_unknown_method_is_named(hard: Path) -> None:
    with pytest.raises(ResultsError, match="no rows of the method 'spm'; there are: smp, cpromp"):
        find(join_results([hard]), ["spm"])
