"""Results of a long computation, kept as they come: the same command continues it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from smp_planner.benchmark.manifest import code_digest
from smp_planner.benchmark.options import pooled
from smp_planner.benchmark.results_folder import ResultsError, write_json

__all__ = ["kept_results"]

Item = TypeVar("Item")


def kept_results(
    path: Path,
    terms: Mapping[str, Any],
    function: Callable[[Item], Any],
    items: Mapping[str, Item],
    title: str,
    console: Console,
    jobs: int,
) -> dict[str, Any]:
    """Return a function's result for each item: those that a file holds, and the others computed.

    The file holds every result from the moment on that it is there. It may hold more than is asked
    for, such as the scenes of an earlier call.

    Args:
        path: JSON file, made if it is missing.
        terms: what results must agree in to stand in one file beside the project's code, as JSON
            holds it.
        function: of a module, since worker processes import it anew; its results are JSON.
        items: an argument for each call, by a name that is unique under these terms.
        title: of the progress bar.
        console: to show it on.
        jobs: worker processes.

    Returns:
        The results by name, in the order of the items.

    Raises:
        ResultsError: the file is damaged, or holds results of other terms or other code.
    """
    terms = {**terms, "code": code_digest()}
    results = _read(path, terms) if path.exists() else {}
    missing = [name for name in items if name not in results]
    if missing:
        path.parent.mkdir(parents=True, exist_ok=True)
        names = iter(missing)

        def keep(result: Any) -> None:
            results[next(names)] = result
            write_json(path, {"terms": terms, "results": results})

        chosen = [items[name] for name in missing]
        pooled(function, chosen, title, console, jobs=jobs, on_result=keep)
    return {name: results[name] for name in items}


def _read(path: Path, terms: Mapping[str, Any]) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        there, results = content["terms"], content["results"]
        if not isinstance(results, dict):
            raise TypeError(f"results must be an object, got {type(results).__name__}")
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ResultsError(f"{path} is not a file of kept results: {error}") from error
    if there != json.loads(json.dumps(dict(terms))):
        raise ResultsError(
            f"{path} holds results of other terms and is left as it is; choose another folder: "
            f"{there} there, {dict(terms)} now"
        )
    return results
