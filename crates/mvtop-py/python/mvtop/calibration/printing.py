"""Boards as drawings: rectangles, which become SVG, PDF or an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mvtop._printable import refused
from mvtop.calibration import _need
from mvtop.calibration.boards import Board

if TYPE_CHECKING:
    from numpy.typing import NDArray

POINTS_PER_MM = 72 / 25.4
PAPERS = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
}
"""Width and height, mm."""
MARGIN = 5.0
"""Least white edge about a pattern, mm."""
CAPTION = 8.0
"""Height of the line of text below, mm."""


@dataclass(frozen=True)
class Box:
    """A black or white rectangle, metres, board frame."""

    x: float
    y: float
    width: float
    height: float
    black: bool = True


def boxes(board: Board) -> list[Box]:
    """What is printed, later ones above earlier ones.

    Raises ValueError for a sheet whose tags are turned or not flat, and for what is inverted.
    """
    if board.inverted:
        raise ValueError("`inverted`: a board with black and white exchanged is not printed")
    if board.kind in ("charuco", "chessboard"):
        # A board of an even number of rows begins with white in the pattern before OpenCV 4.6.
        first = 1 if board.legacy and board.rows % 2 == 0 else 0
        side = board.square
        found = [
            Box(side * x, side * y, side, side)
            for y in range(board.rows)
            for x in range(board.columns)
            if (x + y) % 2 == first
        ]
        if board.kind == "charuco":
            white = [
                (x, y)
                for y in range(board.rows)
                for x in range(board.columns)
                if (x + y) % 2 != first
            ]
            edge = (side - board.marker) / 2
            for number, (x, y) in enumerate(white):
                corner = side * x + edge, side * y + edge
                found += _marker(board, board.first_id + number, corner, board.marker)
        return found
    found = []
    for tag, corners in zip(board.ids, board.points.reshape(-1, 4, 3), strict=True):
        (x0, y0), (x1, y1) = corners[0, :2], corners[2, :2]
        square = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        if np.abs(corners[:, :2] - square).max() > 1e-9 or np.ptp(corners[:, 2]) > 1e-9:
            raise refused(f"tag {tag} is turned or not flat; expected one that is upright")
        found += _marker(board, tag, (float(x0), float(y0)), float(x1 - x0))
    return found


def _marker(board: Board, number: int, corner: tuple[float, float], side: float) -> list[Box]:
    """Black square, white cells on it; neighbours in a row as one."""
    aruco = _need.opencv().aruco
    dictionary = board.cv_dictionary()
    cells = dictionary.markerSize + 2 * board.border
    bits = aruco.generateImageMarker(dictionary, number, cells, borderBits=board.border)
    step = side / cells
    found = [Box(*corner, side, side)]
    for row, line in enumerate(bits > 127):
        edges = np.flatnonzero(np.diff(np.r_[0, line.astype(int), 0]))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            x, y = corner[0] + step * start, corner[1] + step * row
            found.append(Box(x, y, step * (end - start), step, False))
    return found


def texture(
    board: Board, pixels_per_m: float, margin: float
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """An image of the print, and where the board frame's origin is in it, px from its corner.

    - margin: white about it, metres
    """
    extent = board.size
    width, height = (int(round((side + 2 * margin) * pixels_per_m)) for side in extent)
    image = np.full((height, width), 235.0)
    origin = np.full(2, margin * pixels_per_m)
    if board.kind == "tags":
        origin -= board.points[:, :2].min(axis=0) * pixels_per_m
    for box in boxes(board):
        x0, x1 = (box.x * pixels_per_m + origin[0], (box.x + box.width) * pixels_per_m + origin[0])
        y0, y1 = (box.y * pixels_per_m + origin[1], (box.y + box.height) * pixels_per_m + origin[1])
        share = np.outer(_covered(y0, y1, height), _covered(x0, x1, width))
        rows, columns = slice(int(y0), int(np.ceil(y1))), slice(int(x0), int(np.ceil(x1)))
        part = image[rows, columns]
        color = 20.0 if box.black else 235.0
        image[rows, columns] = part + (color - part) * share[rows, columns]
    return image.round().astype(np.uint8), origin


def _covered(start: float, end: float, count: int) -> NDArray[np.float64]:
    """How much of each pixel lies between two places."""
    edges = np.arange(count + 1)
    return np.diff(np.clip(edges, start, end))


def paper_of(board: Board, name: str | None) -> tuple[float, float]:
    """Width and height of the sheet, mm; the smallest that holds the board by default.

    Raises ValueError where the board does not fit.
    """
    width, height = (1e3 * side for side in board.size)
    papers = PAPERS if name is None else {name: PAPERS[name]}
    for sides in papers.values():
        for paper in (sides, sides[::-1]):
            if width + 2 * MARGIN <= paper[0] and height + 2 * MARGIN + CAPTION <= paper[1]:
                return paper
    if name is None:
        return width + 2 * MARGIN, height + 2 * MARGIN + CAPTION
    raise refused(
        f"a board of {width:.1f} x {height:.1f} mm does not fit on {name} with {MARGIN:g} mm of "
        f"margin; "
        "fix: smaller squares, or larger paper"
    )


def caption(board: Board) -> str:
    """What is printed below a board."""
    width, height = (1e3 * side for side in board.size)
    return (
        f"mvtop {board.kind}; print at 100 %, then measure: the pattern is {width:.2f} mm wide and "
        f"{height:.2f} mm high"
    )


def svg(board: Board, paper: tuple[float, float]) -> str:
    """A sheet as SVG, in mm."""
    dx, dy = _corner(board, paper)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{paper[0]:g}mm" height="{paper[1]:g}mm" '
        f'viewBox="0 0 {paper[0]:g} {paper[1]:g}" shape-rendering="crispEdges">',
        f'<rect width="{paper[0]:g}" height="{paper[1]:g}" fill="#fff"/>',
    ]
    for box in boxes(board):
        x, y = 1e3 * box.x + dx, 1e3 * box.y + dy
        fill = "#000" if box.black else "#fff"
        lines.append(
            f'<rect x="{x:.5f}" y="{y:.5f}" width="{1e3 * box.width:.5f}" '
            f'height="{1e3 * box.height:.5f}" fill="{fill}"/>'
        )
    below = dy + 1e3 * _extent(board)[3] + 5
    lines.append(
        f'<text x="{MARGIN:g}" y="{below:.2f}" font-family="sans-serif" font-size="2.8">'
        f"{caption(board)}</text></svg>\n"
    )
    return "\n".join(lines)


def pdf(board: Board, paper: tuple[float, float]) -> bytes:
    """A sheet as PDF of one page, vector graphics alone."""
    dx, dy = _corner(board, paper)
    k = POINTS_PER_MM
    drawn = []
    for box in boxes(board):
        x, y = (1e3 * box.x + dx) * k, (paper[1] - 1e3 * (box.y + box.height) - dy) * k
        shade = 0 if box.black else 1
        size = f"{1e3 * box.width * k:.5f} {1e3 * box.height * k:.5f}"
        drawn.append(f"{shade} g {x:.5f} {y:.5f} {size} re f")
    below = (paper[1] - dy - 1e3 * _extent(board)[3] - 5) * k
    drawn.append(f"BT 0 g /F1 8 Tf {MARGIN * k:.2f} {below:.2f} Td ({caption(board)}) Tj ET")
    stream = "\n".join(drawn).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {paper[0] * k:.4f} {paper[1] * k:.4f}] "
        "/Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out, places = bytearray(b"%PDF-1.6\n"), []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    start = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer << /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (
        len(objects) + 1,
        start,
    )
    return bytes(out)


def _extent(board: Board) -> tuple[float, float, float, float]:
    """Least and greatest x and y of what is printed, metres: x0, y0, x1, y1."""
    if board.kind == "tags":
        low, high = board.points[:, :2].min(axis=0), board.points[:, :2].max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])
    return (0.0, 0.0, *board.size)


def _corner(board: Board, paper: tuple[float, float]) -> tuple[float, float]:
    """Where the board frame's origin is on the sheet, mm."""
    x0, y0, x1, y1 = (1e3 * side for side in _extent(board))
    return (paper[0] - x1 - x0) / 2, (paper[1] - CAPTION - y1 - y0) / 2
