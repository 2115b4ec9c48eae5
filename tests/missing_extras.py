"""Run every script without some extras, each in a copy of this process; prints JSON.

    python tests/missing_extras.py FOLDER MODULES LOADED

`MODULES` are refused, by script, as JSON; those of `LOADED` are imported before, so that the copies
need not.
"""

import importlib
import json
import os
import runpy
import sys
import tempfile
from pathlib import Path


class Refusing:
    """A finder that finds some modules to be missing."""

    def __init__(self, names):
        self._names = set(names)

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in self._names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def run(path, refused):
    """Return exit status and standard error of a script that is asked for help."""
    with tempfile.TemporaryFile("w+") as said:
        child = os.fork()
        if child == 0:
            os.dup2(said.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            sys.meta_path.insert(0, Refusing(refused))
            sys.argv = [str(path), "--help"]
            status = 0
            try:
                runpy.run_path(str(path), run_name="__main__")
            except SystemExit as end:
                status = end.code or 0
            except BaseException:
                sys.excepthook(*sys.exc_info())
                status = 1
            sys.stderr.flush()
            os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said.seek(0)
        return status, said.read()


if __name__ == "__main__":
    folder, modules, loaded = Path(sys.argv[1]), json.loads(sys.argv[2]), json.loads(sys.argv[3])
    for name in loaded:
        importlib.import_module(name)
    print(json.dumps({name: run(folder / name, refused) for name, refused in modules.items()}))
