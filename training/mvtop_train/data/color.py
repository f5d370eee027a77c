"""Photometric augmentation."""

import cv2
import numpy as np


def photometric(rgb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Exposure, contrast, color cast, blur and noise; the parts' colors stay apart."""
    x = rgb.astype(np.float32)
    if rng.random() < 0.8:
        gain = rng.uniform(0.65, 1.4) * rng.uniform(0.88, 1.12, 3).astype(np.float32)
        x = (x - 110) * rng.uniform(0.75, 1.25) + 110
        x = x * gain.astype(np.float32) + rng.uniform(-18, 18)
    if rng.random() < 0.25:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.4, 1.1))
    if rng.random() < 0.5:
        noise = rng.standard_normal(x.shape[:2] + (1,), dtype=np.float32)
        x = x + noise * rng.uniform(1, 10)
    return x.clip(0, 255).astype(np.uint8)
