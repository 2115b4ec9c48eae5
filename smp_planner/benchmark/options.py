"""Reading lists of names from the command line."""

from __future__ import annotations

from collections.abc import Sequence

import typer

__all__ = ["chosen_names", "split_names"]


def split_names(text: str) -> tuple[str, ...]:
    """Return the names in a list separated by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def chosen_names(text: str, known: Sequence[str], option: str) -> list[str]:
    """Return the names in a list separated by commas; all known ones for an empty list.

    Args:
        text: what the user gave.
        known: what is allowed, in order.
        option: its name on the command line, such as "--tasks".

    Raises:
        typer.BadParameter: a name is not known.
    """
    names = list(split_names(text)) or list(known)
    for name in names:
        if name not in known:
            raise typer.BadParameter(
                f"must be of {', '.join(known)}; got {name!r}", param_hint=option
            )
    return names
