"""The model and the example that the wheel carries; `make wheel` puts them there."""

from __future__ import annotations

from pathlib import Path

from mvtop._mvtop import Rig

FOLDER = Path(__file__).parent / "shipped"
NAME = "mvball"


def model() -> Path:
    """The bundle's folder."""
    return _there(FOLDER / "model", "model.json")


def example() -> tuple[Rig, dict[str, Path]]:
    """Two views of a ball, whose pose neither of them determines alone.

    Returns
    -------
    rig : Rig
    images : dict
        The path of an image of each of its cameras, by camera id.

    Raises
    ------
    FileNotFoundError
        Where mvtop was built without it, see `make wheel`.

    Examples
    --------
    >>> rig, images = mvtop.example()
    >>> prediction = mvtop.Estimator.load("mvball").predict(images, rig)
    """
    folder = _there(FOLDER / "example", "rig.json")
    rig = Rig.load(folder / "rig.json")
    return rig, {camera.id: folder / f"{camera.id}.png" for camera in rig.cameras}


def _there(folder: Path, file: str) -> Path:
    if not (folder / file).is_file():
        raise FileNotFoundError(
            f"{folder}: expected {file}, got none; this mvtop was built without its model and "
            "example, which `make wheel` puts there: build it so, or name a bundle of your own"
        )
    return folder
