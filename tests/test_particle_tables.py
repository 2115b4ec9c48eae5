"""Tables of particle sets are the means of the rows that are shipped."""

import numpy as np
import pytest
from printed_tables import TASKS, lines_of, page, shipped

from smp_planner.benchmark.statistics import mean_interval
from smp_planner.experiments.set_summary import ratio_table, ratio_to_floor, set_table

MEASURES = {
    "good": 0.5,
    "success": 0.5,
    "wasserstein": 0.5,
    "coverage": 0.5,
    "entropy": 0.05,
    "demonstrations": 0.5,
}
"""Half of the last digit that is printed of each."""

ABLATION = ("good", "wasserstein", "entropy", "demonstrations")
FROZEN = ("good", "success", "wasserstein", "coverage", "entropy", "demonstrations")


def printed(first, last):
    """Return the cells of the table between two texts of the page, by method and task."""
    return {
        (method, task): [None if number == "–" else float(number) for number in value.split(" · ")]
        for method, *values in lines_of("docs/arm.md", first, last)
        if len(values) == len(TASKS) and "·" in values[0]
        for task, value in zip(TASKS, values, strict=True)
    }


def check(cells, rows, columns, scenes, references):
    """Compare cells with the means of rows, of which so many scenes of a task have a reference."""
    for (method, task), numbers in cells.items():
        own = [row for row in rows if (row["method"], row["task"]) == (method, task)]
        assert len(own) == (references[task] if method == "noise floor" else scenes)
        for number, column in zip(numbers, columns, strict=True):
            # Of a scene without a draw of the posterior there is no distance.
            values = [float(row[column]) for row in own if row[column]]
            if number is None:
                assert not values
                continue
            # Rows hold four digits.
            half = MEASURES[column] + 1e-3 * abs(number)
            assert np.mean(values) == pytest.approx(number, abs=half)


@pytest.mark.parametrize(
    ("run", "first", "last", "methods"),
    [
        ("ablation", "What each part is worth", "unselected_scenes.py", 9),
        ("svgd", "**SVGD by itself**", "unselected_scenes.py", 4),
    ],
)
def test_parts_of_the_method_are_worth_what_their_rows_say(run, first, last, methods):
    cells = printed(first, last)
    assert len(cells) == methods * len(TASKS)
    rows = [row for row in shipped("ablation.csv.gz") if row["run"] == run]
    check(cells, rows, ABLATION, scenes=50, references=dict.fromkeys(TASKS, 8))


@pytest.fixture(scope="module")
def sets():
    """Return the rows of the first 25 scenes of each frozen list, and of the 25 after them."""
    rows = shipped("frozen_sets.csv.gz")
    return [[row for row in rows if int(row["seed"]) // 25 == part] for part in (0, 1)]


def test_sets_on_frozen_scenes_are_those_of_their_rows(sets):
    cells = printed("## Sets of all methods", "unselected_scenes.py")
    assert len(cells) == 11 * len(TASKS)
    references = dict(zip(TASKS, (25, 25, 22, 21), strict=True))
    check(cells, sets[1], FROZEN, scenes=25, references=references)


def test_distances_to_the_posterior_are_those_of_the_rows(sets):
    lines = {
        method: values
        for method, *values in lines_of("docs/arm.md", "times that of the noise floor", "says of")
        if values and "(" in values[0]
    }
    table = {method: values for method, *values in ratio_table(sets[1])[1:]}
    assert len(table) == 10
    assert lines == table


def test_the_earlier_sets_say_the_same(sets):
    whole = " ".join(page("docs/arm.md").split())
    for method, shares in (("smp", "92, 97, 79 and 75"), ("cpromp", "44, 55, 55 and 62")):
        values = [
            [float(row["good"]) for row in sets[0] if (row["task"], row["method"]) == (t, method)]
            for t in TASKS
        ]
        assert "{:.0f}, {:.0f}, {:.0f} and {:.0f}".format(*map(np.mean, values)) == shares
        assert shares in whole
    for task in TASKS:
        ratio = ratio_to_floor(sets[0], task, "smp")
        assert "{value:.2f} ({low:.2f}–{high:.2f})".format(**ratio) in whole
    chosen = [float(row["chosen"]) for row in sets[0] if row["method"] == "smp"]
    assert f"successful in {sum(chosen) / 100:.0f} of 100 scenes" in whole


def test_sets_of_push_lift_box_after_the_second_search_are_those_of_their_rows():
    rows = shipped("frozen_sets_push_lift_box.csv.gz")
    assert {int(row["seed"]) for row in rows} == set(range(25, 50))
    ratios = dict(ratio_table(rows)[1:])
    lines = {
        method: cells
        for method, *cells in lines_of("docs/arm.md", "of after the second search", "### Sides")
        if "·" in cells[0]
    }
    expected = {method: [cell, ratios.get(method, "–")] for method, cell in set_table(rows)[1:]}
    assert lines == expected
    chosen = {
        method: sum(float(row["chosen"]) > 0.0 for row in rows if row["method"] == method)
        for method in ("smp", "cpromp", "rrt_connect")
    }
    assert chosen == {"smp": 25, "cpromp": 20, "rrt_connect": 14}


@pytest.fixture(scope="module")
def sides():
    """Return the rows of scenes with two goals, by method."""
    found = {}
    for row in shipped("sides.csv.gz"):
        found.setdefault(row["method"], []).append(row)
    return found


def test_shares_of_sides_are_those_of_the_rows(sides):
    lines = {
        method: cells
        for method, *cells in lines_of("docs/arm.md", "### Sides in their shares")
        if method in sides
    }
    assert list(lines) == list(sides)
    for method, cells in lines.items():
        assert len(sides[method]) == 20
        columns = (("goals", 2), ("variation", 2), ("wasserstein", 0))
        for cell, (name, digits) in zip(cells, columns, strict=True):
            estimate = mean_interval([float(row[name]) for row in sides[method] if row[name]])
            value, low, high = (f"{estimate[key]:.{digits}f}" for key in ("value", "low", "high"))
            assert cell == f"{value} ({low}–{high})", (method, name)


def test_what_is_said_of_sides_is_counted(sides):
    text = " ".join(page("docs/arm.md").split())
    off = {
        method: [float(row["goals"]) for row in rows if row["goals"]]
        for method, rows in sides.items()
    }
    near = {method: sum(each <= 0.1 for each in values) for method, values in off.items()}
    assert f"within 0.1 of the posterior's in {near['smp']}, at most {max(off['smp']):.2f}" in text
    floor = f"({near['noise floor']}, at most {max(off['noise floor']):.2f})"
    assert f"as many independent draws {floor}" in text
    far = sum(each > 0.5 for each in off["no repulsion"])
    assert (near["no repulsion"], far) == (14, 3)
    assert len(sides["cpromp"]) - len(off["cpromp"]) == 2
    pairs = [
        float(one["goals"]) - float(other["goals"])
        for one, other in zip(sides["no repulsion"], sides["smp"], strict=True)
    ]
    assert "{value:.2f} to `smp` ({low:.2f}–{high:.2f})".format(**mean_interval(pairs)) in text
