"""Where the installed onnxruntime package has its library."""

import importlib.util
import os
import re
from pathlib import Path


def library() -> Path | None:
    """The library of the package `onnxruntime`, which is not imported.

    None where $ORT_DYLIB_PATH names another one, and where there is no such package: then the core
    searches, and says what to do where it finds nothing.
    """
    if os.environ.get("ORT_DYLIB_PATH"):
        return None
    package = importlib.util.find_spec("onnxruntime")
    for folder in (package and package.submodule_search_locations) or ():
        for name in ("libonnxruntime.so*", "libonnxruntime.*dylib", "onnxruntime.dll"):
            if found := max(Path(folder, "capi").glob(name), key=_version, default=None):
                return found
    return None


def _version(library: Path) -> list[int]:
    return [int(digits) for digits in re.findall(r"\d+", library.name)]
