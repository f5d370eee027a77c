"""All images of a calibration, and what is found in them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mvtop._printable import refused
from mvtop.calibration import detect
from mvtop.calibration.boards import Board
from mvtop.calibration.images import Sources, grey

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

HINT_IMAGES = 4
"""Images that are searched for another board where none is found."""
FEWEST = {"lens": 4, "kept": 1}
"""Exposures that a camera needs whose lens is calibrated, or is given."""


@dataclass(eq=False)
class Observations:
    """What cameras see of the board, by camera and exposure."""

    board: Board
    sources: Sources
    sizes: dict[str, tuple[int, int]]
    """Width and height of each camera's images, px."""
    found: dict[str, dict[str, detect.Detection]]
    """Views that count."""
    scraps: dict[str, dict[str, detect.Detection]]
    """Views of too little of the board."""

    @property
    def cameras(self) -> list[str]:
        return list(self.sources)

    @property
    def exposures(self) -> list[str]:
        """All, in the order of their names."""
        return sorted({key for by in self.sources.values() for key in by})

    def image(self, camera: str, exposure: str) -> NDArray[np.uint8]:
        """(H, W) grey."""
        return grey(self.sources[camera][exposure], f"{camera}, {exposure}")


def observe(
    sources: Sources, board: Board, *, progress: Callable[[int, int], None] | None = None
) -> Observations:
    """Finds the board in all images.

    Raises ValueError where images of one camera differ in size, or none shows the board.
    """
    detector = detect.Detector(board)
    told = Observations(board, sources, {}, {c: {} for c in sources}, {c: {} for c in sources})
    tasks = [(camera, key) for camera, by in sources.items() for key in sorted(by)]
    lock, done = threading.Lock(), [0]

    def one(task: tuple[str, str]) -> tuple[tuple[int, int], detect.Detection]:
        image = told.image(*task)
        answer = (image.shape[1], image.shape[0]), detector.detect(image)
        with lock:
            done[0] += 1
            if progress is not None:
                progress(done[0], len(tasks))
        return answer

    with ThreadPoolExecutor(min(len(tasks) or 1, os.cpu_count() or 1)) as pool:
        answers = list(pool.map(one, tasks))
    for (camera, key), (size, detection) in zip(tasks, answers, strict=True):
        first = told.sizes.setdefault(camera, size)
        if size != first:
            raise refused(_sizes(camera, first, key, size))
        if detect.counts(board, detection):
            told.found[camera][key] = detection
        elif len(detection):
            told.scraps[camera][key] = detection
    if not any(told.found.values()):
        some = [told.image(*task) for task in _few(tasks)]
        raise refused(
            f"none of {len(tasks)} images shows the {board.kind} of the board file: "
            f"{detect.hint(board, some)}"
        )
    return told


def _few(tasks: list[tuple[str, str]]) -> Iterable[tuple[str, str]]:
    step = max(1, len(tasks) // HINT_IMAGES)
    return tasks[::step][:HINT_IMAGES]


def _sizes(camera: str, first: tuple[int, int], key: str, size: tuple[int, int]) -> str:
    turned = size == first[::-1]
    why = "turned by 90 degrees: save all as the sensor has them" if turned else "use one size"
    return (
        f"camera `{camera}`, exposure `{key}`: the image is {size[0]}x{size[1]}, the camera's "
        f"others "
        f"are {first[0]}x{first[1]}; {why}"
    )


def check_counts(told: Observations, given: Iterable[str]) -> None:
    """Refuses cameras that see the board too seldom.

    - given: cameras whose lens is not calibrated

    Raises ValueError.
    """
    kept = set(given)
    for camera in told.cameras:
        needed = FEWEST["kept" if camera in kept else "lens"]
        count, of = len(told.found[camera]), len(told.sources[camera])
        if count >= needed:
            continue
        scraps = len(told.scraps[camera])
        more = f"; in {scraps} more too little of it is seen" if scraps else ""
        raise refused(
            f"camera `{camera}` shows the board in {count} of {of} images, expected {needed} or "
            f"more"
            f"{more}; fix: add exposures, or leave the camera out with --cameras"
        )
