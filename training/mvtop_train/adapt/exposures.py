"""Photographs of a cell: which were taken while nothing moved, by which cameras."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..data import bop
from ..errors import UserError, asking_mvtop
from ..evaluation.groups import ENDINGS, decoded

HELD = 5  # one in so many exposures, or images of a scene, is held out
LAYOUTS = (
    "photos/EXPOSURE/CAMERA.png with --rig, or scenes in BOP layout (scene_camera.json beside rgb/)"
)


@dataclass(frozen=True)
class Exposure:
    """Images of one scene in which nothing moves.

    name    of its folder
    rig     mvtop.Rig of the cameras that have an image
    paths   of the images, by camera
    """

    name: str
    rig: object
    paths: dict[str, Path]

    def images(self) -> dict[str, np.ndarray]:
        """By camera [H, W, 3] uint8 RGB."""
        return decoded(self.rig, [self.paths[camera.id] for camera in self.rig.cameras])

    def part(self, numbers: list[int]) -> "Exposure":
        """Of some of its cameras, by their numbers in the rig."""
        cameras = [self.rig.cameras[number] for number in numbers]
        paths = {camera.id: self.paths[camera.id] for camera in cameras}
        return replace(self, rig=_rig(cameras), paths=paths)


def _rig(cameras: list):
    import mvtop  # loads its compiled part

    # Where they stand was accepted when the whole rig was read.
    return mvtop.Rig(cameras, trust_unit=True)


def read(images: Path, rig: Path | None, least: int) -> list[Exposure]:
    """All exposures with at least so many images.

    - images: folder in one of `LAYOUTS`
    - rig: rig file of the cameras; None of BOP's layout, which says where they stood
    """
    found = _of_scenes(images) if rig is None else _of_folders(images, rig)
    enough = [one for one in found if len(one.paths) >= least]
    if not enough:
        most = max((len(one.paths) for one in found), default=0)
        raise UserError(
            f"{images}: expected exposures of at least {least} images, got "
            f"{f'{most} at most' if found else 'none'}; fix: {LAYOUTS}"
            + (f", or --min-views {most}" if most > 1 else "")
        )
    return enough


def _of_folders(images: Path, rig: Path) -> list[Exposure]:
    with asking_mvtop("see docs/reference/rig-file.md"):
        import mvtop  # loads its compiled part

        cameras = mvtop.Rig.load(rig).cameras
    found = []
    for folder in sorted(path for path in images.glob("*") if path.is_dir()):
        paths = {}
        for camera in cameras:
            files = (folder / f"{camera.id}.{ending}" for ending in ENDINGS)
            if (file := next((file for file in files if file.is_file()), None)) is not None:
                paths[camera.id] = file
        there = [camera for camera in cameras if camera.id in paths]
        if there:
            found.append(Exposure(folder.name, _rig(there), paths))
    return found


def _of_scenes(images: Path) -> list[Exposure]:
    """What is annotated in them is not looked at."""
    folders = sorted(path.parent for path in images.glob("*/scene_camera.json"))
    if (images / "scene_camera.json").exists():
        folders = [images]
    found = []
    for folder in folders:
        shots = sorted(bop.read_images(folder), key=lambda image: image.number)
        with asking_mvtop("see docs/how-to/evaluate-on-bop.md"):
            rig, _ = bop.rig_of(shots)
        paths = {camera.id: shot.path for camera, shot in zip(rig.cameras, shots, strict=True)}
        found.append(Exposure(folder.name, rig, paths))
    return found


def split(exposures: list[Exposure], least: int) -> tuple[list[Exposure], list[Exposure]]:
    """Those to learn from, and those held out: one in `HELD`; of fewer exposures, one in `HELD`
    images of each that has enough of them.

    - least: images of an exposure
    """
    if len(exposures) >= HELD:
        held = set(range(HELD // 2, len(exposures), HELD))
        return (
            [one for number, one in enumerate(exposures) if number not in held],
            [exposures[number] for number in sorted(held)],
        )
    training, held = [], []
    for one in exposures:
        count = len(one.paths)
        out = set(range(HELD // 2, count, HELD))
        if len(out) < 2 or count - len(out) < least:
            training.append(one)
            continue
        training.append(one.part([number for number in range(count) if number not in out]))
        held.append(one.part(sorted(out)))
    return training, held
