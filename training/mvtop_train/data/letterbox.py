"""A whole image as the network's input holds it; counterpart of `mvtop-core/src/image.rs`."""

import numpy as np
from PIL import Image as PilImage

COARSEST = 32  # px, stride of a detector's coarsest features


def input_size(width: int, height: int, shape, tiling: dict[str, float]) -> tuple[int, int]:
    """Width and height, px, at which a detector that takes any size is shown an image.

    - width, height: of the bundle's input, px
    - shape: (height, width) of the image
    - tiling: `full_scale` and `max_input` of `inference.tiling`
    """
    h, w = shape[:2]
    fitting = min(width / w, height / h)
    largest = (tiling["max_input"] * width * height / (w * h)) ** 0.5
    scale = max(min(tiling["full_scale"], largest), fitting)
    return tuple(-(-round(side * scale) // COARSEST) * COARSEST for side in (w, h))


def letterbox(rgb: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """The image resized to fit, and its scale per axis; nothing is padded here."""
    h, w = rgb.shape[:2]
    scale = min(width / w, height / h)
    size = round(w * scale), round(h * scale)
    if size != (w, h):
        image = PilImage.fromarray(rgb).resize(size, PilImage.Resampling.BILINEAR)
        rgb = np.asarray(image)
    return rgb, np.array([size[0] / w, size[1] / h])


def normalised_picture(config, rgb: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8 to [3, h, w] with the mean and spread that the network expects."""
    return ((rgb / 255 - np.array(config.mean)) / np.array(config.std)).transpose(2, 0, 1)


def image_tensor(config, rgb: np.ndarray) -> np.ndarray:
    """[3, H, W], at the top left of the network's input."""
    small, _ = letterbox(rgb, config.width, config.height)
    tensor = np.zeros((3, config.height, config.width))
    tensor[:, : small.shape[0], : small.shape[1]] = normalised_picture(config, small)
    return tensor
