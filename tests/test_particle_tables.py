"""Tables of particle sets are the means of the rows that are shipped."""

import numpy as np
import pytest
from printed_tables import TASKS, lines_of, shipped

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
FROZEN = ("good", "success", "wasserstein", "coverage", "entropy")


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


def test_sets_on_frozen_scenes_are_those_of_their_rows():
    cells, rows = (
        printed("## Sets of all methods", "unselected_scenes.py"),
        shipped("frozen_sets.csv.gz"),
    )
    assert len(cells) == 7 * len(TASKS)
    references = dict(zip(TASKS, (25, 25, 21, 22), strict=True))
    check(cells, rows, FROZEN, scenes=25, references=references)
