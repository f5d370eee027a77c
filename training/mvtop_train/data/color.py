"""Photometric augmentation: what a camera makes of the light, in the order in which it does so."""

import cv2
import numpy as np

GAMMA = 2.2  # about that of sRGB
# From 8 bits of sRGB to linear light, 0 to 1.
LINEAR = (np.arange(256, dtype=np.float32) / 255) ** GAMMA


def photometric(rgb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Light and lens, sensor, processing and compression of one camera.

    Colors stay apart: hues turn with the white balance, but none into another.
    """
    if rng.random() < 0.1:
        return rgb
    x = LINEAR[rgb]
    x = _light(x, rng)
    x = _lens(x, rng)
    x = _sensor(x, rng)
    x = _processing(x, rng)
    picture = (x.clip(0, 1) * 255).astype(np.uint8)
    if rng.random() < 0.4:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 96))]
        picture = cv2.imdecode(cv2.imencode(".jpg", picture, quality)[1], cv2.IMREAD_COLOR)
    return picture


def _light(x, rng):
    """Exposure and white balance, and light that falls off across the picture."""
    if rng.random() < 0.6:  # what a camera does by itself
        x = x * np.float32(np.clip(0.2 / max(x.mean(), 1e-3), 0.5, 4.0))
    gain = np.exp(rng.normal(0, 0.45)).clip(0.3, 3.0) * np.exp(rng.normal(0, 0.18, 3))
    x = x * gain.astype(np.float32)
    if rng.random() < 0.3:
        height, width = x.shape[:2]
        u, v = np.linspace(-1, 1, width), np.linspace(-1, 1, height)[:, None]
        slope = rng.normal(0, 0.25, 2)
        fall = np.exp(slope[0] * u + slope[1] * v).astype(np.float32)
        x = x * fall[..., None]
    return x


def _lens(x, rng):
    if rng.random() < 0.35:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.3, 1.8))
    if rng.random() < 0.2:
        length = rng.uniform(2, 9)
        side = int(np.ceil(length)) | 1
        kernel, middle = np.zeros((side, side), np.float32), side // 2
        angle = rng.uniform(0, np.pi)
        reach = np.array([np.cos(angle), np.sin(angle)]) * (length - 1) / 2
        ends = [tuple(np.round((middle + s * reach) * 16).astype(int).tolist()) for s in (-1, 1)]
        cv2.line(kernel, *ends, 1.0, 1, cv2.LINE_AA, 4)
        x = cv2.filter2D(x, -1, kernel / kernel.sum())
    return x


def _sensor(x, rng):
    """Shot noise grows with the light, read noise does not; both by color."""
    if rng.random() < 0.6:
        x = x.clip(0)
        shot, read = 10 ** rng.uniform(-4, -2.2), 10 ** rng.uniform(-3, -1.6)
        noise = rng.standard_normal(x.shape, dtype=np.float32)
        if rng.random() < 0.3:  # as left by interpolation between the color filter's pixels
            noise = cv2.GaussianBlur(noise, (0, 0), 0.7) * 2
        x = x + noise * np.sqrt(shot * x + read**2)
    return x.clip(0, 1)


def _processing(x, rng):
    x = x ** (1 / rng.uniform(1.8, 2.7))
    if rng.random() < 0.5:
        grey = x.mean(2, keepdims=True)
        x = grey + (x - grey) * rng.uniform(0.45, 1.6)
    if rng.random() < 0.5:
        x = (x - 0.45) * rng.uniform(0.6, 1.5) + 0.45 + rng.uniform(-0.12, 0.12)
    if rng.random() < 0.25:
        x = x + (x - cv2.GaussianBlur(x, (0, 0), 1.0)) * rng.uniform(0.3, 2.0)
    return x
