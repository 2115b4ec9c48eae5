"""Every script answers `--help`, with an example that its own options can read."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

FOLDER = Path(__file__).parents[1] / "scripts"
SCRIPTS = {
    path.stem: path for path in sorted(FOLDER.glob("*.py")) if "__main__" in path.read_text()
}
WITH_COMMANDS = {
    "controls": ("run", "table"),
    "lasa": ("boxes", "compare", "modulate", "posterior", "shapes", "tune"),
    "ship_rows": ("cages", "lasa", "narrow-places", "sets", "sides", "standard", "tight"),
    "table_two": ("run", "show"),
}
EXAMPLES = [
    (name, command)
    for name in (
        "attack_commands",
        "check_environments",
        "check_witnesses",
        "controls",
        "data_card",
        "draw_scenes",
        "export_minari",
        "kill_runs",
        "leaderboard",
        "lasa",
        "link_covers",
        "make_benchmark",
        "make_jaco_assets",
        "measure_maps",
        "motion_durations",
        "narrow_places",
        "particle_figures",
        "prior_rules",
        "run_notebook",
        "ship_rows",
        "speed_costs",
        "speed_env",
        "table_two",
        "train_agent",
        "train_cloning",
        "train_shape_maps",
        "tune_methods",
        "unselected_scenes",
    )
    for command in WITH_COMMANDS.get(name, (None,))
]


def _app(name: str) -> typer.Typer:
    content = runpy.run_path(str(SCRIPTS[name]))
    if "app" in content:
        return content["app"]
    app = typer.Typer()
    app.command()(content["main"])
    return app


@pytest.mark.parametrize("name", SCRIPTS)
def test_help_is_given(name: str) -> None:
    result = CliRunner().invoke(_app(name), ["--help"])
    assert result.exit_code == 0, result.output
    assert "Usage" in result.output


@pytest.mark.parametrize(("name", "command"), EXAMPLES)
def test_the_example_of_a_command_is_one_it_understands(name: str, command: str | None) -> None:
    group = typer.main.get_command(_app(name))
    found = group if command is None else group.commands[command]
    (example,) = re.findall(r"Example: python scripts/(\S+\.py) ([^\n]+)", found.help or "")
    script, arguments = example[0], shlex.split(example[1])
    assert script == f"{name}.py"
    if command is not None:
        assert arguments.pop(0) == command
    # This parses and converts, and refuses what the command does not know; nothing is run.
    found.make_context(name, list(arguments))
    with pytest.raises(Exception, match=r"(?i)no such option"):
        found.make_context(name, [*arguments, "--no-such-option"])
