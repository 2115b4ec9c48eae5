"""The methods by name: those of this package, those of installed packages, and the user's own.

A method is a name and a factory that makes a planner of demonstrations and settings. A spec names
one: a name of `PLANNERS`, a name of the entry-point group `smp_planner.methods`, or
``name=module:Class``, which needs no registration. A class from outside is called as
``Class(demonstrations, **settings)``; all that it must have is ``plan``.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from smp_gym.arrays import shown
from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.planners import PLANNERS, make_planner
from smp_planner.planning.problem import Planner

__all__ = [
    "GROUP",
    "Method",
    "check_name",
    "digest_of",
    "from_outside",
    "installed_methods",
    "installed_place",
    "known_methods",
    "resolve",
    "source_digest",
]

GROUP = "smp_planner.methods"
"""Group of entry points under which an installed package offers methods."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


@dataclass(frozen=True)
class Method:
    """A planning method: a name, and a factory of planners.

    Attributes:
        name: of the method in rows and files.
        spec: with which `resolve` finds it again, in other processes, too.
        factory: called with demonstrations and, by name, settings.
        digest: of the method's source files, wherever it lives.
    """

    name: str
    spec: str
    factory: Callable[..., Any]
    digest: str = ""

    def make(self, demonstrations: Demonstrations, settings: Mapping[str, Any]) -> Planner:
        """Return a planner that has learned from demonstrations.

        Args:
            demonstrations: what to learn from.
            settings: of the method by name; the rest keep their defaults.

        Raises:
            ValueError: a setting is unknown or out of range, or the factory made no planner.
        """
        try:
            inspect.signature(self.factory).bind(demonstrations, **settings)
        except TypeError as error:
            raise ValueError(
                f"method {self.name!r} must take demonstrations and the settings "
                f"{sorted(settings)}: {error}"
            ) from error
        planner = self.factory(demonstrations, **settings)
        if not isinstance(planner, Planner):
            raise ValueError(
                f"method {self.name!r} must make a planner, which has plan(problems); got "
                f"{type(planner).__name__}"
            )
        return planner

    def settings(self, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return all settings as JSON holds them: defaults and those given.

        Args:
            task: name of the task, which has settings of its own.
            given: settings by name.
        """
        if self.spec not in PLANNERS:
            return dict(given)
        return make_planner(self.spec, task, settings=given).settings


def known_methods() -> tuple[str, ...]:
    """Return the names of this package's own methods."""
    return tuple(PLANNERS)


def installed_methods() -> tuple[str, ...]:
    """Return the names of the methods that installed packages offer; imports none of them."""
    return tuple(sorted({entry.name for entry in metadata.entry_points(group=GROUP)}))


def resolve(spec: str) -> Method:
    """Return the method that a spec names, importing its module.

    Args:
        spec: a name of `known_methods` or `installed_methods`, or ``name=module:Class``.

    Raises:
        ValueError: no such name, module or class, a class that is no planner, or a name that is
            taken or holds other characters than letters, digits, ``_``, ``-`` and ``.``.
    """
    if not isinstance(spec, str):
        raise ValueError(f"method must be a name, got {shown(spec)}")
    name, own, place = spec.rpartition("=")
    if own:
        check_name(name, spec, place)
        return _planner_from_outside(name, spec, place)
    if spec in PLANNERS:
        return Method(spec, spec, partial(_make, spec), source_digest(__name__))
    if installed := installed_place(spec):
        return _planner_from_outside(spec, spec, installed)
    raise ValueError(
        f"unknown method {shown(spec)}; there are: "
        f"{', '.join((*known_methods(), *installed_methods()))}, or name=module:Class"
    )


def check_name(name: str, spec: str, place: str) -> None:
    """Raise ValueError unless a method of one's own may have a name.

    Args:
        name: of the method.
        spec: that gives it, for errors.
        place: where the method is, for errors.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(
            "the name of a method must be of letters, digits, '_', '-' and '.', "
            f"got {name!r} in {spec!r}"
        )
    if name in (*known_methods(), *installed_methods()):
        raise ValueError(f"the name {name!r} of a method is taken: give {place!r} another")


def _make(name: str, demonstrations: Demonstrations, **settings: Any) -> Planner:
    return make_planner(name, demonstrations=demonstrations, settings=settings)


def from_outside(name: str, place: str) -> Callable[..., Any]:
    """Return what is called ``module:Class``, importing the module.

    Args:
        name: of the method that it is, for errors.
        place: ``module:Class``.

    Raises:
        ValueError: no such module or class, or it cannot be called.
    """
    module, _, attribute = place.partition(":")
    if not (module and attribute.isidentifier()):
        raise ValueError(f"method {name!r} must be given as module:Class, got {place!r}")
    try:
        found = getattr(importlib.import_module(module), attribute, None)
    except ImportError as error:
        raise ValueError(f"method {name!r}: no module {module!r} to import: {error}") from error
    if found is None:
        raise ValueError(f"method {name!r}: the module {module!r} has no {attribute!r}")
    if not callable(found):
        raise ValueError(f"method {name!r}: {place!r} must be a class, got {shown(found)}")
    return found


def installed_place(name: str) -> str | None:
    """Return the ``module:Class`` that an installed package offers as a method, if one does."""
    found = [entry.value for entry in metadata.entry_points(group=GROUP) if entry.name == name]
    return found[0] if found else None


def digest_of(place: str) -> str:
    """Return the digest of the source files of a ``module:Class`` that has been imported."""
    module, _, attribute = place.partition(":")
    found = getattr(sys.modules[module], attribute)
    return source_digest(module, getattr(found, "__module__", module))


def _planner_from_outside(name: str, spec: str, place: str) -> Method:
    factory = from_outside(name, place)
    if inspect.isclass(factory) and not hasattr(factory, "plan"):
        raise ValueError(f"method {name!r}: {place!r} must be a planner, which has plan(problems)")
    return Method(name, spec, factory, digest_of(place))


def source_digest(*modules: str) -> str:
    """Return a digest of source files: of a module, or of the whole package that it is part of."""
    files: set[Path] = set()
    for name in modules:
        top = sys.modules[name.partition(".")[0]]
        for folder in getattr(top, "__path__", ()):
            files.update(Path(folder).rglob("*.py"))
        if not hasattr(top, "__path__") and top.__file__ is not None:
            files.add(Path(top.__file__))
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]
