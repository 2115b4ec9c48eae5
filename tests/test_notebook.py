"""The notebook of the documentation: it runs from top to bottom, and shows what it says."""

import base64
import io
from pathlib import Path

import imageio.v3 as imageio
import pytest

nbformat = pytest.importorskip("nbformat", reason="needs the extra dev")
nbclient = pytest.importorskip("nbclient", reason="needs the extra dev")

NOTEBOOK = Path(__file__).parents[1] / "docs" / "notebook.ipynb"
COMMAND = "its outputs are made anew by: python scripts/run_notebook.py"
PICTURES = 4


def _outputs(notebook) -> list:
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def _check_shown(notebook) -> None:
    outputs = _outputs(notebook)
    assert not [output for output in outputs if output.output_type == "error"]
    pictures = [
        output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == PICTURES
    for picture in pictures:
        shown = imageio.imread(io.BytesIO(base64.b64decode(picture)))[..., :3]
        assert min(shown.shape[:2]) > 200
        assert shown.std() > 10.0
    printed = "".join(output.text for output in outputs if output.get("name") == "stdout")
    assert "success: True" in printed
    assert "good: 42 of 42" in printed


def test_it_runs_from_top_to_bottom() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    folder = {"metadata": {"path": str(NOTEBOOK.parent)}}
    # An exception in a cell is one here.
    nbclient.NotebookClient(notebook, timeout=500, resources=folder).execute()
    _check_shown(notebook)


def test_its_outputs_are_kept_and_small() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    _check_shown(notebook)
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1)), COMMAND
    assert not [output for output in _outputs(notebook) if output.get("name") == "stderr"]
    assert NOTEBOOK.stat().st_size < 300_000
