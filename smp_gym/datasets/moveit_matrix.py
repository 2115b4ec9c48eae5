"""The allowed collision matrix of a MoveIt planning scene: pairs that may touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from smp_gym.arrays import shown
from smp_gym.datasets.moveit_fields import as_list, as_mapping

__all__ = ["AllowedCollisions", "allowed_of"]

_FIELD = "allowed_collision_matrix"


@dataclass(frozen=True)
class AllowedCollisions:
    """Which links and objects may touch, by their names.

    Attributes:
        entries: whether two may, by pair of names.
        defaults: whether one may touch all, by its name.
    """

    entries: Mapping[frozenset[str], bool] = field(default_factory=dict)
    defaults: Mapping[str, bool] = field(default_factory=dict)

    @property
    def permitting(self) -> frozenset[str]:
        """Names that the matrix lets touch something."""
        named = {name for pair, may in self.entries.items() if may for name in pair}
        return frozenset(named | {name for name, may in self.defaults.items() if may})

    def allows(self, first: str, second: str) -> bool:
        """Return whether two may touch.

        A pair's own entry counts; without one the defaults of the two, which must both allow it
        where both have one; without these they may not. So MoveIt reads it since 2021 (its issue
        2936); before, defaults went first.
        """
        own = self.entries.get(frozenset((first, second)))
        if own is not None:
            return own
        given = [self.defaults[name] for name in (first, second) if name in self.defaults]
        return bool(given) and all(given)


def allowed_of(message: Mapping[str, Any]) -> AllowedCollisions:
    """Return the allowed collision matrix of a scene; one without entries if it has none.

    Rows are lists, or mappings with the list ``enabled``. Entries of the diagonal say nothing.

    Raises:
        ValueError: a field is wrong, sizes differ, a name stands there twice, or the matrix is not
            symmetric.
    """
    matrix = as_mapping(message.get(_FIELD) or {}, _FIELD)
    names = _names(matrix, "entry_names")
    rows = as_list(matrix.get("entry_values"), f"{_FIELD}.entry_values")
    if len(rows) != len(names):
        raise ValueError(
            f"{_FIELD}.entry_values must have a row for each of {len(names)} entry_names, got "
            f"{len(rows)}"
        )
    values = []
    for number, given in enumerate(rows):
        where = f"{_FIELD}.entry_values[{number}]"
        row = as_list(given.get("enabled") if isinstance(given, Mapping) else given, where)
        if len(row) != len(names):
            raise ValueError(
                f"{where}, of {names[number]!r}, must have {len(names)} entries, got {len(row)}"
            )
        values.append([_truth(entry, where) for entry in row])
    entries = {}
    for i, first in enumerate(names):
        for j in range(i):
            if values[i][j] != values[j][i]:
                raise ValueError(
                    f"{_FIELD}.entry_values must be symmetric, got two values for "
                    f"{names[j]!r} and {first!r}"
                )
            entries[frozenset((first, names[j]))] = values[i][j]
    return AllowedCollisions(entries, _defaults(matrix))


def _defaults(matrix: Mapping[str, Any]) -> dict[str, bool]:
    names = _names(matrix, "default_entry_names")
    where = f"{_FIELD}.default_entry_values"
    given = as_list(matrix.get("default_entry_values"), where)
    if len(given) != len(names):
        raise ValueError(
            f"{where} must have a value for each of {len(names)} default_entry_names, got "
            f"{len(given)}"
        )
    return {name: _truth(value, where) for name, value in zip(names, given, strict=True)}


def _names(matrix: Mapping[str, Any], field: str) -> list[str]:
    where = f"{_FIELD}.{field}"
    names: dict[str, None] = {}
    for name in as_list(matrix.get(field), where):
        if not isinstance(name, str) or not name or name in names:
            raise ValueError(f"{where} must name each link or object once, got {shown(name)}")
        names[name] = None
    return list(names)


def _truth(value: Any, where: str) -> bool:
    if not isinstance(value, bool | int) or value not in (0, 1):
        raise ValueError(f"{where} must be true or false, got {shown(value)}")
    return bool(value)
