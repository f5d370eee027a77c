"""Cameras that no chain of shared boards links to the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mvtop._printable import refused
from mvtop.calibration.detect import LEAST_POINTS
from mvtop.calibration.solve import Problem

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def check(problem: Problem, placed: Sequence[NDArray[np.float64] | None], root: int) -> None:
    """Refuses a rig with cameras that nothing links, and names the nearest chance.

    Raises ValueError.
    """
    lost = [i for i, pose in enumerate(placed) if pose is None]
    if not lost:
        return
    held = [problem.cameras[i] for i, pose in enumerate(placed) if pose is not None]
    names = [problem.cameras[i] for i in lost]
    lost_names = ", ".join(f"`{name}`" for name in names)
    subject = f"camera {lost_names} shares" if len(names) == 1 else f"cameras {lost_names} share"
    others = "any other camera" if len(held) > 1 else f"`{held[0]}`"
    raise refused(
        f"{subject} no exposure with {others}: {_nearest(problem, names, held)}; fix: show the "
        f"board "
        "where both see it, or leave cameras out with --cameras"
    )


def _nearest(problem: Problem, lost: Sequence[str], held: Sequence[str]) -> str:
    """The exposure that comes nearest to a link."""
    told = problem.told
    total = len(told.board.points)
    best: tuple[int, str] | None = None
    for some, others in ((lost, held), (held, lost)):
        for camera in some:
            for exposure, scrap in told.scraps[camera].items():
                partner = [name for name in others if exposure in told.found[name]]
                if partner and (best is None or len(scrap) > best[0]):
                    words = (
                        f"nearest is exposure `{exposure}`, where `{partner[0]}` sees the board "
                        f"and "
                        f"`{camera}` {len(scrap)} of its {total} corners, {LEAST_POINTS} not in "
                        f"a row "
                        "are needed"
                    )
                    best = len(scrap), words
    if best is not None:
        return best[1]
    order = told.exposures
    pairs = [
        (abs(order.index(a) - order.index(b)), a, x, b, y)
        for x in lost
        for a in told.found[x]
        for y in held
        for b in told.found[y]
    ]
    _, a, x, b, y = min(pairs)
    return f"nearest are exposure `{a}`, where `{x}` sees the board, and `{b}`, where `{y}` does"
