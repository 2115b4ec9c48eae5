"""Models of settings that take for a number what is one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from smp_gym.arrays import shown

__all__ = ["StrictSettings"]


class StrictSettings(BaseModel):
    """Settings by name: unknown names are refused, and text and truth values for numbers.

    What has been checked does not change.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _takes_numbers_for_numbers(cls, given: Any) -> Any:
        for name, value in given.items() if isinstance(given, Mapping) else ():
            field = cls.model_fields.get(name)
            if field is None:
                continue
            kinds = set(_kinds(field.annotation))
            wrong: tuple[type, ...] = () if str in kinds else (str,)
            wrong += () if bool in kinds else (bool, np.bool_)
            if any(isinstance(part, wrong) for part in _parts(value)):
                wanted = "a number or numbers" if kinds & {int, float} else "True or False"
                raise ValueError(f"{name} must be {wanted}, got {shown(value)}")
        return given


def _kinds(annotation: Any) -> Iterator[type]:
    """Yield the types of which values of an annotation are made."""
    if get_origin(annotation) is Literal:
        yield from map(type, get_args(annotation))
    elif parts := get_args(annotation):
        for part in parts:
            yield from _kinds(part)
    elif isinstance(annotation, type):
        yield annotation


def _parts(value: Any) -> Iterator[Any]:
    """Yield what a value, or a sequence of such, is made of."""
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for part in value:
            yield from _parts(part)
    else:
        yield value
