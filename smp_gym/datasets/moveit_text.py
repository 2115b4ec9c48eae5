"""The text format of MoveIt's planning scenes (``.scene``), turned into their message form.

Such files are what MoveIt's ``PlanningScene::saveGeometryToStream`` writes and RViz exports: a line
with a name, then for each collision object a ``*`` with its id, its pose, and its shapes, each with
dimensions, pose and colour; at the end ``.``. Before 2020 objects had neither poses nor subframes;
the line after the first id tells.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from itertools import accumulate
from typing import Any, TypeVar

__all__ = ["scene_message"]

_MEASURES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4}
"""Numbers that follow the name of a shape."""

_LONGEST_COUNT = 9
"""Digits of a whole number at most."""

_Number = TypeVar("_Number", int, float)


def scene_message(text: str) -> dict[str, Any]:
    """Return a scene as a mapping with the fields of ``moveit_msgs/PlanningScene``.

    Raises:
        ValueError: not such a text; the message names the line.
    """
    words = _Words(text)
    name = words.first_line()
    objects: list[dict[str, Any]] = []
    marker, posed = words.next("'*' or '.'"), None
    while marker != ".":
        if marker != "*":
            raise ValueError(f"line {words.line} must begin with '*' or '.', got {marker!r:.60}")
        line, identity = words.line, words.rest()
        if not identity or any(known["id"] == identity for known in objects):
            what = f"{identity!r} once more" if identity else "none"
            raise ValueError(f"line {line} must have an id of its own after '*', got {what}")
        posed = words.left_in_line() > 1 if posed is None else posed
        objects.append(_object(identity, words, posed))
        marker = words.next("'*' or '.'")
    if words.peek() is not None:
        trailing = words.next("nothing")
        raise ValueError(f"line {words.line} must be empty after the end '.', got {trailing!r:.60}")
    return {"name": name, "world": {"collision_objects": objects}}


def _object(identity: str, words: _Words, posed: bool) -> dict[str, Any]:
    found: dict[str, Any] = {"id": identity}
    if posed:
        found["pose"] = _pose(words)
    for _ in range(words.count("the number of shapes")):
        kind = words.next("a shape")
        entries: Any
        if kind == "mesh":
            vertices = words.count("the number of vertices")
            triangles = words.count("the number of triangles")
            words.refuse_beyond(3 * (vertices + triangles), "coordinates and corners")
            kinds, entries = (
                "mesh",
                {
                    "vertices": [words.numbers(3, "a vertex") for _ in range(vertices)],
                    "triangles": [words.counts(3, "a triangle") for _ in range(triangles)],
                },
            )
        elif kind in _MEASURES:
            measures = words.numbers(_MEASURES[kind], f"the measures of a {kind}")
            if kind in ("cylinder", "cone"):
                # Here the radius comes first, in messages the height.
                measures = measures[::-1]
            kinds = "plane" if kind == "plane" else "primitive"
            entries = {"coef" if kind == "plane" else "dimensions": measures, "type": kind}
        else:
            allowed = ", ".join([*_MEASURES, "mesh"])
            raise ValueError(f"line {words.line} must name a shape of {allowed}; got {kind!r:.60}")
        plural = "meshes" if kinds == "mesh" else f"{kinds}s"
        found.setdefault(plural, []).append(entries)
        found.setdefault(f"{kinds}_poses", []).append(_pose(words))
        words.numbers(4, "a colour")
    if posed:
        for _ in range(words.count("the number of subframes")):
            words.next("the name of a subframe")
            _pose(words)
    return found


def _pose(words: _Words) -> dict[str, Any]:
    return {
        "position": words.numbers(3, "a position x y z"),
        "orientation": words.numbers(4, "an orientation x y z w"),
    }


class _Words:
    """The words of a text, one after the other.

    Args:
        text: of any number of lines.
    """

    def __init__(self, text: str) -> None:
        lines = [line.split() for line in text.splitlines()]
        self._words = [word for line in lines for word in line]
        # Of each line, how many words stand there or before.
        self._ends = list(accumulate(map(len, lines)))
        self._place = 0

    @property
    def line(self) -> int:
        """Number of the line of the last word, from 1."""
        return bisect_right(self._ends, max(self._place - 1, 0)) + 1

    def peek(self) -> str | None:
        """Return the next word; None at the end."""
        return self._words[self._place] if self._place < len(self._words) else None

    def next(self, what: str) -> str:
        """Return the next word, of which a message says what it should have been."""
        return self._next(1, what)[0]

    def _next(self, count: int, what: str) -> list[str]:
        words = self._words[self._place : self._place + count]
        if len(words) < count:
            raise ValueError(f"line {len(self._ends)} must be followed by {what}, got the end")
        self._place += count
        return words

    def first_line(self) -> str:
        """Return the first line, of which no word was taken."""
        return " ".join(self._next(self._ends[0] if self._ends else 0, "a name"))

    def rest(self) -> str:
        """Return what is left of the line of the last word."""
        return " ".join(self._next(self._ends[self.line - 1] - self._place, "words"))

    def left_in_line(self) -> int:
        """Return how many words the line of the next word has left."""
        line = bisect_right(self._ends, self._place)
        return self._ends[line] - self._place if line < len(self._ends) else 0

    def refuse_beyond(self, needed: int, what: str) -> None:
        """Raise a ValueError if fewer words are left."""
        left = len(self._words) - self._place
        if needed > left:
            raise ValueError(
                f"line {self.line} announces {needed} {what}, got {left} words after it"
            )

    def numbers(self, count: int, what: str) -> list[float]:
        """Return the next numbers, which are finite."""
        return self._checked(count, what, _finite)

    def counts(self, count: int, what: str) -> list[int]:
        """Return the next whole numbers, which are not negative."""
        return self._checked(count, what, _whole)

    def _checked(self, count: int, what: str, read: Callable[[str], _Number]) -> list[_Number]:
        begin = self._place
        found = []
        for word in self._next(count, what):
            try:
                found.append(read(word))
            except ValueError:
                self._place = begin + len(found) + 1
                message = f"line {self.line} must hold {what}, got {word!r:.60}"
                raise ValueError(message) from None
        return found

    def count(self, what: str) -> int:
        """Return the next whole number, which is not negative."""
        return self.counts(1, what)[0]


def _finite(word: str) -> float:
    number = float(word)
    if not math.isfinite(number):
        raise ValueError
    return number


def _whole(word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) <= _LONGEST_COUNT):
        raise ValueError
    return int(word)
