"""From image messages to arrays. What a message says of itself is checked first."""

import io

import numpy as np
from PIL import Image

# Channels, and which of them are red, green and blue.
_ENCODINGS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
    "8UC1": (1, (0, 0, 0)),
    "8UC3": (3, (2, 1, 0)),  # OpenCV's order
    "8UC4": (4, (2, 1, 0)),
}
_FORMATS = ("JPEG", "PNG")


def check_raw(message):
    """Refuses a `sensor_msgs/Image` whose numbers do not agree, at no cost."""
    if message.encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise ValueError(
            f"encoding: expected one of {known}, got `{message.encoding}`; convert it, with "
            "image_proc for Bayer patterns"
        )
    row = message.width * _ENCODINGS[message.encoding][0]
    step, height = message.step, message.height
    if not row or not height or step < row or len(message.data) != step * height:
        raise ValueError(
            f"image: expected {height} rows of {step} bytes with {row} in use, got "
            f"{len(message.data)} bytes; its width, height, step and data must agree"
        )


def of_raw(message, size=None):
    """An array (H, W, 3) of uint8, RGB, of a `sensor_msgs/Image`.

    - size: expected width and height, px; of any size by default
    """
    check_raw(message)
    _refuse_other_size((message.width, message.height), size)
    channels, order = _ENCODINGS[message.encoding]
    height, width = message.height, message.width
    rows = np.frombuffer(message.data, np.uint8).reshape(height, message.step)
    pixels = rows[:, : width * channels].reshape(height, width, channels)
    return np.ascontiguousarray(pixels[..., order])


def of_compressed(message, size=None):
    """The same of a `sensor_msgs/CompressedImage`, JPEG or PNG."""
    try:
        with Image.open(io.BytesIO(bytes(message.data)), formats=_FORMATS) as picture:
            _refuse_other_size(picture.size, size)  # before it is decoded
            if picture.mode in ("I", "F") or picture.mode.startswith("I;"):
                raise ValueError(f"image: expected 8 bits, got mode {picture.mode}")
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError, Image.DecompressionBombError) as problem:
        raise ValueError(f"image: expected a JPEG or PNG, got what gives: {problem}") from None


def _refuse_other_size(got, expected):
    if expected is not None and tuple(got) != tuple(expected):
        raise ValueError(
            f"image: expected {expected[0]}x{expected[1]} px as calibrated, got {got[0]}x{got[1]}"
        )
