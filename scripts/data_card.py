"""Describe frozen lists and demonstrations in a Croissant card; run it after they have changed."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from datetime import date
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.datasets.data_card import write_data_card
from smp_planner.benchmark.options import run_command


def _checked_date(text: str) -> str:
    """Return a date as it was given, if it is one."""
    if text:
        try:
            date.fromisoformat(text)
        except ValueError as error:
            raise typer.BadParameter(f"it must be a date as in 2026-01-31, got {text!r}") from error
    return text


def _checked_url(text: str) -> str:
    """Return an address as it was given, if it is one."""
    if text and not text.startswith(("https://", "http://")):
        raise typer.BadParameter(f"it must begin with https:// or http://, got {text!r}")
    return text


def main(
    root: Annotated[
        Path,
        typer.Option(
            help="Folder with benchmark and demonstrations; the card is written into it.",
            exists=True,
            file_okay=False,
        ),
    ] = Path("envs_assets"),
    url: Annotated[
        str,
        typer.Option(
            help="Page of the data. Default: what the card says already.", callback=_checked_url
        ),
    ] = "",
    published: Annotated[
        str,
        typer.Option(
            metavar="DATE",
            help="Date of publication. Default: what the card says already.",
            callback=_checked_date,
        ),
    ] = "",
) -> None:
    """Write ROOT/croissant.json: files with their digests, and the fields of what is in them.

    Example: python scripts/data_card.py --published 2026-01-31
    """
    path = write_data_card(root, url=url, published=published)
    Console(highlight=False, soft_wrap=True).print(f"wrote {path}", markup=False)


if __name__ == "__main__":
    run_command(main)
