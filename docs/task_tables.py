"""A Sphinx extension: tables of the tasks, written from the code at every build.

The directive ``task-table`` takes the name of a table of `TABLES`, and a task where the table is
one of a task: observations, goals, actions, families of scenes, ids.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

from smp_gym import ENVIRONMENTS
from smp_gym.observation import (
    CLOUD_POINTS,
    CONTROL_PERIOD,
    MAX_EPISODE_STEPS,
    OBSTACLE_LAYOUT,
    STATE_LAYOUT,
)
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_gym.sampling import CROWDED
from smp_gym.scene import DIFFICULTIES, FAMILIES, MAX_OBSTACLES
from smp_gym.tasks.goals import Field
from smp_gym.tasks.registry import make_task, task_families

Rows = list[Sequence[Any]]


def _fields(layout: Sequence[Field]) -> Rows:
    rows: Rows = [("Entries", "Field", "Least", "Greatest")]
    start = 0
    for field in layout:
        end = start + field.size - 1
        entries = str(start) if field.size == 1 else f"{start}–{end}"
        rows.append((entries, f"`{field.name}`", f"{field.low:g}", f"{field.high:g}"))
        start += field.size
    return rows


def _keys(task: str) -> Rows:
    goal = sum(field.size for field in make_task(task).goals.layout)
    state = sum(field.size for field in STATE_LAYOUT)
    row = sum(field.size for field in OBSTACLE_LAYOUT)
    return [
        ("Key", "Size", "Holds"),
        ("`observation`", state, "state of arm, gripper and object; time"),
        ("`achieved_goal`", goal, "what is reached, in the fields of the goal below"),
        ("`desired_goal`", goal, "what shall be reached, in the same fields"),
        ("`obstacles`", f"{MAX_OBSTACLES} × {row}", "a row for each obstacle"),
        ("`points`", f"{CLOUD_POINTS} × 3", "in place of `obstacles` with `sensing='depth'`, m"),
    ]


def _goal(task: str) -> Rows:
    return _fields(make_task(task).goals.layout)


def _action() -> Rows:
    rows: Rows = [("Entry", "Means", "At 1")]
    for number, rate in enumerate(JOINT_VELOCITY):
        rows.append((number, f"rate of joint {number + 1}", f"{rate:.3g} rad/s"))
    rows.append((len(JOINT_VELOCITY), "rate of the gripper", "closes in a second"))
    return rows


def _ids(task: str) -> Rows:
    rows: Rows = [("Id", "Reward", "Steps at most", "Seconds at most")]
    seconds = MAX_EPISODE_STEPS * CONTROL_PERIOD
    for entry in ENVIRONMENTS:
        if entry.task == task:
            rows.append((f"`{entry.id}`", entry.reward, MAX_EPISODE_STEPS, f"{seconds:g}"))
    return rows


def _families(task: str) -> Rows:
    rows: Rows = [("Family", "Difficulties")]
    for family in task_families(task):
        rows.append((f"`{family}`", ", ".join(DIFFICULTIES if family == FAMILIES[0] else CROWDED)))
    return rows


def _info(task: str) -> Rows:
    """Return what the info of a first step holds, and of what type it is."""
    rows: Rows = [("Key", "Type", "In the first step of seed 3")]
    env = gymnasium.make(f"smp_gym/{task}Dense-v0", difficulty="none")
    env.reset(seed=3)
    *_, info = env.step(np.zeros(7, np.float32))
    env.close()
    for key, value in info.items():
        shown = f"array of {value.size}" if isinstance(value, np.ndarray) else f"`{value!r}`"
        rows.append((f"`{key}`", f"`{type(value).__name__}`", shown))
    return rows


TABLES: dict[str, Callable[..., Rows]] = {
    "action": _action,
    "families": _families,
    "goal": _goal,
    "ids": _ids,
    "info": _info,
    "keys": _keys,
    "obstacle": lambda: _fields(OBSTACLE_LAYOUT),
    "state": lambda: _fields(STATE_LAYOUT),
}
"""Functions of a task, or of nothing, that return the rows of a table, its head first."""


def markdown(rows: Rows) -> list[str]:
    """Return the lines of a table in Markdown."""
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]


class TaskTable(Directive):
    """The directive ``task-table``: a table's name, and a task where it is one of a task."""

    required_arguments = 1
    optional_arguments = 1
    has_content: ClassVar[bool] = False

    def run(self) -> list[nodes.Node]:
        """Return the table, parsed as the Markdown that it is."""
        name, *task = self.arguments
        section = nodes.Element()
        lines = markdown(TABLES[name](*task))
        self.state.nested_parse(StringList(lines, source=__file__), self.content_offset, section)
        return section.children


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("task-table", TaskTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
