"""The options of commands that play one episode, in one place, and the episode that they name."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from smp_planner.benchmark.cell_options import (
    Difficulty,
    Family,
    Latency,
    Lists,
    Noise,
    ReplanEvery,
    Sensing,
    chosen_cells,
    fail,
    replanning,
    requested_manifest,
)

if TYPE_CHECKING:
    from smp_gym.suites import Cell
    from smp_planner.benchmark.episodes import EpisodeKey
    from smp_planner.benchmark.manifest import Manifest

__all__ = ["plays_one_episode"]

_FIRST = ("manifest", "key")
"""Arguments of a command that its options are made into."""


def plays_one_episode(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of one episode, before those of its own.

    Args:
        command: takes the manifest of a run of that episode, its key, and its own options, all by
            name.
    """
    hints = get_type_hints(_one_episode, include_extras=True, localns=_named_only())
    own_hints = get_type_hints(command, include_extras=True, localns=_named_only())
    options = list(inspect.signature(_one_episode).parameters.values())
    own = [
        each for name, each in inspect.signature(command).parameters.items() if name not in _FIRST
    ]

    @functools.wraps(command)
    def played(**given: Any) -> None:
        named = {each.name: given.pop(each.name) for each in options}
        manifest, key = _one_episode(**named)
        command(manifest=manifest, key=key, **given)

    parameters = [
        each.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=found[each.name])
        for found, group in ((hints, options), (own_hints, own))
        for each in group
    ]
    # What is required comes first, or it would be no signature of positional parameters.
    parameters.sort(key=lambda each: each.default is not inspect.Parameter.empty)
    played.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    played.__annotations__ = {each.name: each.annotation for each in parameters}
    return played


def _named_only() -> dict[str, Any]:
    """Return names that annotations of commands may have and that are not imported yet."""
    return {"Manifest": Any, "EpisodeKey": Any}


def _one_episode(
    task: Annotated[str, typer.Option(help="Name of the task.")] = "Placement",
    method: Annotated[
        str,
        typer.Option(
            help="Name of the method, name=module:Class, or name=path.zip, which runs code."
        ),
    ] = "smp",
    difficulty: Difficulty = None,
    family: Family = None,
    sensing: Sensing = None,
    noise: Noise = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    half: Annotated[
        str,
        typer.Option(
            help="Half of a frozen list, witness or placed; the seed then names an episode of it."
        ),
    ] = "",
    lists: Lists = None,
    replan_every: ReplanEvery = None,
    latency: Latency = None,
) -> tuple[Manifest, EpisodeKey]:
    """Return the manifest of a run of one episode, and its key; ends the command on bad options."""
    from smp_planner.benchmark.episodes import EpisodeKey

    single: Mapping[str, Any] = {
        "difficulty": difficulty,
        "family": family,
        "sensing": sensing,
        "noise": noise,
    }
    replanned = replanning(replan_every, latency)
    (cell,) = chosen_cells("", (task,), (), single)
    if half:
        _check_listed(cell, half, seed, lists)
    elif lists is not None:
        raise fail("--lists needs --half, got it without", 2)
    manifest = requested_manifest((cell,), (method,), seed, 1, lists=lists, **replanned)
    return manifest, EpisodeKey.of(cell, manifest.methods[0], seed, half)


def _check_listed(cell: Cell, half: str, seed: int, lists: Path | None) -> None:
    """End the command unless the frozen list of a cell holds an episode."""
    from smp_gym.datasets.frozen import load_episodes

    try:
        seeds = [episode.seed for episode in load_episodes(cell, lists) if episode.half == half]
        if seed not in seeds:
            known = f"its seeds are {min(seeds)} to {max(seeds)}" if seeds else "it is empty"
            raise ValueError(
                f"no episode of seed {seed} in the half {half!r} of the frozen list of "
                f"{cell.name}; {known}"
            )
    except ValueError as error:
        raise fail(str(error), 2) from error
