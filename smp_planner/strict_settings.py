"""Models of settings that take for a number what is one, alone and several at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, create_model, model_validator

from smp_gym.arrays import shown

__all__ = ["StrictSettings", "checked_settings"]


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


def checked_settings(
    title: str, given: Mapping[str, Any], *models: type[BaseModel]
) -> tuple[Any, ...]:
    """Return settings as one instance of each of several models, which share no name.

    All are checked as one model, so that an error names all that exist.

    Args:
        title: that errors begin with.
        given: settings by name; the rest keep their defaults.
        models: that they are of.

    Raises:
        ValueError: an unknown setting, or one out of range.
    """
    everything: Any = create_model(
        title,
        __config__=ConfigDict(extra="forbid", frozen=True),
        **{  # type: ignore[call-overload]
            name: (field.annotation, field)
            for model in models
            for name, field in model.model_fields.items()
        },
    )
    everything.model_validate(dict(given))
    return tuple(
        model.model_validate({name: given[name] for name in model.model_fields if name in given})
        for model in models
    )


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
