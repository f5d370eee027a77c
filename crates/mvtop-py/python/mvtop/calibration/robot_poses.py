"""Robot poses as files have them: CSV, JSON, or what ROS prints. Numbers first, their meaning
later.

What numbers mean (the order of a quaternion, the direction, the unit) a file may leave open: it
is then found by which reading is consistent with the images (`hand_eye.py`).
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mvtop._printable import refused
from mvtop.calibration import rigid, robot_numbers
from mvtop.calibration.boards import read_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

DIRECTIONS = ("base_from_hand", "hand_from_base")
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TURN = 2 * np.pi + 1e-3
"""Greater angles are no radians."""
_NAMES = ("exposure", "name", "image", "id", "pose", "index", "stamp")
_HARMLESS = ("time", "stamp", "seq", "joint", "note", "comment", "speed", "gripper")
"""Words in keys that say nothing of a pose."""


@dataclass(frozen=True, eq=False)
class RobotPoses:
    """Poses by exposure, as numbers."""

    form: str
    """A key of `FORMS`."""
    rotation: str | None
    """What the numbers of a rotation are, a key of `ROTATIONS`, where the file says it."""
    direction: str | None
    unit: str | None
    numbers: dict[str, NDArray[np.float64]]
    """Place (3), then the rotation's numbers: 4, 3 or 9 in rows."""

    def read(self, rotation: str, direction: str, unit: str) -> dict[str, NDArray[np.float64]]:
        """base_from_hand (4, 4) by exposure, metres, as one reading has it.

        Raises ValueError for a reading that `readings` refuses.
        """
        self.readings(rotation, direction, unit)
        found = {}
        for name, numbers in self.numbers.items():
            turn = ROTATIONS[rotation](numbers[3:])
            pose = rigid.rigid(turn, numbers[:3] * UNITS[unit])
            found[name] = pose if direction == DIRECTIONS[0] else rigid.inverse(pose)
        return found

    def readings(
        self, rotation: str | None = None, direction: str | None = None, unit: str | None = None
    ) -> tuple[list[str], list[str], list[str]]:
        """Rotations, directions and units that the file and what is asked for leave open.

        Raises ValueError where both contradict, or one says what is not known.
        """
        rotation = _said("rotation", FORMS[self.form], self.rotation, rotation)
        direction = _said("direction", DIRECTIONS, self.direction, direction)
        unit = _said("unit", tuple(UNITS), self.unit, unit)
        return (
            self._rotations(rotation),
            [direction] if direction else list(DIRECTIONS),
            [unit] if unit else list(UNITS),
        )

    def _rotations(self, said: str | None) -> list[str]:
        names = [said] if said else list(FORMS[self.form])
        if self.form in ("matrix", "quaternion"):
            return names
        greatest = max((np.abs(row[3:]).max() for row in self.numbers.values()), default=0.0)
        if greatest <= _TURN:
            return names
        if said and not said.endswith("_deg"):
            raise refused(
                f"rotation: expected radians of {said} up to 2 pi, got {greatest:g}; fix: say "
                f"{said}_deg where they are degrees"
            )
        return [name for name in names if name.endswith("_deg")]


def _said(what: str, known: Sequence[str], of_file: str | None, asked: str | None) -> str | None:
    """What the file says, or is asked for."""
    for value in (of_file, asked):
        if value is not None and value not in known:
            raise refused(f"{what} of poses: expected {' or '.join(known)}, got {value!r}")
    if of_file and asked and of_file != asked:
        raise refused(
            f"{what} of poses: expected {of_file}, as their file has it, got {asked}; fix: leave "
            f"--{what} out, or correct the file"
        )
    return asked or of_file


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
    "rotvec": ("rotvec", "rotvec_deg"),
    "rpy": ("rpy", "rpy_deg"),
}
"""What numbers may be, by what is known of them; angles that do not say their unit are open."""
_NAMED_FORMS = {
    "q_wxyz": ("quaternion", "wxyz"),
    "q_xyzw": ("quaternion", "xyzw"),
    "rotvec": ("rotvec", None),
    "rotvec_rad": ("rotvec", "rotvec"),
    "rotvec_deg": ("rotvec", "rotvec_deg"),
    "rpy": ("rpy", None),
    "rpy_rad": ("rpy", "rpy"),
    "rpy_deg": ("rpy", "rpy_deg"),
    "abc_deg": ("angles", "abc_deg"),
    "R": ("matrix", "matrix"),
}
_PLACES = ("t", "position", "translation")
_TURNS = (*_NAMED_FORMS, "orientation", "rotation")
_HEAD = ("format", "version", "unit", "direction")
_WRAPPED = {"T_base_hand": DIRECTIONS[0], "T_hand_base": DIRECTIONS[1], "pose": None}


class _Pose(NamedTuple):
    form: str
    rotation: str | None
    direction: str | None
    """What its key says."""
    numbers: NDArray[np.float64]


def load(path: Path) -> RobotPoses:
    """Reads a file of poses.

    Raises OSError where it cannot be read, ValueError where it is refused.
    """
    text = read_text(path)
    try:
        poses = _read(text)
        poses.readings()
    except ValueError as error:
        raise refused(f"{path}: {error}") from None
    return poses


def _read(text: str) -> RobotPoses:
    if text.lstrip()[:1] in ("{", "["):
        return _json(text)
    if re.search(r"^[\s-]*(position|translation)\s*:", text, re.M):
        return _ros(text)
    return _csv(text)


def _once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """A dictionary of what has its own name each."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise refused(
                f"`{name}`: expected each name once, got it twice; fix: rename or remove one"
            )
        found[name] = value
    return found


def _json(text: str) -> RobotPoses:
    try:
        values = json.loads(text, object_pairs_hook=_once)
    except json.JSONDecodeError as cause:
        raise refused(f"expected JSON: {cause}") from None
    head, poses = {}, values
    if isinstance(values, dict):
        head = {key: values[key] for key in _HEAD if key in values}
        poses = {key: value for key, value in values.items() if key not in head}
        if "poses" in poses:
            _only(poses, ("poses",), (*_HEAD, "poses"), "keys beside `poses`")
            poses = poses["poses"]
    if isinstance(poses, list):
        named = _once((_name(entry, index), entry) for index, entry in enumerate(poses))
    elif isinstance(poses, dict):
        named = poses
    else:
        raise refused(f"`poses`: expected poses by name or a list, got {poses!r:.60}")
    read = {name: _entry(name, entry) for name, entry in named.items()}
    return _of_one_kind(read, head.get("direction"), head.get("unit"))


def _only(given: Iterable[str], known: Iterable[str], named: Iterable[str], whose: str) -> None:
    """Refuses keys that nothing reads, as they may say what numbers mean."""
    others = set(given) - set(known)
    if unknown := sorted(
        key for key in others if not any(word in key.lower() for word in _HARMLESS)
    ):
        raise refused(
            f"{whose}: expected {', '.join(named)}, got `{unknown[0]}`; fix: leave it out, or name "
            f"it as one of these"
        )


def _is_name(value: Any) -> bool:
    return isinstance(value, (str, int, float)) and not isinstance(value, bool)


def _name(entry: Any, index: int) -> str:
    if not isinstance(entry, dict):
        return str(index)
    return str(next((entry[k] for k in _NAMES if _is_name(entry.get(k))), index))


def _of_one_kind(poses: dict[str, _Pose], direction: Any, unit: Any) -> RobotPoses:
    """Poses whose form, rotation and direction are the same."""
    direction = _said("direction", DIRECTIONS, direction, None)
    forms = {f"{pose.form} ({pose.rotation or 'open'})" for pose in poses.values()}
    if len(forms) != 1:
        raise refused(f"expected poses of one form, got {', '.join(sorted(forms)) or 'none'}")
    told = {pose.direction or direction for pose in poses.values()}
    told |= {direction} if direction else set()
    if len(told) != 1:
        got = " and ".join(sorted(value or "none" for value in told))
        raise refused(
            f"direction of poses: expected one of the file and all its poses, got {got}; fix: "
            f"give all as T_base_hand, or all as T_hand_base"
        )
    first = next(iter(poses.values()))
    numbers = {name: pose.numbers for name, pose in poses.items()}
    return RobotPoses(first.form, first.rotation, told.pop(), unit, numbers)


def _entry(name: str, entry: Any) -> _Pose:
    if not isinstance(entry, dict):
        form, row = robot_numbers.flat(name, entry)
        return _Pose(form, "matrix" if form == "matrix" else None, None, row)
    known = (*_WRAPPED, *_PLACES, *_TURNS)
    _only(entry, (*known, *_NAMES), known, f"pose `{name}`")
    given = [key for key in entry if key in known and key not in _NAMES]
    if "pose" in entry and not _is_name(entry["pose"]):
        given.append("pose")
    place, turn = (next((k for k in keys if k in given), "") for keys in (_PLACES, _TURNS))
    if len(given) == 1 and given[0] in _WRAPPED:
        return _wrapped(name, given[0], entry[given[0]])
    if len(given) == 2 and place and turn:
        form, rotation, value = _turn(name, turn, entry[turn])
        place = _axes(name, entry[place], "xyz")
        return _Pose(form, rotation, None, robot_numbers.pose(name, form, place, value))
    raise refused(
        f"pose `{name}`: expected a 4x4 matrix, or `t` with one of {', '.join(_NAMED_FORMS)}, got "
        f"the keys {', '.join(given) or 'none'}"
    )


def _wrapped(name: str, key: str, entry: Any) -> _Pose:
    pose, direction = _entry(name, entry), _WRAPPED[key]
    if pose.direction and direction:
        raise refused(f"pose `{name}`: expected one direction, got one in the other")
    return pose._replace(direction=pose.direction or direction)


def _turn(name: str, key: str, value: Any) -> tuple[str, str | None, Any]:
    """The form, what is known of the rotation, and its numbers."""
    if key in _NAMED_FORMS:
        return *_NAMED_FORMS[key], value
    if isinstance(value, dict):
        return "quaternion", "xyzw", _axes(name, value, "xyzw")
    numbers = robot_numbers.numbers(name, value, 9, 4, 3)
    form = {9: "matrix", 4: "quaternion", 3: "angles"}[numbers.size]
    return form, "matrix" if form == "matrix" else None, numbers


def _axes(name: str, part: Any, axes: str) -> Any:
    """Numbers of a message of ROS, or those that are no message."""
    if not isinstance(part, dict):
        return part
    if sorted(part) != sorted(axes):
        raise refused(
            f"pose `{name}`: expected the keys {', '.join(axes)}, got {', '.join(part) or 'none'}"
        )
    return [part[axis] for axis in axes]


def _ros(text: str) -> RobotPoses:
    """Poses or transforms as `ros2 topic echo` prints them, one document each."""
    documents = [d for d in re.split(r"^---\s*$", text, flags=re.M) if d.strip()]
    rows, frames = [], set()
    for index, document in enumerate(documents):
        if stated := re.search(r"^(units?|direction)\s*:", document, re.M):
            raise refused(
                f"document {index}: expected metres, as ROS has them, and no `{stated[1]}`; fix: "
                f"leave it out, or write the poses as CSV or JSON"
            )
        frames.add(tuple(re.findall(r"^[\s-]*((?:child_)?frame_id\s*:.*)", document, re.M)))
        place = _ros_part(index, document, ("position", "translation"), "xyz")
        turn = _ros_part(index, document, ("orientation", "rotation"), "xyzw")
        told = re.search(r"^(?:exposure|name)\s*:\s*['\"]?([^'\"\n]+)", document, re.M)
        name = told[1].strip() if told else f"{index}"
        rows.append((name, robot_numbers.pose(name, "quaternion", place, turn)))
    if len(frames) > 1:
        got = " and ".join(sorted(", ".join(frame) or "none" for frame in frames)[:2])
        raise refused(f"frames: expected the same in all documents, got {got}")
    return RobotPoses("quaternion", "xyzw", None, "m", _once(rows))


def _ros_part(index: int, document: str, keys: tuple[str, str], axes: str) -> list[float]:
    """The numbers of a document's only place, or rotation."""
    block = rf"^[\s-]*(?:{'|'.join(keys)})[ \t]*:[ \t]*((?:\n[ \t]+[xyzw][ \t]*:.*)+)"
    found = re.findall(block, document, re.M)
    if len(found) != 1:
        raise refused(
            f"document {index}: expected one {keys[0]} or {keys[1]}, got {len(found)}; fix: put "
            f"each pose between lines of ---"
        )
    row = []
    for axis in axes:
        cells = re.findall(rf"^[ \t]+{axis}[ \t]*:[ \t]*(.*?)[ \t]*$", found[0], re.M)
        if len(cells) != 1 or not _is_number(cells[0]):
            got = ", ".join(cells) or "none"
            raise refused(f"document {index}: expected a number `{axis}` of {keys[0]}, got {got}")
        row.append(float(cells[0]))
    return row


def _csv(text: str) -> RobotPoses:
    lines = [
        line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise ValueError("expected a pose in each line, got none")
    dialect = next((c for c in ";," if c in lines[0]), None)
    rows = (
        list(csv.reader(lines, delimiter=dialect)) if dialect else [line.split() for line in lines]
    )
    rows = [[cell.strip() for cell in row] for row in rows]
    if not all(map(_is_number, rows[0][1:])):
        return _with_header([cell.lower() for cell in rows[0]], rows[1:])
    read = []
    for index, row in enumerate(rows):
        cells = row[1:] if len(row) in (8, 17) or not _is_number(row[0]) else row
        name = row[0] if len(cells) < len(row) else str(index)
        read.append((name, _entry(name, [_float(cell, name) for cell in cells])))
    return _of_one_kind(_once(read), None, None)


_HEADERS = (
    ("quaternion", "wxyz", ("qw", "qx", "qy", "qz")),
    ("angles", None, ("rx", "ry", "rz")),
    ("rpy", None, ("roll", "pitch", "yaw")),
    ("rpy", "rpy", ("roll_rad", "pitch_rad", "yaw_rad")),
    ("rpy", "rpy_deg", ("roll_deg", "pitch_deg", "yaw_deg")),
    ("angles", "abc_deg", ("a", "b", "c")),
)
"""Form, what is known of the rotation, and its columns."""


def _with_header(header: list[str], rows: list[list[str]]) -> RobotPoses:
    _once((column, None) for column in header)
    unit = next((u for u in UNITS if f"x_{u}" in header), None)
    suffix = f"_{unit}" if unit else ""
    places = ([f"{a}{suffix}" for a in "xyz"], ["tx", "ty", "tz"])
    place = next((p for p in places if set(p) <= set(header)), None)
    turn = next((turn for turn in _HEADERS if set(turn[2]) <= set(header)), None)
    if place is None or turn is None:
        forms = "; ".join(", ".join(columns) for *_, columns in _HEADERS)
        raise refused(
            f"expected columns x, y, z and one of {forms}, got {', '.join(header)}; fix: name "
            f"them so, or leave the header out"
        )
    form, rotation, columns = turn
    in_order = tuple(column for column in header if column in columns)
    if in_order == ("qx", "qy", "qz", "qw"):
        rotation, columns = "xyzw", in_order
    _only(header, (*place, *columns, *_NAMES), ("name", *place, *columns), "columns")
    name_at = next((header.index(n) for n in _NAMES if n in header), None)
    read = []
    for index, row in enumerate(rows):
        if len(row) != len(header):
            raise refused(f"line {index + 2}: expected {len(header)} cells, got {len(row)}")
        name = str(index) if name_at is None else row[name_at]
        cells = [[_float(row[header.index(c)], name) for c in part] for part in (place, columns)]
        read.append((name, _Pose(form, rotation, None, robot_numbers.pose(name, form, *cells))))
    return _of_one_kind(_once(read), None, unit)


def _is_number(cell: str) -> bool:
    return re.fullmatch(_NUMBER, cell) is not None


def _float(cell: str, name: str) -> float:
    if not _is_number(cell):
        raise refused(f"pose `{name}`: expected a number, got {cell!r}")
    return float(cell)
