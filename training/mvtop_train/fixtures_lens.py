"""Write `fixtures/lens.safetensors`: points and the pixels at which OpenCV images them.

    python -m mvtop_train.fixtures_lens fixtures/lens.safetensors

Needs OpenCV 5 (`opencv-python`). Per lens NAME, all float64:

    NAME.intrinsics  [4]     fx fy cx cy, px
    NAME.params      [k]     OpenCV's order
    NAME.points      [P, 3]  camera frame
    NAME.pixels      [P, 2]  px
"""

import sys

import cv2
import numpy as np
from safetensors.numpy import save_file

SEED = 7
POINTS = 64

# Name, intrinsics, coefficients, widest angle from the axis in degrees. The angles stay short of
# where the lens folds back, past which OpenCV's formula no longer describes a lens.
LENSES = [
    ("pinhole_0", (600.0, 605.0, 320.0, 240.0), (), 60.0),
    ("pinhole_4", (1045.1, 1043.7, 641.2, 355.9), (-0.21, 0.07, 1.1e-3, -6.0e-4), 40.0),
    ("pinhole_5", (863.73, 863.22, 637.52, 385.53), (0.0885, -0.226, -1.5e-4, 5.7e-4, 0.11), 35.0),
    (
        "pinhole_8",
        (605.3, 604.9, 638.1, 366.4),
        (0.62, -2.41, 7.0e-4, -2.3e-4, 1.39, 0.49, -2.22, 1.31),
        40.0,
    ),
    ("fisheye", (278.0, 279.0, 315.5, 244.5), (-0.006, 0.016, -0.024, 0.0155), 80.0),
]


def points_within(degrees, rng):
    """[POINTS, 3], at most that far from the axis, 0.3 to 4 m away."""
    angle = np.radians(degrees) * np.sqrt(rng.uniform(0, 1, POINTS))
    around = rng.uniform(0, 2 * np.pi, POINTS)
    across = np.sin(angle)
    directions = np.stack([across * np.cos(around), across * np.sin(around), np.cos(angle)], axis=1)
    return directions * rng.uniform(0.3, 4.0, (POINTS, 1))


def main(path):
    rng = np.random.default_rng(SEED)
    tensors = {}
    for name, (fx, fy, cx, cy), params, degrees in LENSES:
        points = points_within(degrees, rng)
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        coefficients = np.array(params, dtype=np.float64)
        project = cv2.fisheye.projectPoints if name == "fisheye" else cv2.projectPoints
        none = np.zeros((3, 1))
        pixels, _ = project(points[:, None], none, none, matrix, coefficients)
        tensors |= {
            f"{name}.intrinsics": np.array([fx, fy, cx, cy]),
            f"{name}.params": coefficients,
            f"{name}.points": points,
            f"{name}.pixels": np.ascontiguousarray(pixels[:, 0]),
        }
    versions = {"opencv": cv2.__version__, "numpy": np.__version__, "seed": str(SEED)}
    save_file(tensors, path, metadata=versions)


if __name__ == "__main__":
    main(sys.argv[1])
