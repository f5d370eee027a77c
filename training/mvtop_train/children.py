"""Pythons that a command starts: none runs a file of the current folder in place of a module.

By Python's own rule `-c` and `-m` look into the current folder first: a file `json.py` there would
be run. See docs/explanation/security.md.
"""

import os
import site
import subprocess
import sys
from pathlib import Path

from .errors import UserError

ROOT = str(Path(__file__).resolve().parents[1])  # from which this package is imported


def python(*arguments) -> list[str]:
    """The command that starts this Python with arguments."""
    return [sys.executable, "-P", *map(str, arguments)]


def environment() -> dict[str, str]:
    """What children find set, those that `multiprocessing` starts too: none looks into the current
    folder, and each finds this package where it is."""
    paths = list(filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)))
    found = [*paths, *site.getsitepackages(), site.getusersitepackages()]
    if ROOT not in map(os.path.realpath, found):
        paths.insert(0, ROOT)
    return {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(map(os.path.abspath, paths))}


def ended_well(command: list[str]):
    """Runs it; UserError where it ends in another way, of which it has told itself."""
    code = subprocess.run(command).returncode
    if code:
        name = " ".join(Path(part).name for part in command[:4] if part[0] != "-")
        raise UserError(
            f"{name}: expected it to end well, got exit code {code}; see above; fix: what it says, "
            "then the same command again, which goes on from there"
        )
