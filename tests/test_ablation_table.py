"""The tables of the ablation are the means of the rows that are shipped."""

import numpy as np
import pytest
from printed_tables import TASKS, lines_of, shipped

COLUMNS = {"good": 0.5, "wasserstein": 0.5, "entropy": 0.05, "demonstrations": 0.5}
"""Numbers of a cell, with half of the last digit of each."""


def rows(run):
    return [row for row in shipped("ablation.csv.gz") if row["run"] == run]


def printed(first, last):
    """Return the cells of the table between two texts of the page, by method and task."""
    return {
        (method, task): [float(number) for number in value.split("·")]
        for method, *values in lines_of("docs/arm.md", first, last)
        if len(values) == len(TASKS) and "·" in values[0]
        for task, value in zip(TASKS, values, strict=True)
    }


@pytest.mark.parametrize(
    ("run", "first", "last", "methods"),
    [
        ("ablation", "What each part is worth", "unselected_scenes.py", 9),
        ("svgd", "**SVGD by itself**", "unselected_scenes.py", 4),
    ],
)
def test_cells_are_the_means_of_their_rows(run, first, last, methods):
    cells, found = printed(first, last), rows(run)
    assert len(cells) == methods * len(TASKS)
    for (method, task), numbers in cells.items():
        own = [row for row in found if (row["method"], row["task"]) == (method, task)]
        assert len(own) == (8 if method == "noise floor" else 50)
        for number, (column, half) in zip(numbers, COLUMNS.items(), strict=True):
            values = [float(row[column]) for row in own if row[column]]
            # Rows hold four digits.
            assert np.mean(values) == pytest.approx(number, abs=half + 1e-3 * abs(number))
