"""Boards in images, by OpenCV's detectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop.calibration import _need
from mvtop.calibration.boards import Board

if TYPE_CHECKING:
    from numpy.typing import NDArray

LEAST_POINTS = 6
"""Corners that a view needs to count."""
LEAST_FLATNESS = 0.02
"""Least width of what is seen of a board, as a share of its length: corners in one row fix no
pose."""
MISPLACED = 0.35
"""How far a tag's corner may be beside its place among the others, in sides of a tag."""


@dataclass(frozen=True, eq=False)
class Detection:
    """What one image shows of a board."""

    numbers: NDArray[np.intp]
    """(N,), which of the board's points."""
    pixels: NDArray[np.float64]
    """(N, 2), px."""

    def __len__(self) -> int:
        return len(self.numbers)


NOTHING = Detection(np.zeros(0, np.intp), np.zeros((0, 2)))


class Detector:
    """Finds one board; may be used by several threads, one image each."""

    def __init__(self, board: Board) -> None:
        self.board = board
        cv2 = _need.opencv()
        self._parameters = None
        if board.kind == "chessboard":
            return
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = board.border
        if board.kind == "charuco":
            parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        else:
            # Lines along a tag's sides meet in its corners; what looks at corners alone finds them
            # further inwards, half a pixel in our renderings.
            parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
        self._parameters = parameters

    def detect(self, grey: NDArray[np.uint8]) -> Detection:
        """What of the board a grey image (H, W) shows; `NOTHING` where it shows none."""
        if self.board.kind == "chessboard":
            return self._chessboard(grey)
        if self.board.inverted:
            grey = 255 - grey
        if self.board.kind == "charuco":
            return self._charuco(grey)
        return self._tags(grey)

    def _chessboard(self, grey: NDArray[np.uint8]) -> Detection:
        cv2 = _need.opencv()
        size = (self.board.columns - 1, self.board.rows - 1)
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if not found:
            flags |= cv2.CALIB_CB_EXHAUSTIVE
            found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if not found:
            return NOTHING
        pixels = _first_black(_upright(corners.reshape(size[1], size[0], 2).astype(float)), grey)
        return Detection(np.arange(len(self.board.points)), pixels.reshape(-1, 2))

    def _charuco(self, grey: NDArray[np.uint8]) -> Detection:
        cv2 = _need.opencv()
        detector = cv2.aruco.CharucoDetector(self.board.cv_charuco())
        detector.setDetectorParameters(self._parameters)
        corners, ids, _, _ = detector.detectBoard(grey)
        if ids is None or len(ids) == 0:
            return NOTHING
        return Detection(ids.ravel().astype(np.intp), corners.reshape(-1, 2).astype(float))

    def _tags(self, grey: NDArray[np.uint8]) -> Detection:
        cv2 = _need.opencv()
        detector = cv2.aruco.ArucoDetector(self.board.cv_dictionary(), self._parameters)
        corners, ids, _ = detector.detectMarkers(grey)
        if ids is None:
            return NOTHING
        place = {tag: i for i, tag in enumerate(self.board.ids)}
        known = [
            (place[int(i)], c) for i, c in zip(ids.ravel(), corners, strict=True) if i in place
        ]
        if not known:
            return NOTHING
        which = np.array([i for i, _ in known])
        # This way of OpenCV counts pixels from the image's corner.
        pixels = np.array([c.reshape(4, 2) for _, c in known], float) - 0.5
        return self._fitting(which, pixels)

    def _fitting(self, which: NDArray[np.intp], pixels: NDArray[np.float64]) -> Detection:
        """Tags that lie as the layout says, with corners in the order that fits it best.

        Programs differ in which corner of a tag is its first.
        """
        cv2 = _need.opencv()
        layout = self.board.points.reshape(-1, 4, 3)[which]
        flat = np.ptp(layout[..., 2]) < 1e-9
        best = NOTHING
        if len(which) == 1 or not flat:
            keep, turn = np.ones(len(which), bool), 0
        else:
            sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2).mean(axis=1)
            turns = []
            for turn in range(4):
                turned = np.roll(pixels, turn, axis=1)
                source = layout[..., :2].reshape(-1, 2)
                tolerance = MISPLACED * float(np.median(sides))
                plane, _ = cv2.findHomography(
                    source, turned.reshape(-1, 2), cv2.RANSAC, tolerance, maxIters=500
                )
                if plane is None:
                    turns.append((0, -np.inf, turn, np.zeros(len(which), bool)))
                    continue
                shown = cv2.perspectiveTransform(source[None], plane)[0].reshape(-1, 4, 2)
                off = np.linalg.norm(shown - turned, axis=2).max(axis=1)
                fits = off < MISPLACED * sides
                score = -float(off[fits].mean()) if fits.any() else -np.inf
                turns.append((int(fits.sum()), score, turn, fits))
            _, _, turn, keep = max(turns, key=lambda t: t[:2])
        if not keep.any():
            return best
        numbers = (4 * which[keep][:, None] + np.arange(4)).ravel()
        return Detection(numbers, np.roll(pixels, turn, axis=1)[keep].reshape(-1, 2))


def _upright(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows, columns, 2): in an order in which the board is not seen mirrored."""
    right, down = pixels[0, -1] - pixels[0, 0], pixels[-1, 0] - pixels[0, 0]
    if right[0] * down[1] - right[1] * down[0] < 0:
        return pixels[:, ::-1]
    return pixels


def _first_black(pixels: NDArray[np.float64], grey: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(rows, columns, 2): turned so that the square between the first corners is black.

    It is the second one of the second row, as black as the board's first square.
    """
    rows, columns = pixels.shape[:2]
    shades: list[list[int]] = [[], []]
    for row in range(rows - 1):
        for column in range(columns - 1):
            x, y = pixels[row : row + 2, column : column + 2].mean(axis=(0, 1)).round().astype(int)
            if 0 <= y < grey.shape[0] and 0 <= x < grey.shape[1]:
                shades[(row + column) % 2].append(int(grey[y, x]))
    if not all(shades) or np.mean(shades[0]) <= np.mean(shades[1]):
        return pixels
    if (rows + columns) % 2:
        return pixels[::-1, ::-1]
    return np.rot90(pixels) if rows == columns else pixels


def counts(board: Board, detection: Detection) -> bool:
    """Whether a view fixes the board's pose: enough corners, and not in one row."""
    if len(detection) < LEAST_POINTS:
        return False
    points = board.points[detection.numbers]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > LEAST_FLATNESS * spread[0])


def hint(board: Board, images: Sequence[NDArray[np.uint8]]) -> str:
    """What to try where no image shows the board: another reading of it, if one is seen."""
    for other, words in _readings(board):
        detector = Detector(other)
        if any(counts(other, detector.detect(image)) for image in images):
            return f"they show {words}"
    if board.kind == "chessboard":
        return "a chessboard counts only where all of it is in the image; try a ChArUco board"
    if family := _family(board, images):
        return f"they show markers of {family}, not of {board.dictionary}"
    return "check the kind and the numbers of the board file, light and sharpness"


def _readings(board: Board) -> list[tuple[Board, str]]:
    """Boards that are mistaken for this one, and what is said of them."""
    values = board.to_dict()
    columns, rows = board.columns, board.rows
    readings: list[tuple[dict[str, Any], str]] = []
    size = f"{columns} x {rows}"
    if board.kind in ("charuco", "aprilgrid"):
        swapped = {"columns": rows, "rows": columns}
        words = f"a board of {rows} columns and {columns} rows, where its file has {size}"
        readings.append((swapped, words))
    if board.kind == "charuco":
        old = not board.legacy
        words = f'the pattern with "legacy": {str(old).lower()} (OpenCV changed it in 4.6)'
        readings.append(({"legacy": old}, words))
    if board.kind == "chessboard":
        for more, words in ((1, "inner corners, not squares"), (-1, "squares beside its edge")):
            words = f"one of {columns + more} x {rows + more} squares: its file may count {words}"
            readings.append(({"columns": columns + more, "rows": rows + more}, words))
    if board.kind != "chessboard":
        words = "the pattern with black and white exchanged"
        readings.append(({"inverted": not board.inverted}, f'{words}: "inverted": true or false'))
    if board.kind in ("aprilgrid", "tags"):
        other = 3 - board.border
        readings.append(({"border": other}, f'tags with "border": {other}'))
    if board.kind == "aprilgrid":
        order = "bottom" if values["from"] == "top" else "top"
        readings.append(({"from": order}, f'ids that begin in the other row: "from": "{order}"'))
    found = []
    for change, words in readings:
        try:
            found.append((Board.from_dict(values | change), words))
        except ValueError:
            continue
    return found


def _family(board: Board, images: Sequence[NDArray[np.uint8]]) -> str | None:
    """The dictionary whose markers are seen most, if it is not the board's."""
    aruco = _need.opencv().aruco
    names = sorted({k[5:] for k in dir(aruco) if k.startswith("DICT_")} - {board.dictionary})
    best, most = None, 3
    for name in names:
        if name.endswith(("_250", "_100", "_50")) or name.upper() == name and "APRIL" in name:
            continue
        other = replace(board, dictionary=name)
        detector = aruco.ArucoDetector(other.cv_dictionary(), aruco.DetectorParameters())
        seen = max(len(detector.detectMarkers(image)[0]) for image in images)
        if seen > most:
            best, most = name, seen
    return best
