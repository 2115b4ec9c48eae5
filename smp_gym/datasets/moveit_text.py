"""The text format of MoveIt's planning scenes (``.scene``), turned into their message form.

Such files are what MoveIt's ``PlanningScene::saveGeometryToStream`` writes and RViz exports: a line
with a name, then for each collision object a ``*`` with its id, its pose, and its shapes, each with
dimensions, pose and colour; at the end ``.``. Before 2020 objects had neither poses nor subframes;
the line after the first id tells.
"""

from __future__ import annotations

import math
from typing import Any

__all__ = ["scene_message"]

_MEASURES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4}
"""Numbers that follow the name of a shape."""


def scene_message(text: str) -> dict[str, Any]:
    """Return a scene as a mapping with the fields of ``moveit_msgs/PlanningScene``.

    Raises:
        ValueError: not such a text; the message names the line.
    """
    words = _Words(text)
    name = words.rest()
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
    trailing = words.peek()
    if trailing is not None:
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

    Attributes:
        line: number of the line of the last word, from 1.
    """

    def __init__(self, text: str) -> None:
        self._lines = text.splitlines()
        self._row = 0
        self._waiting: list[str] = []
        self._load()
        self._left = sum(len(line.split()) for line in self._lines)
        self.line = 1

    def _load(self) -> None:
        if self._row < len(self._lines):
            self._waiting = self._lines[self._row].split()[::-1]

    def _advance(self) -> None:
        while not self._waiting and self._row < len(self._lines):
            self._row += 1
            self._load()

    def peek(self) -> str | None:
        """Return the next word; None at the end."""
        self._advance()
        if not self._waiting:
            return None
        self.line = self._row + 1
        return self._waiting[-1]

    def next(self, what: str) -> str:
        """Return the next word, of which a message says what it should have been."""
        word = self.peek()
        if word is None:
            raise ValueError(f"line {len(self._lines)} must be followed by {what}, got the end")
        self._left -= 1
        return self._waiting.pop()

    def rest(self) -> str:
        """Return what is left of the line of the last word, and go to the next line."""
        words = self._waiting[::-1]
        self._left -= len(words)
        self._row += 1
        self._waiting = []
        self._load()
        return " ".join(words)

    def left_in_line(self) -> int:
        """Return how many words are left in the line of the next word."""
        self.peek()
        return len(self._waiting)

    def refuse_beyond(self, needed: int, what: str) -> None:
        """Raise a ValueError if fewer words are left."""
        if needed > self._left:
            raise ValueError(
                f"line {self.line} announces {needed} {what}, got {self._left} words after it"
            )

    def numbers(self, count: int, what: str) -> list[float]:
        """Return the next numbers, which are finite."""
        found = []
        for _ in range(count):
            word = self.next(what)
            try:
                number = float(word)
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                raise ValueError(f"line {self.line} must hold {what}, got {word!r:.60}")
            found.append(number)
        return found

    def counts(self, count: int, what: str) -> list[int]:
        """Return the next whole numbers, which are not negative."""
        found = []
        for _ in range(count):
            word = self.next(what)
            if not (word.isascii() and word.isdigit() and len(word) < 10):
                raise ValueError(f"line {self.line} must hold {what}, got {word!r:.60}")
            found.append(int(word))
        return found

    def count(self, what: str) -> int:
        """Return the next whole number, which is not negative."""
        return self.counts(1, what)[0]
