"""Other backgrounds behind what was rendered, and other things before it."""

from pathlib import Path

import cv2
import numpy as np

from . import backgrounds
from .bop import OTHER

# Shares of pictures with another background, of these of the object alone, and, unless told
# otherwise, with an occluder.
BEHIND, ALONE, OCCLUDED = 0.5, 0.3, 0.55
REACH = (0.12, 0.9)  # how far an occluder reaches from its middle, of the sides of what it hides
LIKE = 0.4  # share of occluders in the colors of what they hide: these mislead most


class Composer:
    """Puts pieces of pictures into views.

    occluders  share of the views that get one
    """

    def __init__(self, pictures: list[Path], occluders: float = OCCLUDED):
        self.pictures, self.occluders = pictures, occluders

    def around(self, picture, who, of: int, box, rng) -> tuple[np.ndarray, np.ndarray]:
        """A view [h, w, 3] with other things behind and before the object `of` in `box`; and where
        something is before it now [h, w], 0 or 1.

        who  [h, w] uint8: 0 background, n an object, `OTHER` anything else; None: not known
        """
        if rng.random() < ALONE:
            who = None if who is None else (who == of) * np.uint8(1)
        picture = self.behind(picture, who, rng)
        if rng.random() < self.occluders:
            return self.before(picture, box, rng)
        return picture, np.zeros(picture.shape[:2], np.uint8)

    def behind(self, picture, who, rng) -> np.ndarray:
        """A view [h, w, 3] with another background, half of the time."""
        if who is None or rng.random() >= BEHIND:
            return picture
        kept = who != 0
        if rng.random() < 0.5:
            kept = kept & (who != OTHER)
        return self._behind(picture, kept, rng)

    def _behind(self, picture, kept, rng):
        height, width = kept.shape
        other = backgrounds.cut(self.pictures, rng, height, width)
        # Soft edges, as a lens leaves them, a little inside: no old background shines through.
        alpha = cv2.erode(kept.astype(np.uint8), np.ones((3, 3), np.uint8)) * np.float32(1)
        alpha = cv2.GaussianBlur(alpha, (0, 0), rng.uniform(0.5, 1.0))[..., None]
        return np.rint(picture * alpha + other * (1 - alpha)).astype(np.uint8)

    def before(self, picture, box, rng) -> tuple[np.ndarray, np.ndarray]:
        """A blob over a part of the box, its middle within; and where it is [h, w], 0 or 1."""
        height, width = picture.shape[:2]
        size = np.maximum(box[2:] - box[:2], 4)
        middle = box[:2] + rng.uniform(0, 1, 2) * size
        corners = int(rng.integers(3, 9))
        angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        radius = rng.uniform(0.5, 1.0, (corners, 1)) * rng.uniform(*REACH) * size
        outline = middle + radius * np.stack([np.cos(angles), np.sin(angles)], 1)
        mask = np.zeros((height, width), np.uint8)
        cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 1)
        if rng.random() < 0.3:
            other = np.broadcast_to(rng.uniform(0, 255, 3), picture.shape)
        else:
            other = backgrounds.cut(self.pictures, rng, height, width)
        if rng.random() < LIKE:
            x0, y0, x1, y1 = np.clip(np.rint(box), 0, [width, height] * 2).astype(int)
            other = recolored(other, picture[y0:y1, x0:x1])
        alpha = cv2.GaussianBlur(mask * np.float32(1), (0, 0), 0.7)[..., None]
        return np.rint(picture * (1 - alpha) + other * alpha).astype(np.uint8), mask


def recolored(picture: np.ndarray, like: np.ndarray) -> np.ndarray:
    """A picture [h, w, 3] with the mean color and contrast of another (Reinhard et al. 2001)."""
    if like.size == 0:
        return picture
    mean, spread = picture.mean((0, 1)), picture.std((0, 1)).clip(8)
    scaled = (picture - mean) / spread * like.std((0, 1)) + like.mean((0, 1))
    return scaled.clip(0, 255)
