"""Movement primitives adapted to new scenes by Stein variational gradient descent."""

from importlib.metadata import PackageNotFoundError, version

__all__ = ["__version__"]

try:
    __version__ = version("smp-gym")
except PackageNotFoundError:  # A checkout on the path that is not installed.
    __version__ = "unknown"
