"""The packages of the extra `mvtop[calibrate]`, or one sentence that names it."""

from __future__ import annotations

import importlib
from typing import Any

EXTRA = "pip install 'mvtop[calibrate]'"


def opencv() -> Any:
    """The module `cv2`.

    Raises ModuleNotFoundError with the fix where it is missing.
    """
    return _load("cv2", "OpenCV")


def optimize() -> Any:
    """The module `scipy.optimize`, likewise."""
    return _load("scipy.optimize", "SciPy")


def _load(module: str, name: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            f"calibration needs {name}, which is not installed; fix: {EXTRA}"
        ) from None
