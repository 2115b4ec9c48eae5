"""A short run of scripts/attack_commands.py: no bad command line ends in a traceback."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "scripts"
COUNT = 50

ATTACK = f"""
import json, runpy, sys, warnings
warnings.simplefilter("ignore")
told = []
attack = runpy.run_path(sys.argv[1])["attack"]
outcomes = attack({COUNT}, 0, told.append, limit=0.25)
print(json.dumps([outcomes, told]))
"""


def test_bad_command_lines_are_refused_by_name():
    # A process of its own: one where commands are stopped anywhere is of no use for more.
    done = subprocess.run(
        [sys.executable, "-c", ATTACK, str(FOLDER / "attack_commands.py")],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    outcomes, told = json.loads(done.stdout.splitlines()[-1])
    total = {
        what: sum(counted.get(what, 0) for counted in outcomes.values())
        for what in ("named", "unnamed", "worked", "ended", "traceback")
    }
    assert sum(total.values()) == COUNT
    assert len(outcomes) > 25
    assert total["traceback"] == 0, told
    assert total["unnamed"] <= 0.05 * COUNT, told
    assert total["named"] >= 0.8 * COUNT, told


def test_every_script_enters_where_command_lines_are_checked():
    for path in sorted(FOLDER.glob("*.py")):
        text = path.read_text()
        if "import typer" in text:
            assert re.search(r"^    run_command\(main\)$|^app = CommandLine\(", text, re.M), path
            assert "typer.run" not in text
            assert "typer.Typer(" not in text
