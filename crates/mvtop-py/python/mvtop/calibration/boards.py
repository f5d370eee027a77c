"""Calibration targets: what is printed on them, and the file `board.json`.

Frame `board`: origin at the top left corner of the pattern, x right, y down on the print, z into
the sheet; metres. A sheet of tags has the frame that its file gives the corners in.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._printable import refused
from mvtop.calibration import _need
from mvtop.calibration.kalibr import kalibr_target

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
FORMAT, VERSION = "mvtop-board", 1
GREATEST_SIDE = 10.0
"""A longer board hints at another unit, metres."""
LEAST_SIDE = 0.005

_COMMON = {"format", "version", "unit", "kind"}
_KEYS = {
    "charuco": (
        {"columns", "rows", "square", "marker", "dictionary"},
        {"legacy", "first_id", "inverted"},
    ),
    "chessboard": ({"columns", "rows", "square"}, set()),
    "aprilgrid": (
        {"columns", "rows", "tag", "gap"},
        {"dictionary", "first_id", "from", "border", "inverted"},
    ),
    "tags": ({"dictionary", "tags"}, {"border"}),
}
_OF_MARKERS = {"inverted"}
KINDS = tuple(_KEYS)
APRIL = {"tag16h5": "16h5", "tag25h9": "25h9", "tag36h10": "36h10", "tag36h11": "36h11"}


@dataclass(frozen=True, eq=False)
class Board:
    """A target. Points have numbers: `points[i]` is where point i is."""

    kind: str
    """"charuco", "chessboard", "aprilgrid" or "tags"."""
    columns: int
    """Squares, or tags, in a row; 0 of a sheet of tags."""
    rows: int
    square: float
    """Side of a square, or of a tag, metres; 0 of a sheet of tags of several sizes."""
    marker: float
    """Side of a ChArUco board's markers, or distance between an AprilGrid's tags, metres."""
    dictionary: str
    """OpenCV's name of the markers' dictionary, without `DICT_`; "" of a chessboard."""
    points: NDArray[np.float64]
    """(P, 3), board frame, metres."""
    ids: tuple[int, ...] = ()
    """Of tags, in the order of the points, four to a tag: clockwise from the tag's top left."""
    legacy: bool = False
    """Of ChArUco: the pattern of OpenCV before 4.6."""
    border: int = 1
    """Width of tags' black borders, in bits."""
    first_id: int = 0
    inverted: bool = False
    """Whether black and white are exchanged, of markers."""

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Board:
        """Reads a board file, or Kalibr's target file (YAML).

        Raises OSError where it cannot be read, ValueError where it is refused.
        """
        text = read_text(Path(path))
        try:
            if (target := kalibr_target(text)) is not None:
                return cls.from_dict(target)
            try:
                values = json.loads(text)
            except json.JSONDecodeError as cause:
                raise refused(f"expected JSON: {cause}") from None
            return cls.from_dict(values)
        except ValueError as error:
            raise refused(f"{path}: {error}") from None

    @classmethod
    def from_dict(cls, values: Any) -> Board:
        """Of what a board file says (docs/how-to/calibrate-a-rig.md).

        Raises ValueError in one sentence.
        """
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise refused(
                f'a board file begins with {{"format": "{FORMAT}", "version": {VERSION}; fix: '
                "`mvtop-cli rig board` writes one"
            )
        if values.get("version") != VERSION:
            raise refused(f"`version`: expected {VERSION}, got {values.get('version')!r}")
        kind = values.get("kind")
        if kind not in _KEYS:
            raise refused(f"`kind`: expected one of {', '.join(_KEYS)}, got {kind!r}")
        needed, optional = _KEYS[kind]
        optional = optional if kind == "chessboard" else optional | _OF_MARKERS
        known = _COMMON | needed | optional
        if unknown := sorted(set(values) - known):
            raise refused(
                f"`{unknown[0]}`: no key of a {kind}; expected {', '.join(sorted(known))}"
            )
        if missing := sorted((_COMMON | needed) - set(values)):
            raise refused(f"`{missing[0]}` is missing, which a {kind} needs")
        if values["unit"] not in UNITS:
            raise refused(f"`unit`: expected m, cm or mm, got {values['unit']!r}")
        board = _build(kind, values, UNITS[values["unit"]])
        return replace(board, inverted=_flag(values, "inverted"))

    def to_dict(self) -> dict[str, Any]:
        """What a board file says of it, in millimetres."""
        head = {"format": FORMAT, "version": VERSION, "unit": "mm", "kind": self.kind}
        if self.kind == "tags":
            corners = 1e3 * self.points.reshape(-1, 4, 3)
            tags = [
                {"id": tag, "corners": corner.round(6).tolist()}
                for tag, corner in zip(self.ids, corners, strict=True)
            ]
            more: dict[str, Any] = {"dictionary": self.dictionary, "tags": tags}
            return head | more | {"border": self.border, "inverted": self.inverted}
        head |= {"columns": self.columns, "rows": self.rows}
        square, marker = round(1e3 * self.square, 6), round(1e3 * self.marker, 6)
        if self.kind == "chessboard":
            return head | {"square": square}
        if self.kind == "aprilgrid":
            order = "top" if self.ids[: self.columns] == self._ascending() else "bottom"
            head |= {"tag": square, "gap": marker, "from": order, "border": self.border}
        else:
            head |= {"square": square, "marker": marker, "legacy": self.legacy}
        head |= {"dictionary": self.dictionary, "first_id": self.first_id}
        return head | {"inverted": self.inverted}

    def _ascending(self) -> tuple[int, ...]:
        return tuple(range(self.first_id, self.first_id + self.columns))

    def scaled(self, factor: float) -> Board:
        """The same printed larger."""
        return replace(
            self,
            square=self.square * factor,
            marker=self.marker * factor,
            points=self.points * factor,
        )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of what is printed, metres."""
        if self.kind == "tags":
            width, height = np.ptp(self.points[:, :2], axis=0)
            return float(width), float(height)
        step = self.square + (self.marker if self.kind == "aprilgrid" else 0.0)
        end = self.marker if self.kind == "aprilgrid" else 0.0
        return self.columns * step - end, self.rows * step - end

    @property
    def alike(self) -> list[NDArray[np.intp]]:
        """(P,) permutations: turns after which a chessboard looks the same; none of others."""
        if self.kind != "chessboard" or (self.columns + self.rows) % 2:
            return []
        numbers = np.arange(len(self.points)).reshape(self.rows - 1, self.columns - 1)
        quarters = (1, 2, 3) if self.rows == self.columns and self.rows % 2 else (2,)
        return [np.rot90(numbers, quarter).ravel() for quarter in quarters]

    def cv_dictionary(self) -> Any:
        """OpenCV's dictionary of its markers."""
        aruco = _need.opencv().aruco
        return aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{self.dictionary}"))

    def cv_charuco(self) -> Any:
        """OpenCV's ChArUco board."""
        ids = np.arange(self.first_id, self.first_id + self.columns * self.rows // 2)
        made = _need.opencv().aruco.CharucoBoard(
            (self.columns, self.rows), self.square, self.marker, self.cv_dictionary(), ids
        )
        made.setLegacyPattern(self.legacy)
        return made

    def __repr__(self) -> str:
        width, height = (1e3 * side for side in self.size)
        return f"Board({self.kind}, {width:.4g} x {height:.4g} mm, {len(self.points)} points)"


def read_text(path: Path) -> str:
    """A file's text.

    Raises OSError that names it.
    """
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as cause:
        raise type(cause)(f"cannot read {path}: {cause.strerror}") from None


def _build(kind: str, values: dict[str, Any], metres: float) -> Board:
    if kind == "tags":
        return _sheet(values, metres)
    least = 3 if kind != "aprilgrid" else 1
    columns, rows = (_whole(values, key, least, 200) for key in ("columns", "rows"))
    if kind == "chessboard":
        square = _length(values, "square", metres)
        grid = _grid(columns - 1, rows - 1, square) + [square, square, 0]
        board = Board(kind, columns, rows, square, 0.0, "", grid)
        return _checked(board)
    first = _whole(values, "first_id", 0, 100000) if "first_id" in values else 0
    if kind == "charuco":
        square, marker = _length(values, "square", metres), _length(values, "marker", metres)
        if marker >= square:
            raise refused(
                f"`marker`: expected less than `square`, {values['square']}, got {values['marker']}"
            )
        grid = _grid(columns - 1, rows - 1, square) + [square, square, 0]
        legacy = _flag(values, "legacy")
        name = dictionary(values["dictionary"])
        board = Board(
            kind, columns, rows, square, marker, name, grid, legacy=legacy, first_id=first
        )
        _enough(name, first + columns * rows // 2)
        return _checked(board)
    tag, gap = _length(values, "tag", metres), _length(values, "gap", metres)
    name = dictionary(values.get("dictionary", "tag36h11"))
    order = values.get("from", "top")
    if order not in ("top", "bottom"):
        raise refused(f"`from`: the row that ids begin in, top or bottom, got {order!r}")
    corner = np.array([[0, 0, 0], [tag, 0, 0], [tag, tag, 0], [0, tag, 0]])
    places = _grid(columns, rows, tag + gap)
    numbers = np.arange(columns * rows).reshape(rows, columns)
    ids = first + (numbers if order == "top" else numbers[::-1]).ravel()
    points = (places[:, None, :] + corner[None]).reshape(-1, 3)
    border = _whole(values, "border", 1, 2) if "border" in values else 1
    _enough(name, int(ids.max()) + 1)
    numbered = tuple(int(i) for i in ids)
    return _checked(
        Board(kind, columns, rows, tag, gap, name, points, numbered, border=border, first_id=first)
    )


def _sheet(values: dict[str, Any], metres: float) -> Board:
    tags = values["tags"]
    if not isinstance(tags, list) or not tags:
        raise ValueError("`tags`: expected a list of tags, each with `id` and `corners`")
    ids, corners, sides = [], [], []
    for number, tag in enumerate(tags):
        where = f"`tags`, number {number}"
        if not isinstance(tag, dict) or "id" not in tag:
            raise refused(f"{where}: expected an `id`, and `corners` or `center` and `size`")
        known = {"id", "corners"} if "corners" in tag else {"id", "center", "size", "turn_deg"}
        if unknown := sorted(set(tag) - known):
            raise refused(f"{where}: `{unknown[0]}`: expected {', '.join(sorted(known))}")
        try:
            four = _corners(tag)
        except (KeyError, TypeError, ValueError):
            raise refused(
                f"{where}: expected `corners`, four points of 2 or 3 numbers clockwise from the "
                f"top "
                "left, or `center` [x, y] and `size`, with `turn_deg` clockwise"
            ) from None
        ids.append(_whole(tag, "id", 0, 100000))
        corners.append(four * metres)
        sides.append(float(np.linalg.norm(four[1] - four[0]) * metres))
    if len(set(ids)) != len(ids):
        twice = next(i for i in ids if ids.count(i) > 1)
        raise refused(f"`tags`: id {twice} comes twice; expected each once")
    name = dictionary(values["dictionary"])
    _enough(name, max(ids) + 1)
    border = _whole(values, "border", 1, 2) if "border" in values else 1
    side = sides[0] if np.ptp(sides) < 1e-9 else 0.0
    points = np.concatenate(corners)
    return _checked(Board("tags", 0, 0, side, 0.0, name, points, tuple(ids), border=border))


def _corners(tag: dict[str, Any]) -> NDArray[np.float64]:
    if "corners" in tag:
        corners = np.array(tag["corners"], float)
        if corners.shape == (4, 2):
            corners = np.c_[corners, np.zeros(4)]
        if corners.shape != (4, 3) or not np.isfinite(corners).all():
            raise ValueError
        return corners
    size, turn = float(tag["size"]), np.radians(float(tag.get("turn_deg", 0.0)))
    unit = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2
    turned = unit @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    center = np.array(tag["center"], float)
    if center.shape != (2,) or not size > 0:
        raise ValueError
    found: NDArray[np.float64] = np.c_[turned + center, np.zeros(4)]
    return found


def dictionary(name: Any) -> str:
    """OpenCV's name of a dictionary without `DICT_`: "5X5_100", "APRILTAG_36h11".

    Raises ValueError for one that OpenCV has not.
    """
    aruco = _need.opencv().aruco
    known = sorted(key[5:] for key in dir(aruco) if key.startswith("DICT_"))
    wanted = str(name)
    wanted = f"APRILTAG_{APRIL[wanted]}" if wanted in APRIL else wanted
    wanted = wanted.upper().removeprefix("DICT_")
    for key in known:
        if key.upper() == wanted:
            return key
    tags = ", ".join(APRIL)
    sizes = ", ".join(k for k in known if not k.startswith("APRILTAG"))
    raise refused(f"`dictionary`: expected {tags} or one of {sizes}, got {name!r}")


def _enough(name: str, count: int) -> None:
    aruco = _need.opencv().aruco
    has = len(aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{name}")).bytesList)
    if count > has:
        raise refused(f"`dictionary`: {name} has {has} markers, but {count} are needed")


def _checked(board: Board) -> Board:
    longest = max(board.size)
    if not LEAST_SIDE < longest < GREATEST_SIDE:
        raise refused(
            f"the board would be {longest:.3g} m long, which hints at a wrong `unit`; expected "
            f"{LEAST_SIDE:g} to {GREATEST_SIDE:g} m"
        )
    return board


def _grid(columns: int, rows: int, step: float) -> NDArray[np.float64]:
    y, x = np.mgrid[:rows, :columns].astype(float) * step
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def _whole(values: dict[str, Any], key: str, least: int, most: int) -> int:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise refused(f"`{key}`: expected a whole number of {least} to {most}, got {value!r}")
    return value


def _flag(values: dict[str, Any], key: str) -> bool:
    value = values.get(key, False)
    if not isinstance(value, bool):
        raise refused(f"`{key}`: expected true or false, got {value!r}")
    return value


def _length(values: dict[str, Any], key: str, metres: float) -> float:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e6:
        raise refused(f"`{key}`: expected a length above 0, got {value!r}")
    return float(value) * metres
