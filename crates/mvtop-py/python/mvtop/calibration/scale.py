"""Whether a board was printed as large as its file says."""

from __future__ import annotations

from dataclasses import dataclass

from mvtop._printable import refused
from mvtop.calibration.boards import Board

GREATEST = 0.1
"""A length that differs by a greater share is of something else."""
FINE = 0.0005


@dataclass(frozen=True)
class Scale:
    """A length on the print, as measured and as the board file has it, metres."""

    what: str
    measured: float
    nominal: float

    @property
    def factor(self) -> float:
        """Measured length per nominal one."""
        return self.measured / self.nominal

    def __str__(self) -> str:
        lengths = f"{1e3 * self.measured:.2f} mm instead of {1e3 * self.nominal:.2f} mm"
        off = self.factor - 1
        if abs(off) < FINE:
            return f"the print fits: {self.what} measures {lengths}"
        how = "larger" if off > 0 else "smaller"
        return (
            f"the print is {abs(off):.2%} {how} than its file says: {self.what} measures "
            f"{lengths}; "
            "the measured size was used"
        )


def scale_of(board: Board, measured: float) -> Scale:
    """Takes a measured length, metres, for the side of the pattern that it is nearest to.

    Raises ValueError where it is near to none.
    """
    width, height = board.size
    sides = {"the pattern's width": width, "the pattern's height": height}
    if board.square:
        sides["the side of a tag" if board.ids else "the side of a square"] = board.square
    what = min(sides, key=lambda side: abs(measured / sides[side] - 1))
    if not abs(measured / sides[what] - 1) < GREATEST:
        known = ", ".join(f"{side} {1e3 * length:.2f} mm" for side, length in sides.items())
        raise refused(
            f"measured: {1e3 * measured:.2f} mm is within 10 % of no length of the board file "
            f"({known}); "
            "measure one of these, edge to edge"
        )
    return Scale(what, measured, sides[what])
