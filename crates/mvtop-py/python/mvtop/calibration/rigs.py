"""From an adjusted bundle to a rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mvtop._mvtop import Camera, Rig
from mvtop.calibration import rigid
from mvtop.calibration.adjust import Bundle
from mvtop.calibration.lenses import FOCAL
from mvtop.calibration.solve import Problem
from mvtop.calibration.verdict import Coverage

if TYPE_CHECKING:
    from numpy.typing import NDArray


def make(
    problem: Problem,
    bundle: Bundle,
    world_from_root: NDArray[np.float64],
    covered: Sequence[Coverage],
    root: int,
    trust_unit: bool,
) -> tuple[Rig, list[str]]:
    """The rig of an adjusted bundle, and warnings of lenses that are limited in it.

    - world_from_root: (4, 4), from the frame of the camera that stood still
    """
    made, warnings = [], []
    for index, name in enumerate(problem.cameras):
        lens, kind = bundle.lenses[index], bundle.kinds[index]
        matrix = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]])
        width, height = problem.told.sizes[name]
        pose = world_from_root @ rigid.inverse(bundle.cam_from_world[index])
        pose[:3, :3] = rigid.mean_rotation(pose[None, :3, :3])

        def camera(limit: float | None) -> Camera:
            return Camera(
                matrix,  # noqa: B023
                (width, height),  # noqa: B023
                distortion=lens[FOCAL:],  # noqa: B023
                model=kind.model,  # noqa: B023
                world_from_cam=pose,  # noqa: B023
                id=name,  # noqa: B023
                max_angle_deg=limit,
            )

        whole = camera(None) if bundle.free_lens[index] is False else _whole(camera)
        edges = np.array([[x, y] for x in (0, width - 1) for y in (0, height - 1)], float)
        if whole is None or np.isnan(whole.unproject(edges)).any() and kind.model == "pinhole":
            limit = round(covered[index].greatest_angle_deg + 0.5, 1)
            whole = camera(limit)
            warnings.append(
                f"camera `{name}`: the lens is known up to {limit} degrees from its axis, which is "
                "written as its limit; beyond it would fold: show boards at the image's edges"
            )
        made.append(whole)
    return Rig(made, problem.cameras[root], trust_unit=trust_unit), warnings


def _whole(camera: Callable[[float | None], Camera]) -> Camera | None:
    """The camera without a limit; None where its lens leaves too much of the image without a
    ray."""
    try:
        return camera(None)
    except ValueError:
        return None
