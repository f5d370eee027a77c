"""A bundle's detector by itself, on one image, and the true boxes in it."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnxruntime
import torch

from .. import description
from ..data import meshfile, surface
from ..data.boxes import around
from ..data.letterbox import image_tensor, input_size, letterbox
from ..files import read_json
from .groups import Group
from .matching import peaks

LEAST = 0.01  # score of a box


def tiling_of(about: dict) -> dict[str, float]:
    """`inference.tiling` of a bundle: the core's own where it says nothing.

    - about: its `model.json`
    """
    own = about.get("inference", {}).get("tiling", {})
    return description.default_inference("tiling") | own


@dataclass(frozen=True)
class Visible:
    """An object that an image shows: the number of its class, its box [4] px, cut off where the
    image ends, and the share of it in sight, 0 to 1."""

    kind: int
    box: np.ndarray
    share: float


class Detector:
    """What the first network of a bundle finds in single images, as inference shows them to it,
    without tiles (docs/explanation/pipeline.md).

    names       of its classes
    threshold   score from which inference takes a box
    """

    def __init__(self, bundle: Path):
        about = description.read(bundle)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        file = bundle / about["graphs"]["features"]
        self._session = onnxruntime.InferenceSession(file, options)
        self._input = SimpleNamespace(**about["input"])
        *_, height, _ = self._session.get_inputs()[0].shape
        # A name, where the graph takes images of any size.
        self._tiling = tiling_of(about) if isinstance(height, str) else None
        self.names = [one["name"] for one in about["classes"]]
        self.threshold = about["detector"]["score_threshold"]
        self._bounds = [_bounds(bundle, one) for one in about["classes"]]

    def __call__(self, rgb: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Boxes [n, 4] px of the image, scores [n] of at least `LEAST`, and numbers of classes [n].

        - rgb: [h, w, 3] uint8
        """
        shown = self._shown(rgb.shape)
        tensor = image_tensor(shown, rgb)[None].astype(np.float32)
        maps = self._session.run(["det_scores", "det_boxes"], {"images": tensor})
        ((boxes, scores, classes),) = peaks(*map(torch.from_numpy, maps), LEAST)
        _, scale = letterbox(rgb, shown.width, shown.height)
        boxes = (boxes + 0.5) / torch.tensor(np.tile(scale, 2)) - 0.5
        end = torch.tensor([*rgb.shape[1::-1]] * 2) - 0.5
        return boxes.clamp(torch.tensor(-0.5), end).float(), scores, classes

    def _shown(self, shape) -> SimpleNamespace:
        """The input for an image of this shape (height, width)."""
        if self._tiling is None:
            return self._input
        width, height = input_size(self._input.width, self._input.height, shape, self._tiling)
        return SimpleNamespace(**vars(self._input) | {"width": width, "height": height})

    def truth(self, group: Group, camera) -> list[Visible]:
        """What an image of a group shows of its true objects.

        - camera: of the group's rig, mvtop.Camera
        """
        found = []
        for one in group.truth:
            if camera.id not in one.visibility or one.known.name not in self.names:
                continue
            kind = self.names.index(one.known.name)
            pixels = pixels_of(self._bounds[kind], one.world_from_obj, camera)
            box, share = cut_box(pixels, camera), one.visibility[camera.id]
            if box is not None:
                share = inside(pixels, camera) if share is None else share
                found.append(Visible(kind, box, share))
        return found


def pixels_of(points: np.ndarray, world_from_obj: np.ndarray, camera) -> np.ndarray:
    """Where a camera (mvtop.Camera) images points [n, 3] m of an object: [n, 2] px, NaN where it
    images nothing."""
    cam_from_obj = np.linalg.inv(camera.world_from_cam) @ world_from_obj
    return camera.project(points @ cam_from_obj[:3, :3].T + cam_from_obj[:3, 3])


def inside(pixels: np.ndarray, camera) -> float:
    """Share of pixels [n, 2] that lie in a camera's image."""
    return float(((pixels >= -0.5) & (pixels <= np.array(camera.size) - 0.5)).all(1).mean())


def cut_box(pixels: np.ndarray, camera) -> np.ndarray | None:
    """Box [4] px around pixels [n, 2], cut off where a camera's image ends; None beside it."""
    seen = pixels[np.isfinite(pixels).all(1)]
    if not len(seen):
        return None
    box = around(seen).clip(-0.5, np.array([*camera.size] * 2) - 0.5)
    return box if (box[2:] - box[:2]).min() > 0 else None


def _bounds(bundle: Path, known: dict) -> np.ndarray:
    """The outermost points [n, 3] of a class, m."""
    if "mesh" in known:
        mesh, _ = meshfile.load(bundle / known["mesh"], process=False)
        return surface.outermost(np.asarray(mesh.vertices))
    points = read_json(bundle / known["points"], "name another bundle")["points"]
    return surface.outermost(np.array(points)[:, :3])
