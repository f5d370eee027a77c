"""What the package carries: run configs and rigs, found by name (`parts`, `tiny`, `four`), and the
bundle that own parts are learnt from."""

import argparse
from pathlib import Path

from .errors import UserError

FOLDER = Path(__file__).with_name("runs")
CONFIG, RIG = ".toml", ".rig.json"
START = Path(__file__).with_name("start")  # graphs of models/parts


def names(ending: str) -> list[str]:
    return sorted(path.name.removesuffix(ending) for path in FOLDER.glob(f"*{ending}"))


def config(given: str | Path) -> Path:
    """The run config of `--config`, a file or a name."""
    return _found(given, "--config", CONFIG)


def rig(given: str | Path) -> Path:
    """The rig of `--rig`, a file or a name."""
    return _found(given, "--rig", RIG)


def _found(given: str | Path, option: str, ending: str) -> Path:
    """A file comes first; what looks like a path is left to its reader, which refuses it."""
    path = Path(given)
    if path.exists() or path.name != str(given) or path.suffix:
        return path
    if path.name not in (known := names(ending)):
        raise UserError(
            f"{option}: expected a file or one of {', '.join(known)}, got {str(given)!r}; "
            f"fix: the path of a *{ending} file, or one of these names"
        )
    return FOLDER / f"{path.name}{ending}"


class ConfigParser(argparse.ArgumentParser):
    """Reads `--config` as a file or a name."""

    def parse_args(self, args=None, namespace=None):
        found = super().parse_args(args, namespace)
        if found.config is not None:
            found.config = config(found.config)
        return found
