"""Height maps as obstacles: columns under cells, merged where heights agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import BoolArray, FloatArray, checked_array, checked_number
from smp_gym.geometry.pose import checked_pose
from smp_gym.scene import Obstacle
from smp_planner.library.solids import MOST_PARTS

__all__ = ["height_map_obstacles"]

_MOST_CELLS = 250_000
"""Cells of a map at most: the time to merge them grows with their number for each box."""


def height_map_obstacles(
    heights: ArrayLike,
    resolution: float,
    *,
    floor: float,
    overshoot: float = 0.0,
    unknown: float | None = None,
    position: ArrayLike = (0.0, 0.0, 0.0),
    quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
) -> list[Obstacle]:
    """Return boxes that together are the columns under the cells of a height map.

    Cell (i, j) covers x from i to i + 1 and y from j to j + 1 times the resolution, and is solid
    from the floor up to its height. No point of a column is missing. Boxes are as large as the
    heights of their cells allow, and pass through higher columns, so that they are few and deep.

    Args:
        heights: (N, M) m, along z of the map's frame, none below the floor; a cell at the floor
            is free.
        resolution: m, side of a cell.
        floor: m, where columns begin. Where a robot may come from below, put it far down.
        overshoot: m, by which a box may stand out of the lower columns that it merges; 0 merges
            only those of equal height.
        unknown: m, the height of cells that are NaN; None allows no NaN.
        position: (3,) m, where the corner of cell (0, 0) is put.
        quaternion: (4,) x, y, z, w of norm 1, how the map is turned about it.

    Raises:
        ValueError: an argument is out of range, or more than 4096 boxes are needed.

    Example:
        >>> import numpy as np
        >>> from smp_planner import height_map_obstacles
        >>> steps = np.repeat([0.0, 0.1, 0.2], 10)[:, None] + np.zeros(20)
        >>> boxes = height_map_obstacles(steps, 0.02, floor=-0.05, position=(0.3, -0.2, 0.0))
        >>> len(boxes)
        3
    """
    given = checked_array("heights", heights, (None, None), nan=unknown is not None)
    if not 0 < given.size <= _MOST_CELLS:
        raise ValueError(f"heights must have 1 to {_MOST_CELLS} cells, got {given.shape}")
    resolution = checked_number("resolution", resolution, above=0.0)
    floor = checked_number("floor", floor)
    overshoot = checked_number("overshoot", overshoot, least=0.0)
    if unknown is not None:
        unknown = checked_number("unknown", unknown, least=floor)
        given[np.isnan(given)] = unknown
    pose = checked_pose(position, quaternion)
    if given.min() < floor:
        i, j = np.unravel_index(int(given.argmin()), given.shape)
        raise ValueError(
            f"heights must be at least the floor, {floor}, got {given[i, j]:.6g} at ({i}, {j})"
        )
    boxes = []
    for (first, last), (left, right), top in _merged(given, floor, overshoot):
        lower = np.array([first * resolution, left * resolution, floor])
        upper = np.array([last * resolution, right * resolution, top])
        x, y, z = pose.of((lower + upper) / 2).tolist()
        a, b, c = ((upper - lower) / 2).tolist()
        boxes.append(
            Obstacle(shape="box", position=(x, y, z), quaternion=pose.quaternion, size=(a, b, c))
        )
    return boxes


def _merged(
    heights: FloatArray, floor: float, overshoot: float
) -> list[tuple[tuple[int, int], tuple[int, int], float]]:
    """Return ranges of rows and columns, and a top, of boxes that hold all columns.

    From the highest cell to the lowest, one that no box holds gets the largest rectangle of cells
    that are at most `overshoot` lower.
    """
    solid = heights > floor
    held = ~solid
    found: list[tuple[tuple[int, int], tuple[int, int], float]] = []
    for cell in np.argsort(-heights, axis=None, kind="stable").tolist():
        row, column = divmod(cell, heights.shape[1])
        if held[row, column]:
            continue
        if len(found) == MOST_PARTS:
            raise ValueError(
                f"overshoot must be large enough for {MOST_PARTS} boxes to hold the map, got "
                f"{overshoot}; or give a map of fewer cells, each the highest of several"
            )
        top = float(heights[row, column])
        rows, columns = _largest_rectangle(solid & (heights >= top - overshoot), row, column)
        held[slice(*rows), slice(*columns)] = True
        found.append((rows, columns, top))
    return found


def _largest_rectangle(
    allowed: BoolArray, row: int, column: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return ranges of rows and columns of the largest allowed rectangle around a cell."""
    up, down = _run(allowed[row::-1, column]), _run(allowed[row:, column])
    rows = allowed[row - up + 1 : row + down]
    left = np.array([_run(line[column::-1]) for line in rows])
    right = np.array([_run(line[column:]) for line in rows])
    # Of the rows from `a` above to `b` below, the narrowest one counts.
    widths = [
        np.minimum(
            np.minimum.accumulate(reach[up - 1 :: -1])[:, None],
            np.minimum.accumulate(reach[up - 1 :])[None, :],
        )
        for reach in (left, right)
    ]
    lengths = np.arange(1, up + 1)[:, None] + np.arange(down)[None, :]
    area = lengths * (widths[0] + widths[1] - 1)
    a, b = np.unravel_index(int(area.argmax()), area.shape)
    before, after = int(widths[0][a, b]), int(widths[1][a, b])
    return (row - int(a), row + int(b) + 1), (column - before + 1, column + after)


def _run(line: BoolArray) -> int:
    """Return how many entries of a line are true from its first on."""
    blocked = int(line.argmin())
    return len(line) if line[blocked] else blocked
