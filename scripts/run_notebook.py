"""Execute the notebook of the documentation, and keep what it shows, small enough for a repository.

Needs nbclient and ipykernel, which the extra ``dev`` brings.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import base64
import io
from pathlib import Path
from typing import Annotated, Any

import typer
from PIL import Image
from rich.console import Console

from smp_gym.atomic_files import write_text
from smp_planner.benchmark.options import run_command

_NOTEBOOK = Path("docs/notebook.ipynb")
_COLORS = 256
_SECONDS = 600
"""Colours of a picture; longest that a cell may take, s."""


def _small(picture: str) -> str:
    """Return a picture with few colours, both as base64 of PNG files."""
    reduced = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
        image.convert("RGB").quantize(_COLORS, dither=Image.Dither.NONE).save(
            reduced, "PNG", optimize=True
        )
    return base64.b64encode(reduced.getvalue()).decode("ascii")


def _kept(outputs: list[Any]) -> list[Any]:
    """Return outputs without what is told on the way, such as that something is compiled."""
    kept = [output for output in outputs if output.get("name") != "stderr"]
    for output in kept:
        if picture := output.get("data", {}).get("image/png"):
            output["data"] = {**output["data"], "image/png": _small(picture)}
            output["data"].pop("image/jpeg", None)
    return kept


def main(
    notebook: Annotated[
        Path, typer.Argument(help="It is replaced.", exists=True, dir_okay=False)
    ] = _NOTEBOOK,
) -> None:
    """Execute a notebook from top to bottom, and write it with its outputs.

    Example: python scripts/run_notebook.py docs/notebook.ipynb
    """
    try:
        import nbformat
        from nbclient import NotebookClient
    except ModuleNotFoundError as error:
        raise ValueError(f"{error}: pip install nbclient ipykernel") from error
    content = nbformat.read(notebook, as_version=4)
    folder = {"metadata": {"path": str(notebook.parent)}}
    NotebookClient(content, timeout=_SECONDS, resources=folder, record_timing=False).execute()
    for cell in content.cells:
        if cell.cell_type == "code":
            cell.outputs = _kept(cell.outputs)
    content.metadata.language_info = {"name": "python"}
    write_text(notebook, nbformat.writes(content) + "\n")
    size = notebook.stat().st_size / 1000
    Console(highlight=False, soft_wrap=True).print(f"wrote {notebook}, {size:.0f} kB", markup=False)


if __name__ == "__main__":
    run_command(main)
