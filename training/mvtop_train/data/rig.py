"""Cameras of a rig file (docs/rig.md), to render through; `mvtop-core` checks them strictly."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError
from .objects import UNITS

KEYS = ("id", "width", "height", "fx", "fy", "cx", "cy")


@dataclass(frozen=True)
class Camera:
    """A pinhole: what is left of the camera when its images are undistorted."""

    id: str
    width: int
    height: int
    k: np.ndarray  # [3, 3], px
    cam_from_rig: np.ndarray  # [4, 4], m
    distorted: bool

    def at_width(self, width: int) -> "Camera":
        """The same camera with images at most `width` px wide."""
        scale = min(1.0, width / self.width)
        size = round(self.width * scale), round(self.height * scale)
        k = self.k.copy()
        for axis, (new, old) in enumerate(zip(size, (self.width, self.height), strict=True)):
            k[axis, axis] *= new / old
            k[axis, 2] = (k[axis, 2] + 0.5) * new / old - 0.5
        return Camera(self.id, *size, k, self.cam_from_rig, self.distorted)


def load(path: Path) -> list[Camera]:
    """All cameras; one sentence on what is wrong with the file otherwise."""
    try:
        rig = json.loads(Path(path).read_text())
        if rig.get("format") != "mvtop-rig" or rig.get("version") != 1:
            raise ValueError('expected "format": "mvtop-rig" and "version": 1')
        if rig.get("unit") not in UNITS:
            raise ValueError(f'expected "unit" of {list(UNITS)}, got {rig.get("unit")!r}')
        if not rig.get("cameras"):
            raise ValueError("expected at least one camera, got none")
        return [_camera(entry, UNITS[rig["unit"]]) for entry in rig["cameras"]]
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise UserError(f"rig {path}: {error}; fix: see docs/rig.md") from None


def _camera(entry: dict, metres: float) -> Camera:
    missing = [key for key in KEYS if key not in entry]
    if missing:
        raise ValueError(f"camera {entry.get('id')!r}: expected {missing[0]!r}, got none")
    given = [key for key in ("T_world_cam", "T_cam_world") if key in entry]
    if len(given) != 1:
        raise ValueError(
            f"camera {entry['id']!r}: expected one of T_world_cam and T_cam_world, got {len(given)}"
        )
    pose = _transform(entry[given[0]], f"camera {entry['id']!r}: {given[0]}")
    pose[:3, 3] *= metres
    if given[0] == "T_world_cam":
        pose = np.linalg.inv(pose)
    fx, fy, cx, cy = (float(entry[key]) for key in KEYS[3:])
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    params = (entry.get("distortion") or {}).get("params", [])
    bent = entry.get("model") == "fisheye" or any(params)
    return Camera(str(entry["id"]), int(entry["width"]), int(entry["height"]), k, pose, bent)


def _transform(value, name: str) -> np.ndarray:
    """4x4 rows, or `t` with `q_wxyz` or `q_xyzw`, as a matrix [4, 4]."""
    pose = np.eye(4)
    if isinstance(value, dict):
        pose[:3, 3] = value["t"]
        x, y, z, w = value["q_xyzw"] if "q_xyzw" in value else np.roll(value["q_wxyz"], -1)
        if abs(np.linalg.norm([x, y, z, w]) - 1) > 1e-3:
            raise ValueError(f"{name}: expected a unit quaternion, got {[x, y, z, w]}")
        pose[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    else:
        pose = np.array(value, float)
        if pose.shape != (4, 4):
            raise ValueError(f"{name}: expected 4x4 numbers, got {pose.shape}")
    u, _, vt = np.linalg.svd(pose[:3, :3])
    nearest = u @ vt
    if np.abs(pose[:3, :3] - nearest).max() > 1e-3 or np.linalg.det(nearest) < 0:
        raise ValueError(f"{name}: expected a rotation, got {pose[:3, :3].tolist()}")
    pose[:3, :3] = nearest  # what it is off by is rounding
    return pose
