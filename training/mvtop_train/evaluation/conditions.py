"""Images as a camera takes them in other light, from farther away, or mounted another way."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..data.views import warp

# Factors on the 8-bit values of red, green and blue.
COLORS = {
    "plain": (1.0, 1.0, 1.0),
    "warmer": (1.15, 1.0, 0.85),
    "colder": (1 / 1.15, 1.0, 1 / 0.85),
    "darker": (0.6, 0.6, 0.6),
    "brighter": (1.4, 1.4, 1.4),
}
HALF, TURNED, ZOOMED = "half", "turned", "zoomed"
NAMES = (*COLORS, HALF, TURNED, ZOOMED)
FILL = (124, 116, 104)  # RGB beside an image: what networks of ours take as zero


@dataclass(frozen=True)
class Shown:
    """A picture of an image.

    rgb      [h, w, 3] uint8
    moved    [3, 3], from the image's pixels to its own: scale, shift and quarter turns
    about    number of the true box that alone is asked for; None: all are
    """

    rgb: np.ndarray
    moved: np.ndarray
    about: int | None = None

    def box(self, box: np.ndarray) -> np.ndarray:
        """A box [4] of the image, in the picture; not cut off by its border."""
        corners = np.array([[*box[:2], 1.0], [*box[2:], 1.0]]) @ self.moved.T
        return np.concatenate([corners[:, :2].min(0), corners[:, :2].max(0)])


def pictures(name: str, rgb: np.ndarray, boxes: list[np.ndarray]) -> Iterator[Shown]:
    """What a condition makes of an image.

    - name: one of `NAMES`; `half` is the image at half its size in a picture as large as before,
      `turned` a camera turned by 90 degrees, `zoomed` one picture for each true box, twice as
      large, with the box in its middle
    - rgb: [h, w, 3] uint8
    - boxes: [4] each, px
    """
    size = np.array(rgb.shape[1::-1])
    if name in COLORS:
        yield Shown((rgb * np.array(COLORS[name])).clip(0, 255).astype(np.uint8), np.eye(3))
    elif name == HALF:
        middle = (size - 1) / 2
        yield _scaled(rgb, 0.5, middle)
    elif name == TURNED:
        turn = np.array([[0, -1, size[1] - 1], [1, 0, 0], [0, 0, 1.0]])
        yield Shown(np.ascontiguousarray(np.rot90(rgb, -1)), turn)
    else:
        for number, box in enumerate(boxes):
            shown = _scaled(rgb, 2.0, box.reshape(2, 2).mean(0))
            yield Shown(shown.rgb, shown.moved, number)


def _scaled(rgb: np.ndarray, scale: float, about: np.ndarray) -> Shown:
    """The image scaled, a pixel [2] of it in the middle of a picture as large as it is."""
    size = rgb.shape[1::-1]
    moved = np.diag([scale, scale, 1.0])
    moved[:2, 2] = (np.array(size) - 1) / 2 - scale * about
    picture, on_image = warp(rgb, moved, size, max(1, round(1 / scale)))
    return Shown(np.where(on_image[..., None], picture, np.uint8(FILL)), moved)
