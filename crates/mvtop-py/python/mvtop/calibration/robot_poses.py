"""Robot poses as files have them: CSV, JSON, or what ROS prints. Numbers first, their meaning
later.

What numbers mean (the order of a quaternion, the direction, the unit) a file may leave open: it
is then found by which reading is consistent with the images (`hand_eye.py`).
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop.calibration import rigid
from mvtop.calibration.boards import read_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

DIRECTIONS = ("base_from_hand", "hand_from_base")
UNITS = {"m": 1.0, "mm": 0.001}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUATERNION = {"q_wxyz": "wxyz", "q_xyzw": "xyzw"}
_NAMES = ("exposure", "name", "image", "id", "pose", "index", "stamp")


@dataclass(frozen=True, eq=False)
class RobotPoses:
    """Poses by exposure, as numbers."""

    form: str
    """"matrix", "quaternion" or "angles"."""
    rotation: str | None
    """What the numbers of a rotation are, a key of `ROTATIONS`, where the file says it."""
    direction: str | None
    unit: str | None
    numbers: dict[str, NDArray[np.float64]]
    """Place (3), then the rotation's numbers: 4, 3 or 9 in rows."""

    def read(self, rotation: str, direction: str, unit: str) -> dict[str, NDArray[np.float64]]:
        """base_from_hand (4, 4) by exposure, metres, as one reading has it."""
        found = {}
        for name, numbers in self.numbers.items():
            turn = ROTATIONS[rotation](numbers[3:])
            pose = rigid.rigid(turn, numbers[:3] * UNITS[unit])
            found[name] = pose if direction == DIRECTIONS[0] else rigid.inverse(pose)
        return found


def _about(axis: int, angle: float) -> NDArray[np.float64]:
    return rigid.exponential(np.eye(3)[axis] * angle)


def _fixed_xyz(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """About the fixed x, then y, then z."""
    return _about(2, v[2]) @ _about(1, v[1]) @ _about(0, v[0])


def _matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return rigid.mean_rotation(v.reshape(1, 3, 3))


ROTATIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "matrix": _matrix,
    "wxyz": rigid.from_quaternion,
    "xyzw": lambda v: rigid.from_quaternion(v[[3, 0, 1, 2]]),
    "rotvec": rigid.exponential,
    "rotvec_deg": lambda v: rigid.exponential(np.radians(v)),
    "rpy": _fixed_xyz,
    "rpy_deg": lambda v: _fixed_xyz(np.radians(v)),
    "abc_deg": lambda v: _fixed_xyz(np.radians(v[::-1])),
}
"""Rotation vectors (Universal Robots), roll, pitch, yaw about fixed x, y, z, and KUKA's A, B, C."""
FORMS = {
    "matrix": ("matrix",),
    "quaternion": ("wxyz", "xyzw"),
    "angles": ("rotvec", "rpy", "rotvec_deg", "rpy_deg", "abc_deg"),
}


def load(path: Path) -> RobotPoses:
    """Reads a file of poses.

    Raises OSError where it cannot be read, ValueError where it is refused.
    """
    text = read_text(path)
    try:
        if text.lstrip()[:1] in ("{", "["):
            return _json(text)
        if re.search(r"^\s*(position|translation)\s*:", text, re.M):
            return _ros(text)
        return _csv(text)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _json(text: str) -> RobotPoses:
    try:
        values = json.loads(text)
    except json.JSONDecodeError as cause:
        raise ValueError(f"expected JSON: {cause}") from None
    told = values if isinstance(values, dict) else {}
    direction, unit = told.get("direction"), told.get("unit")
    poses = told.get("poses", values)
    named = poses if isinstance(poses, dict) else None
    rows: list[tuple[str, Any]] = []
    if named is not None:
        rows = [(k, v) for k, v in named.items() if k not in ("direction", "unit", "format")]
    elif isinstance(poses, list):
        for index, entry in enumerate(poses):
            name = (
                next((entry[k] for k in _NAMES if k in entry), index)
                if isinstance(entry, dict)
                else index
            )
            rows.append((str(name), entry))
    forms, numbers = set(), {}
    for name, entry in rows:
        form, row, said = _entry(name, entry)
        direction, unit = direction or said, unit
        forms.add(form)
        numbers[str(name)] = row
    if len(forms) != 1:
        raise ValueError(f"expected poses of one form, got {', '.join(map(str, forms)) or 'none'}")
    form = forms.pop()
    kind = next(k for k, names in FORMS.items() if form in names or form == k)
    return RobotPoses(kind, None if form == kind != "matrix" else form, direction, unit, numbers)


def _entry(name: str, entry: Any) -> tuple[str, NDArray[np.float64], str | None]:
    """The form of a pose, its numbers, and the direction that its key says."""
    direction = None
    if isinstance(entry, dict):
        for key, said in (("T_base_hand", DIRECTIONS[0]), ("T_hand_base", DIRECTIONS[1])):
            if key in entry:
                direction, entry = said, entry[key]
                break
    if isinstance(entry, dict) and "pose" in entry and not isinstance(entry["pose"], (str, int)):
        entry = entry["pose"]
    if isinstance(entry, dict):
        place = entry.get("t", entry.get("position", entry.get("translation")))
        if isinstance(place, dict):
            place = [place[k] for k in "xyz"]
        for key, form in (
            *_QUATERNION.items(),
            ("rotvec", "rotvec"),
            ("rpy", "rpy"),
            ("R", "matrix"),
        ):
            if key in entry and place is not None:
                return form, _numbers(name, [*place, *np.ravel(entry[key])]), direction
        turn = entry.get("orientation", entry.get("rotation"))
        if isinstance(turn, dict) and place is not None:
            return "xyzw", _numbers(name, [*place, *(turn[k] for k in "xyzw")]), direction
        if isinstance(turn, list) and place is not None:
            form = {3: "angles", 4: "quaternion"}.get(len(turn), "matrix")
            return form, _numbers(name, [*place, *np.ravel(turn)]), direction
        raise ValueError(
            f"pose `{name}`: expected a 4x4 matrix, or `t` with `q_wxyz`, `q_xyzw`, `rotvec`, "
            f"`rpy` or "
            f"`R`, got the keys {', '.join(entry)}"
        )
    flat = np.ravel(np.array(entry, float))
    if flat.size == 16:
        matrix = flat.reshape(4, 4)
        return "matrix", np.r_[matrix[:3, 3], matrix[:3, :3].ravel()], direction
    if flat.size in (6, 7):
        return ("angles", "quaternion")[flat.size - 6], _numbers(name, flat), direction
    raise ValueError(f"pose `{name}`: expected 16, 7 or 6 numbers, got {flat.size}")


def _ros(text: str) -> RobotPoses:
    """Poses or transforms as `ros2 topic echo` prints them, one document each."""
    numbers = {}
    for index, document in enumerate(
        d for d in re.split(r"^---\s*$", text, flags=re.M) if d.strip()
    ):
        row = []
        for keys, axes in (("position|translation", "xyz"), ("orientation|rotation", "xyzw")):
            match = re.search(rf"^\s*(?:{keys})\s*:\s*(.*(?:\n\s+[xyzw]\s*:.*)+)", document, re.M)
            part = match[1] if match else ""
            for axis in axes:
                value = re.search(rf"\b{axis}\s*:\s*({_NUMBER})", part)
                if value is None:
                    raise ValueError(f"document {index}: expected `{axis}` of {keys.split('|')[0]}")
                row.append(float(value[1]))
        name = re.search(r"^(?:exposure|name)\s*:\s*['\"]?([^'\"\n]+)", document, re.M)
        numbers[name[1].strip() if name else f"{index}"] = _numbers(str(index), row)
    return RobotPoses("quaternion", "xyzw", None, "m", numbers)


def _csv(text: str) -> RobotPoses:
    dialect = ";" if ";" in text.splitlines()[0] else "," if "," in text.splitlines()[0] else None
    lines = [
        line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    rows = (
        list(csv.reader(lines, delimiter=dialect)) if dialect else [line.split() for line in lines]
    )
    rows = [[cell.strip() for cell in row] for row in rows]
    if not rows:
        raise ValueError("expected a pose in each line, got none")
    header = None if all(map(_is_number, rows[0][1:])) else [c.lower() for c in rows.pop(0)]
    unit = None
    if header is not None:
        return _with_header(header, rows)
    numbers, counts = {}, set()
    for index, row in enumerate(rows):
        cells = row[1:] if len(row) in (8, 17) or not _is_number(row[0]) else row
        name = row[0] if len(cells) < len(row) else str(index)
        counts.add(len(cells))
        _, numbers[name], _ = _entry(name, [_float(cell, index) for cell in cells])
    if len(counts) != 1:
        raise ValueError(f"expected as many numbers in each line, got {sorted(counts)}")
    form = {16: "matrix", 7: "quaternion", 6: "angles"}[counts.pop()]
    return RobotPoses(form, "matrix" if form == "matrix" else None, None, unit, numbers)


_HEADERS = {
    "wxyz": ("qw", "qx", "qy", "qz"),
    "rotvec": ("rx", "ry", "rz"),
    "rpy": ("roll", "pitch", "yaw"),
    "rpy_deg": ("roll_deg", "pitch_deg", "yaw_deg"),
    "abc_deg": ("a", "b", "c"),
}


def _with_header(header: list[str], rows: list[list[str]]) -> RobotPoses:
    unit = next((u for u in UNITS if f"x_{u}" in header), None)
    suffix = f"_{unit}" if unit else ""
    place = next(
        (p for p in ([f"{a}{suffix}" for a in "xyz"], ["tx", "ty", "tz"]) if set(p) <= set(header)),
        None,
    )
    rotation = next((form for form, names in _HEADERS.items() if set(names) <= set(header)), None)
    if place is None or rotation is None:
        forms = "; ".join(", ".join(names) for names in _HEADERS.values())
        raise ValueError(
            f"expected columns x, y, z and one of {forms}, got {', '.join(header)}; fix: name "
            f"them so, or "
            "leave the header out"
        )
    at = [header.index(c) for c in (*place, *_HEADERS[rotation])]
    name_at = next((header.index(n) for n in _NAMES if n in header), None)
    numbers = {}
    for index, row in enumerate(rows):
        if len(row) != len(header):
            raise ValueError(f"line {index + 2}: expected {len(header)} cells, got {len(row)}")
        name = str(index) if name_at is None else row[name_at]
        numbers[name] = _numbers(name, [_float(row[i], index) for i in at])
    kind = next(k for k, names in FORMS.items() if rotation in names)
    # Angles without their unit in their names are any of those.
    said = rotation if kind == "quaternion" or rotation.endswith("_deg") else None
    return RobotPoses(kind, said, None, unit, numbers)


def _numbers(name: str, row: Any) -> NDArray[np.float64]:
    numbers = np.array(row, float)
    if not np.isfinite(numbers).all() or numbers.size not in (6, 7, 12):
        raise ValueError(f"pose `{name}`: expected a place and a rotation, got {list(row)}")
    if numbers.size == 7 and abs(np.linalg.norm(numbers[3:]) - 1) > 1e-2:
        raise ValueError(
            f"pose `{name}`: expected a quaternion of length 1, got "
            f"{np.linalg.norm(numbers[3:]):.3f}"
        )
    return numbers


def _is_number(cell: str) -> bool:
    return re.fullmatch(_NUMBER, cell) is not None


def _float(cell: str, index: int) -> float:
    if not _is_number(cell):
        raise ValueError(f"pose {index}: expected a number, got {cell!r}")
    return float(cell)
