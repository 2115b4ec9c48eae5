"""The decorator of all compiled kernels, and the cache of their machine code.

numba's own cache stamps only the file of a function, but compiles into it what the function calls
in other files: after an edit or an upgrade old code would run on. Here the key of an entry is a
digest of all kernel sources, and of the code and the constants that the kernel itself compiles in.
A cache that cannot be read or written costs compiling anew, never a wrong result.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import multiprocessing
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core import config
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps, loads
from numba.misc.appdirs import AppDirs

__all__ = ["FAST", "kernel"]

FAST = {"reassoc", "contract", "arcp", "nsz"}
"""Fast mathematics, but for the assumption that NaN and infinity do not occur."""

_LOGGER = logging.getLogger(__name__)

_MARK = b"@kernel"
_KEPT = 3
"""Digests whose entries are kept, so that changing branches does not compile all anew."""


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function to machine code at its first call, and keep it for later processes.

    A decorator, with or without options. The compiled function gives up the interpreter's lock.
    Entries lie in `NUMBA_CACHE_DIR` if that is set, else in the `__pycache__` of the function's
    package, else in the user's cache directory; entries of all but the newest `_KEPT` digests are
    removed when a new digest is written. The first compiling of a process is announced on the
    screen, in terminals and notebooks.

    Args:
        function: what to compile; it may call other kernels and use constants of its module.
        options: as of `numba.njit`, e.g. ``fastmath``.

    Returns:
        The compiled function, or a decorator that makes it.
    """
    if function is None:
        return functools.partial(kernel, **options)
    compiled = numba.njit(nogil=True, **options)(function)
    if isinstance(compiled, Dispatcher):
        compiled._cache = _KernelCache(compiled)  # type: ignore[attr-defined]
    return compiled


class _KernelCache(_Cache):
    """The compiled signatures of one kernel, each in a file of its own, written at once or not."""

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher
        self._enabled = True

    @functools.cached_property
    def _folder(self) -> _Folder:
        return _folder(_root(self._dispatcher.py_func))

    @functools.cached_property
    def _digest(self) -> str:
        hasher = hashlib.sha256()
        for part in _compiled_in(self._dispatcher, set()):
            hasher.update(part)
        return hasher.hexdigest()

    @property
    def cache_path(self) -> str | None:
        return None if self._folder.path is None else str(self._folder.path)

    def enable(self) -> None:
        self._enabled = True

    def disable(self) -> None:
        self._enabled = False

    def flush(self) -> None:
        function = self._dispatcher.py_func
        for path in self._folder.path.glob(_name(function, "*")) if self._folder.path else ():
            path.unlink(missing_ok=True)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        if not self._enabled or self._folder.path is None:
            return None
        target_context.refresh()
        name, key = self._entry(sig, target_context.codegen())
        try:
            content = (self._folder.path / name).read_bytes()
        except OSError:
            _announce()
            return None
        try:
            stamp, body = content[:32], content[32:]
            if hashlib.sha256(body).digest() != stamp:
                raise ValueError("is torn")
            found, reduced = loads(body)
            return CompileResult._rebuild(target_context, *reduced) if found == key else None
        except Exception as error:
            self._folder.warn(f"compiling {name} again, which cannot be read: {error}")
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if not self._enabled or self._folder.path is None:
            return
        if data.library.has_dynamic_globals or not all(lift.can_cache for lift in data.lifted):
            return
        name, key = self._entry(sig, data.codegen)
        try:
            body = dumps((key, data._reduce()))
            self._folder.write(name, hashlib.sha256(body).digest() + body)
        except Exception as error:
            self._folder.warn(f"compiled {name} for this process only, it cannot be kept: {error}")

    def _entry(self, sig: Any, codegen: Any) -> tuple[str, Any]:
        """Return file name and key of one signature."""
        key = (sig, codegen.magic_tuple(), sys.version, numba.__version__, self._digest)
        text = repr((str(sig), *key[1:]))
        return _name(self._dispatcher.py_func, hashlib.sha256(text.encode()).hexdigest()[:16]), key


@functools.cache
def _announce() -> None:
    """Say once on the screen, where somebody is watching, why nothing seems to happen."""
    watched = "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())
    if watched and multiprocessing.parent_process() is None:
        print(
            "compiling for the first use of this version, up to half a minute; kept for later",
            file=sys.stderr,
            flush=True,
        )


def _name(function: Callable[..., Any], key: str) -> str:
    qualified = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
    return f"{qualified}-{key}.nbc"


class _Folder:
    """The cache folder of one package's kernels, named by a digest of their sources.

    Attributes:
        path: the folder of this digest, or None if none can be written.
    """

    def __init__(self, root: Path) -> None:
        self._warned = False
        self._begun = False
        place = hashlib.sha256(str(root).encode()).hexdigest()[:16]
        named = getattr(config, "CACHE_DIR", "")
        package = root if root.is_dir() else root.parent
        homes = [
            *([Path(named) / f"{root.stem}-{place}"] if named else []),
            package / "__pycache__",
            Path(AppDirs("smp_gym", appauthor=False).user_cache_dir) / f"{root.stem}-{place}",
        ]
        home = next(filter(_writable, homes), None)
        own = Path(__file__).resolve().parent
        digest = _sources_digest(tuple(sorted({own, root})))
        self.path = None if home is None else home / f"kernels-{digest}"
        if home is None:
            self.warn(f"kernels are compiled in each process: none of {homes} can be written")

    def warn(self, message: str) -> None:
        """Log the first complaint of this process."""
        if not self._warned:
            _LOGGER.warning(message)
        self._warned = True

    def write(self, name: str, content: bytes) -> None:
        """Write a file at once; the first of a digest removes what older ones have left."""
        assert self.path is not None
        if not self._begun:
            self._begun = True
            self.path.mkdir(parents=True, exist_ok=True)
            os.utime(self.path)
            others = [path for path in self.path.parent.glob("kernels-*") if path != self.path]
            for path in sorted(others, key=_age)[_KEPT - 1 :]:
                shutil.rmtree(path, ignore_errors=True)
        self.path.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=self.path)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, self.path / name)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise


_folder = functools.cache(_Folder)


def _age(path: Path) -> float:
    try:
        return -path.stat().st_mtime
    except OSError:
        return 0.0


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _root(function: Callable[..., Any]) -> Path:
    """Return the folder of a function's top package; its file if it belongs to none."""
    package = sys.modules.get(function.__module__.partition(".")[0])
    file = Path(function.__code__.co_filename).resolve()
    for folder in getattr(package, "__path__", ()):
        if Path(folder).resolve() in file.parents:
            return Path(folder).resolve()
    return file


def _sources_digest(roots: tuple[Path, ...]) -> str:
    """Return a digest of all files below the roots that have kernels in them."""
    hasher = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for root in roots:
        for path in sorted(root.rglob("*.py")) if root.is_dir() else filter(Path.exists, [root]):
            content = path.read_bytes()
            if _MARK in content:
                hasher.update(repr((path.name, content)).encode())
    return hasher.hexdigest()[:16]


def _compiled_in(value: Any, seen: set[int]) -> Iterator[bytes]:
    """Yield all that makes up the machine code of a kernel: code, callees, constants, options."""
    if isinstance(value, Dispatcher):
        yield from _compiled_in(tuple(sorted(value.targetoptions.items())), seen)
        value = value.py_func
    if id(value) in seen:
        return
    if isinstance(value, FunctionType):
        seen.add(id(value))
        yield from _of_code(value.__code__, value.__globals__, seen)
        for cell in value.__closure__ or ():
            yield from _compiled_in(cell.cell_contents, seen)
        for default in value.__defaults__ or ():
            yield from _compiled_in(default, seen)
    elif isinstance(value, np.ndarray):
        yield repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    elif isinstance(value, tuple | set | frozenset):
        parts = value if isinstance(value, tuple) else sorted(value, key=repr)
        yield repr(len(parts)).encode()
        for part in parts:
            yield from _compiled_in(part, seen)
    elif isinstance(value, bool | int | float | complex | str | bytes | np.generic | None):
        yield repr((type(value).__name__, value)).encode()
    else:
        yield repr((type(value).__name__, getattr(value, "__qualname__", None))).encode()


def _of_code(code: CodeType, names: dict[str, Any], seen: set[int]) -> Iterator[bytes]:
    yield code.co_code + repr((code.co_name, code.co_names, code.co_varnames)).encode()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _of_code(constant, names, seen)
        else:
            yield from _compiled_in(constant, seen)
    for name in code.co_names:
        value = names.get(name)
        if isinstance(value, ModuleType):
            if value.__name__.partition(".")[0] in ("math", "numba", "numpy"):
                continue
            for attribute in code.co_names:
                yield from _compiled_in(getattr(value, attribute, None), seen)
        else:
            yield from _compiled_in(value, seen)
