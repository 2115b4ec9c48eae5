"""Paths of packaged data."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

__all__ = ["asset_path", "jaco_urdf"]


def asset_path(*parts: str) -> Path:
    """Return the path of a data file of the `envs_assets` package, by its folder and name."""
    return Path(str(resources.files("envs_assets").joinpath(*parts)))


def jaco_urdf(*, pen: bool = False) -> Path:
    """Return the path of the arm's URDF, with or without a pen fixed to the hand."""
    return asset_path("jaco", "jaco_pen.urdf" if pen else "jaco.urdf")
