"""Kalibr's target files: a few lines of YAML, `key: value` each."""

from __future__ import annotations

import re
from typing import Any

from mvtop._printable import refused

_LINE = re.compile(r"^\s*([A-Za-z_]+)\s*:\s*(['\"]?)([^#'\"]*)\2\s*(#.*)?$")


def kalibr_target(text: str) -> dict[str, Any] | None:
    """What a board file would say of the target; None where the text is none of Kalibr's.

    Raises ValueError for a target of another kind.
    """
    found = {}
    for line in text.splitlines():
        if match := _LINE.match(line):
            found[match[1]] = match[3].strip()
    if "target_type" not in found:
        return None
    head: dict[str, Any] = {"format": "mvtop-board", "version": 1, "unit": "m"}
    try:
        if found["target_type"] == "aprilgrid":
            tag = float(found["tagSize"])
            return head | {
                "kind": "aprilgrid",
                "columns": int(found["tagCols"]),
                "rows": int(found["tagRows"]),
                "tag": tag,
                "gap": round(tag * float(found["tagSpacing"]), 9),
                "first_id": int(found.get("startId", 0)),
                "from": "bottom",
                "border": 2,
            }
        if found["target_type"] == "checkerboard":
            sides = [float(found[f"{way}SpacingMeters"]) for way in ("row", "col")]
            if sides[0] != sides[1]:
                raise ValueError("squares of Kalibr's checkerboard: expected as high as wide")
            # Kalibr counts inner corners.
            counts = {"columns": int(found["targetCols"]) + 1, "rows": int(found["targetRows"]) + 1}
            return head | {"kind": "chessboard", "square": sides[0]} | counts
    except KeyError as missing:
        raise refused(f"Kalibr's target file: expected the key {missing}, got none") from None
    kind = found["target_type"]
    raise refused(f"`target_type`: expected aprilgrid or checkerboard, got {kind!r}")
