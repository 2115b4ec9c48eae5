"""Configuration of Sphinx: `make docs` builds the pages of this folder into `docs/_build/html`."""

import re
import sys
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(_ROOT), str(_ROOT / "docs")]

project = "Stein Movement Primitives"
author = copyright = "Stein Movement Primitives contributors"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "leaderboard_table",
    "mathml",
    "task_tables",
]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
exclude_patterns = ["_build"]
nitpicky = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
# The notebook is shown with the outputs that it holds; tests/test_notebook.py executes it.
nb_execution_mode = "off"

autodoc_member_order = "bysource"
autodoc_typehints = "none"
# A single backquote in the docstrings is code, as in Markdown.
default_role = "literal"

html_theme = "furo"
html_math_renderer = "mathml"
html_title = project
html_theme_options = {"navigation_with_keys": True}
html_static_path: list[str] = []


def _part_endings(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Part what is in backquotes from an ending after it, as reStructuredText wants it."""
    lines[:] = [re.sub(r"(?<!`)(`[^`]+`)(?=\w)", r"\1\\ ", line) for line in lines]


def setup(app: Any) -> None:
    """Register what changes docstrings."""
    app.connect("autodoc-process-docstring", _part_endings)
