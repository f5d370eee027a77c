"""Views: what virtual cameras show of a data set's images, and batches of them.

A virtual camera stands where the real one does; only its direction, its roll and its focal length
are its own. For a pinhole such a picture is exact (a homography of the image), so poses and lines
of sight stay exact. Which camera looks at an image is a choice: `crops`, `closeup`.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from ..network.config import Config
from ..network.rays import cell_centers
from . import bop
from .boxes import amodal_boxes
from .color import photometric
from .composite import Composer
from .objects import Object

COORDINATE_STRIDE = 4


@dataclass(frozen=True)
class VirtualCamera:
    """A pinhole at the place of a real one.

    k              [3, 3] px
    view_from_cam  [3, 3] rotation from the real camera's axes to its own
    size           side of its picture, px
    box            [4] in its picture: the object as a detector might give it, px
    taps           samples along each axis of a pixel, against aliasing
    """

    k: np.ndarray
    view_from_cam: np.ndarray
    size: int
    box: np.ndarray
    taps: int = 1

    def view_from_image(self, k: np.ndarray) -> np.ndarray:
        """Homography [3, 3] from the pixels of the real camera, a pinhole `k`, to its own."""
        return self.k @ self.view_from_cam @ np.linalg.inv(k)


# (image, its shape, the object's outermost points [n, 3] m, random numbers, whether to augment)
# -> camera
Choice = Callable[
    [bop.Image, tuple[int, ...], np.ndarray, np.random.Generator, bool], VirtualCamera
]


@dataclass(frozen=True)
class ViewMaker:
    """How the views of a data set are made: through which cameras, for which network.

    objects   those of the network's classes, in their order
    augment   whether cameras and colors are varied
    composer  what puts other things behind and before the object, if anything
    """

    choose: Choice
    config: Config
    objects: tuple[Object, ...]
    augment: bool = True
    composer: Composer | None = None

    def make_view(self, image: bop.Image, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """The image through a virtual camera, as arrays.

        image [S, S, 3] uint8, on_image [S, S] and inside [N]: whether the centers of pixels and
        of the network's cells lie on the source; k, cam_from_world, cam_from_obj; box, what the
        decoder is given, and true_box, both cut off where the picture ends; coords, see
        `coordinates`, and the extent in whose units they are, m; class_index.
        """
        one_thread()
        rgb, instance = bop.read_rgb(image.path), image.only
        index = [obj.id for obj in self.objects].index(instance.obj_id)
        bounds = self.objects[index].bounds
        camera = self.choose(image, rgb.shape, bounds, rng, self.augment)
        view_from_image, size = camera.view_from_image(image.k), camera.size
        picture, on_image = warp(rgb, view_from_image, (size, size), camera.taps)
        code, who = bop.read_coords(image, rgb.shape[:2])
        owner, hidden = instance.annotation + 1, None
        if self.augment:
            if self.composer is not None:
                seen = None if who is None else _nearest(who, view_from_image, size)
                picture, hidden = self.composer.around(picture, seen, owner, camera.box, rng)
            picture = photometric(picture, rng)
        coords = coordinates(code, who, owner, view_from_image, size)
        if hidden is not None:
            coords *= _nearest(hidden, _cells_from_view(), len(coords))[..., None] == 0
        cam_from_obj = _turned(camera.view_from_cam, image.cam_from_obj)
        end = size - 0.5
        return {
            "image": picture,
            "on_image": on_image,
            "inside": lies_on(*_cells(self.config, size), view_from_image, rgb.shape),
            "k": camera.k,
            "cam_from_world": _turned(camera.view_from_cam, image.cam_from_world),
            "cam_from_obj": cam_from_obj,
            "box": camera.box.clip(-0.5, end),
            "true_box": amodal_boxes(bounds, camera.k, cam_from_obj).clip(-0.5, end),
            "coords": coords,
            "extent": np.float64(self.objects[index].extent_m),
            "class_index": np.int64(index),
        }


@functools.cache
def _cells(config: Config, size: int) -> np.ndarray:
    """Centers (u, v) [2, N] of the network's cells in a picture, px."""
    return cell_centers(config.level_shapes(size, size), config.pose_strides).double().numpy().T


def _turned(rotation: np.ndarray, pose: np.ndarray) -> np.ndarray:
    out = pose.copy()
    out[:3] = rotation @ pose[:3]
    return out


def warp(rgb: np.ndarray, view_from_image: np.ndarray, size: tuple[int, int], taps: int = 1):
    """(picture [h, w, 3] uint8, on_image [h, w] bool) under a homography; size is (w, h).

    A pixel is the mean of `taps` x `taps` bilinear samples of `rgb`; `on_image` says whether its
    center lies on `rgb`. What does not is replaced by 0 in `inputs.to_views`.
    """
    finer = np.array([[taps, 0, (taps - 1) / 2], [0, taps, (taps - 1) / 2], [0, 0, 1]])
    picture = cv2.warpPerspective(
        rgb, finer @ view_from_image, (size[0] * taps, size[1] * taps),
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    if taps > 1:
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    u, v = np.arange(size[0]), np.arange(size[1])[:, None]
    return picture, lies_on(u, v, view_from_image, rgb.shape)


def _nearest(values: np.ndarray, view_from_image: np.ndarray, size: int) -> np.ndarray:
    return cv2.warpPerspective(values, view_from_image, (size, size), flags=cv2.INTER_NEAREST)


def one_thread():
    """Lets OpenCV work on one thread: several processes share the cores. Also before processes are
    forked, in which its threads would be missing and be waited for without end."""
    cv2.setNumThreads(1)


def lies_on(u, v, view_from_image: np.ndarray, shape) -> np.ndarray:
    """Whether pixels (u, v) of a view, of shapes that go together, lie on an image [h, w, ...]."""
    x, y, w = (row[0] * u + (row[1] * v + row[2]) for row in np.linalg.inv(view_from_image))
    # Of the source: x / w from -0.5 to width - 0.5, in front of the camera.
    right, bottom = shape[1] - 0.5, shape[0] - 0.5
    on_x = (x >= -0.5 * w) & (x <= right * w)
    return on_x & (y >= -0.5 * w) & (y <= bottom * w) & (w > 0)


def _cells_from_view() -> np.ndarray:
    """Homography [3, 3] from a view's pixels to blocks of COORDINATE_STRIDE px."""
    s = 1 / COORDINATE_STRIDE
    return np.array([[s, 0, s / 2 - 0.5], [0, s, s / 2 - 0.5], [0, 0, 1]])


def coordinates(code, who, owner: int, view_from_image, size: int) -> np.ndarray:
    """Coded object coordinates [cells, cells, 3], one per COORDINATE_STRIDE px, at the center of
    its block; 0 off the object, and everywhere if the data set has none (`bop.read_coords`)."""
    cells = size // COORDINATE_STRIDE
    if code is None:
        return np.zeros((cells, cells, 3), np.uint8)
    view = _cells_from_view() @ view_from_image
    return _nearest(code, view, cells) * (_nearest(who, view, cells) == owner)[..., None]


def collate(items: list[list[dict]]) -> dict[str, torch.Tensor]:
    """Scenes x views of `ViewMaker.make_view` (or of a bank) as tensors [B, V, ...].

    Instead of `cam_from_world` there is `ref_from_cam`; numbers are float32; class_index [B, 1].
    """
    arrays = {n: np.stack([[view[n] for view in views] for views in items]) for n in items[0][0]}
    world = arrays.pop("cam_from_world")
    arrays["ref_from_cam"] = world[:, :1] @ np.linalg.inv(world)
    arrays["class_index"] = arrays["class_index"][:, :1]
    return {
        name: torch.from_numpy(x.astype(np.float32) if x.dtype == np.float64 else x)
        for name, x in arrays.items()
    }
