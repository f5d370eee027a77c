"""Lengths as people type them."""

from __future__ import annotations

import re

from mvtop._printable import refused

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
_LENGTH = re.compile(r"^\s*([0-9]*\.?[0-9]+)\s*([a-z]+)\s*$")


def metres(text: str) -> float:
    """Metres of "149.6mm", "15 cm", "0.2m" or "6in".

    Raises ValueError for a number without a unit, and what is no length above 0.
    """
    match = _LENGTH.match(text)
    if match is None or match[2] not in UNITS or not float(match[1]) > 0:
        raise refused(f"expected a length with its unit, as 149.6mm, got {text!r}")
    return float(match[1]) * UNITS[match[2]]
