"""Pairs of links that may touch, from a robot's semantic description (SRDF) or by their names."""

from __future__ import annotations

from collections.abc import Iterable, Set
from pathlib import Path
from typing import Any

from smp_gym.arrays import shown
from smp_planner.library.urdf_reading import robot_element

__all__ = ["LinkPair", "checked_pairs", "read_touching"]

LinkPair = frozenset[str]
"""Names of two links; of one, for its own parts."""


def checked_pairs(given: Any, links: Set[str]) -> frozenset[LinkPair]:
    """Return pairs of links that were given by their names.

    Args:
        given: pairs of names.
        links: that there are.

    Raises:
        ValueError: not pairs of names of such links.
    """
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ValueError(f"touching must be pairs of names of links, got {shown(given)}")
    pairs = []
    for index, pair in enumerate(given):
        names = tuple(pair) if isinstance(pair, Iterable) and not isinstance(pair, str) else ()
        if len(names) != 2 or not all(isinstance(name, str) for name in names):
            raise ValueError(f"touching[{index}] must be two names of links, got {shown(pair)}")
        unknown = [name for name in names if name not in links]
        if unknown:
            raise ValueError(f"touching[{index}] names the link {unknown[0]!r}, which is not there")
        pairs.append(frozenset(names))
    return frozenset(pairs)


def read_touching(path: str | Path, links: Set[str]) -> frozenset[LinkPair]:
    """Return the pairs of links that an SRDF leaves out of collision checks.

    ``disable_collisions`` leaves out a pair, ``disable_default_collisions`` all pairs of a link but
    those of ``enable_collisions``. What else it holds, such as groups and states, is not read.

    Args:
        path: of the file.
        links: of the robot's URDF.

    Raises:
        OSError: it cannot be read.
        ValueError: not an SRDF, or one that names links that the URDF lacks.
    """
    file = Path(path)
    root = robot_element(file, "an SRDF")
    for tag in ("link", "joint"):
        if root.find(tag) is not None:
            raise ValueError(f"{file} is not an SRDF: it holds a <{tag}>, as a URDF does")

    def named(element: Any, attribute: str) -> str:
        name = element.get(attribute)
        if name not in links:
            raise ValueError(
                f"{file}: {attribute} of <{element.tag}> must be a link of the URDF, got {name!r}"
            )
        return str(name)

    def pairs(tag: str) -> set[LinkPair]:
        return {
            frozenset((named(each, "link1"), named(each, "link2"))) for each in root.findall(tag)
        }

    alone = {named(each, "link") for each in root.findall("disable_default_collisions")}
    by_default = {frozenset((link, other)) for link in alone for other in links}
    return frozenset(pairs("disable_collisions") | (by_default - pairs("enable_collisions")))
