"""A short run of scripts/attack_commands.py: no bad command line ends in a traceback."""

import re
import runpy
from collections import Counter
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "scripts"


@pytest.mark.filterwarnings("ignore")
def test_bad_command_lines_are_refused_by_name():
    told = []
    attack = runpy.run_path(str(FOLDER / "attack_commands.py"))["attack"]
    outcomes = attack(120, 0, told.append, limit=0.25)
    total = sum(outcomes.values(), Counter())
    assert total.total() == 120
    assert len(outcomes) > 30
    assert total["traceback"] == 0, told
    assert total["unnamed"] <= 0.05 * 120, told
    assert total["named"] >= 0.8 * 120, told


def test_every_script_enters_where_command_lines_are_checked():
    for path in sorted(FOLDER.glob("*.py")):
        text = path.read_text()
        if "import typer" in text:
            assert re.search(r"^    run_command\(main\)$|^app = CommandLine\(", text, re.M), path
            assert "typer.run" not in text
            assert "typer.Typer(" not in text
