"""Whole images as the detector is shown them, turned, scaled and shifted at random."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..network.config import Config
from . import bop
from .boxes import amodal_boxes, around
from .closeup import roll_by
from .color import photometric
from .composite import Composer
from .objects import Object
from .views import lies_on, warp

ZOOM = 0.35  # deviation of the logarithm of a picture's scale, which is about 1:
LIMITS = (0.35, 2.5)  # of it, where 1 is the scale at which inference shows the image
AIMED = 0.7  # share of the pictures that are made around one of the objects
SURE, UNSURE = 0.35, 0.1  # shares in sight from which an object shall, and may, be found
MOST = 128  # objects in a picture
OCCLUDED = 0.35  # share of the objects that get an occluder
NOBODY = -1
GRID = 16  # points along each side of a box, at which it is asked what shows it


@dataclass(frozen=True)
class Thing:
    """An object in a picture: its box [4] px, the number of its class, the share of it in sight,
    and whose pixels are its (`bop.read_coords`); `NOBODY`: that is not known."""

    box: np.ndarray
    kind: int
    share: float
    owner: int


@dataclass(frozen=True)
class Searches:
    """Makes what the detector learns from: pictures and the boxes in them.

    zoom  deviation of the logarithm of their scale, within `LIMITS`
    """

    config: Config
    objects: tuple[Object, ...]
    composer: Composer | None = None
    zoom: float = ZOOM

    def make(self, image: bop.Image, rng, augment: bool = True) -> dict[str, np.ndarray]:
        """search_image [H, W, 3], search_on_image [H, W], search_boxes [MOST, 4] (0: none) and
        search_class [MOST], -1 where so little of the object is seen that either is right."""
        size = self.config.width, self.config.height
        rgb = bop.read_rgb(image.path)
        k, turn = self._camera(image, rgb.shape, rng, augment)
        view_from_image = k @ turn @ np.linalg.inv(image.k)
        scale = k[0, 0] / image.k[0, 0]
        picture, on_image = warp(rgb, view_from_image, size, int(np.ceil(min(1 / scale, 8))))
        things = self._things(image, rgb.shape, k, turn, view_from_image)
        if augment and self.composer is not None:
            _, whose = bop.read_coords(image, rgb.shape[:2])
            if whose is not None:
                nearest = cv2.INTER_NEAREST
                whose = cv2.warpPerspective(whose, view_from_image, size, flags=nearest)
                picture = self.composer.behind(picture, whose, rng)
                picture, things = self._hidden(picture, things, whose, rng)
        if augment:
            picture = photometric(picture, rng)
        boxes, index = np.zeros((MOST, 4), np.float32), np.full(MOST, -1)
        shown = [one for one in things if one.share >= UNSURE][:MOST]
        for n, one in enumerate(shown):
            boxes[n], index[n] = one.box, one.kind if one.share >= SURE else -1
        return {
            "search_image": picture,
            "search_on_image": on_image,
            "search_boxes": boxes,
            "search_class": index,
        }

    def _things(self, image: bop.Image, shape, k, turn, view_from_image) -> list[Thing]:
        """What the picture shows of the objects."""
        turned, edge = np.eye(4), np.array([self.config.width, self.config.height] * 2) - 0.5
        turned[:3, :3] = turn
        things = []
        for one, kind in self._known(image):
            box = amodal_boxes(self.objects[kind].bounds, k, turned @ one.cam_from_obj)
            cut = box.clip(-0.5, edge)
            on_image, on_picture = _shown(box, edge[:2], view_from_image, shape)
            inside = on_image & on_picture
            share = inside.mean()
            if one.visible_share is not None:  # in which what the image cuts off is not in sight
                share = one.visible_share * inside.sum() / max(on_image.sum(), 1)
            if share >= UNSURE and (cut[2:] - cut[:2]).min() > 4:
                things.append(Thing(cut, kind, share, one.annotation + 1))
        for box in image.unsure:
            cut = around(_moved(view_from_image, box)).clip(-0.5, edge)
            if (cut[2:] - cut[:2]).min() > 0:
                things.append(Thing(cut, 0, UNSURE, NOBODY))
        return things

    def _hidden(self, picture, things: list[Thing], whose, rng):
        """The picture with something before some things, and these with what is seen of them."""
        hidden = np.zeros_like(whose)
        for one in things:
            if rng.random() < OCCLUDED:
                picture, where = self.composer.before(picture, one.box, rng)
                hidden |= where
        for n, one in enumerate(things):
            seen = whose == one.owner
            if seen.any():
                things[n] = replace(one, share=one.share * (hidden[seen] == 0).mean())
        return picture, things

    def _camera(self, image, shape, rng, augment: bool):
        """k [3, 3] of the picture and the turn [3, 3] that comes before it."""
        size = np.array([self.config.width, self.config.height])
        fit = (size / shape[1::-1]).min()
        zoom, roll, shift = 1.0, 0.0, np.zeros(2)
        middle = (np.array(shape[1::-1]) - 1) / 2
        if augment:
            middle = self._aim(image, middle, rng)
            zoom = np.exp(rng.normal(0, self.zoom)).clip(*LIMITS)
            roll = rng.uniform(-np.pi, np.pi) if rng.random() < 0.4 else rng.normal(0, 0.3)
            shift = rng.uniform(-0.35, 0.35, 2) * size
        k = np.diag([fit * zoom * image.k[0, 0], fit * zoom * image.k[1, 1], 1.0])
        turn = roll_by(roll)
        middle = turn @ np.linalg.inv(image.k) @ [*middle, 1.0]
        k[:2, 2] = (size - 1) / 2 + shift - (k @ middle)[:2] / middle[2]
        return k, turn

    def _aim(self, image: bop.Image, middle, rng):
        """The pixel of the image that the picture is made around: an object's or its `middle`."""
        known = self._known(image)
        if not known or rng.random() >= AIMED:
            return middle
        one, kind = known[rng.integers(len(known))]
        box = amodal_boxes(self.objects[kind].bounds, image.k, one.cam_from_obj)
        return box.reshape(2, 2).mean(0).clip(0, 2 * middle)

    def _known(self, image: bop.Image) -> list[tuple[bop.Instance, int]]:
        """What the image holds of the objects, with the numbers of their classes."""
        kinds = {obj.id: n for n, obj in enumerate(self.objects)}
        return [(one, kinds[one.obj_id]) for one in image.instances if one.obj_id in kinds]


def _moved(view_from_image: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Where a homography [3, 3] takes the corners of a box [4]: [4, 2] px."""
    x0, y0, x1, y1 = box
    corners = np.array([[x0, y0, 1], [x1, y0, 1], [x0, y1, 1], [x1, y1, 1]]) @ view_from_image.T
    return corners[:, :2] / corners[:, 2:]


def _shown(box, edge, view_from_image, shape) -> tuple[np.ndarray, np.ndarray]:
    """Which of `GRID` x `GRID` points of a box lie on the image, and which in the picture.

    box [4] in the picture, px; edge [2]: where that ends; shape: of the image (height, width)
    """
    u, v = (np.linspace(low, high, GRID) for low, high in zip(box[:2], box[2:], strict=True))
    on_picture = ((u >= -0.5) & (u <= edge[0])) & ((v >= -0.5) & (v <= edge[1]))[:, None]
    return lies_on(u, v[:, None], view_from_image, shape), on_picture
