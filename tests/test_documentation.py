"""The README and the pages of the documentation: blocks run, links lead somewhere."""

import re
import runpy
from pathlib import Path

import pytest

from smp_gym.observation import observation_space
from smp_gym.scene import TASKS

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]


def _blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.DOTALL)


def _anchors(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\s-]", "", title).strip().lower().replace(" ", "-") for title in titles}


def test_the_readme_runs_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    for block in _blocks(README, "python"):
        exec(compile(block, str(README), "exec"), names)
    acted, adapted, planned = capsys.readouterr().out.splitlines()[-3:]
    assert re.fullmatch(r"(True|False) (True|False)", acted)
    assert float(adapted.split()[0]) > 0.9
    assert re.fullmatch(r"True \(42, 200, 6\) (1\.0|0\.[89]\d*)", planned)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_pictures_are_there(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http://", "https://")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in _anchors(target), link


def test_code_of_the_uses_is_short() -> None:
    for block in [*_blocks(README, "python"), *_blocks(README, "console")]:
        code = [line for line in block.splitlines() if line.strip()]
        assert len(code) <= 10, block


def test_every_page_is_in_the_site() -> None:
    listed = set(re.findall(r"^[\w/]+$", (ROOT / "docs" / "index.md").read_text(), re.MULTILINE))
    for page in PAGES[2:]:
        name = str(page.relative_to(ROOT / "docs").with_suffix(""))
        assert name == "index" or name in listed


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_python_blocks_can_be_read(page: Path) -> None:
    for block in _blocks(page, "python"):
        compile(block, str(page), "exec")


def test_pictures_of_the_tasks_are_light() -> None:
    pictures = list((ROOT / "docs" / "tasks").glob("*.png"))
    assert len(pictures) == 4
    assert max(picture.stat().st_size for picture in pictures) < 150_000


def test_commands_of_the_documentation_are_there() -> None:
    """Scripts that pages name exist, and so do the subcommands of `smp-bench`."""
    from typer.main import get_command

    from smp_planner.benchmark.cli import app

    commands = get_command(app).commands
    for page in PAGES:
        text = page.read_text()
        for script in re.findall(r"\bscripts/\w+\.py", text):
            assert (ROOT / script).exists(), script
        for command in re.findall(r"^smp-bench (\w+)", text, flags=re.MULTILINE):
            assert command in commands, command


@pytest.mark.parametrize("task", TASKS)
def test_tables_of_a_task_add_up_to_its_spaces(task: str) -> None:
    pytest.importorskip("docutils", reason="needs the docs extra")
    tables = runpy.run_path(str(ROOT / "docs" / "task_tables.py"))["TABLES"]

    def size(rows: list[tuple[str, ...]]) -> int:
        return int(re.split("–", str(rows[-1][0]))[-1]) + 1

    space = observation_space(task)
    assert size(tables["goal"](task)) == space["desired_goal"].shape[0]
    assert size(tables["state"]()) == space["observation"].shape[0]
    assert size(tables["obstacle"]()) * 16 == space["obstacles"].shape[0]
    assert size(tables["action"]()) == 7
    sizes = {row[0].strip("`"): str(row[1]) for row in tables["keys"](task)[1:]}
    assert sizes["achieved_goal"] == str(space["achieved_goal"].shape[0])
    assert sizes["observation"] == str(space["observation"].shape[0])
    assert {row[0] for row in tables["ids"](task)[1:]} == {
        f"`smp_gym/{task}-v0`",
        f"`smp_gym/{task}Dense-v0`",
    }
