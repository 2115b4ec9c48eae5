"""Rows that are shipped, and tables of the documentation that are counted from them."""

import csv
import gzip
from pathlib import Path

from smp_gym.assets import asset_path

ROOT = Path(__file__).parents[1]
TASKS = ("Placement", "DoubleSidedPlacement", "DrawS", "PushLiftBox")


def shipped(name):
    with gzip.open(asset_path("results", name), "rt", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def page(name):
    return (ROOT / name).read_text(encoding="utf-8")


def lines_of(name, before, until=None):
    """Return the entries of each line of the first table of a page below a text.

    Args:
        name: of the page.
        before: text that the table comes after.
        until: text that it comes before, where other lines may stand between.
    """
    text = page(name).split(before, 1)[1]
    lines = (text.split(until, 1)[0] if until else text).splitlines()
    if until is None:
        first = next(index for index, line in enumerate(lines) if line.startswith("|"))
        last = next(
            (i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines)
        )
        lines = lines[first:last]
    rows = [line for line in lines if line.startswith("|") and not line.startswith("| ---")]
    return [[entry.strip() for entry in line.strip("|").split("|")] for line in rows]
