"""Reading and writing scenes in BOP layout (millimetres, OpenCV axes, integer pixel = centre).

Beside BOP's own files a scene has `coords/IM.png`: the object-frame position of each visible
object pixel, cut to `bbox_visib` and coded in 8 bits per axis; 0 means "not the object".
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from . import mvball
from .scenes import View, amodal_box, object_coordinates

JPEG_QUALITY = 95


@dataclass
class Image:
    """One annotated image of one object."""

    path: Path
    coords_path: Path
    k: np.ndarray  # [3, 3], px
    cam_from_world: np.ndarray  # [4, 4], m
    cam_from_obj: np.ndarray  # [4, 4], m
    box: np.ndarray  # amodal [x0, y0, x1, y1], px
    visible_box: np.ndarray  # [x, y, w, h] of the coords file, px
    shows: str


def encode_coords(coords: np.ndarray) -> np.ndarray:
    """Metres [.., 3] (NaN: none) to uint8, half the object's extent on either side of 128."""
    code = np.round(128 + coords / mvball.EXTENT * 120)
    return np.where(np.isnan(coords), 0, code).astype(np.uint8)


def decode_coords(code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Object coordinates in units of the object's extent [.., 3], and the mask [..]."""
    return (code.astype(np.float32) - 128) / 120, (code != 0).all(-1)


def pose_from_bop(rotation, translation_mm) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(rotation, (3, 3))
    pose[:3, 3] = np.array(translation_mm) / 1000
    return pose


def write_scene(folder: Path, views: list[View]):
    """Write one scene; the annotation comes last, so a folder that has it is whole."""
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    (folder / "coords").mkdir(exist_ok=True)
    camera, gt, info = {}, {}, {}
    points = mvball.bounding_points()
    for i, view in enumerate(views):
        jpeg = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        cv2.imwrite(str(folder / "rgb" / f"{i:06d}.jpg"), view.rgb[:, :, ::-1], jpeg)
        v, u = np.nonzero(view.mask)
        x, y, w, h = u.min(), v.min(), u.max() - u.min(), v.max() - v.min()
        code = encode_coords(object_coordinates(view)[y : y + h + 1, x : x + w + 1])
        cv2.imwrite(str(folder / "coords" / f"{i:06d}.png"), code[:, :, ::-1])
        camera[i] = {
            "cam_K": view.k.ravel().tolist(),
            "depth_scale": 1.0,
            "cam_R_w2c": view.cam_from_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (view.cam_from_world[:3, 3] * 1000).tolist(),
        }
        pose = view.cam_from_obj
        gt[i] = [
            {
                "cam_R_m2c": pose[:3, :3].ravel().tolist(),
                "cam_t_m2c": (pose[:3, 3] * 1000).tolist(),
                "obj_id": mvball.OBJ_ID,
            }
        ]
        box = amodal_box(view, points)
        info[i] = [
            {
                "bbox_obj": [*box[:2].tolist(), *(box[2:] - box[:2]).tolist()],
                "bbox_visib": [int(x), int(y), int(w), int(h)],
                "px_count_visib": int(view.mask.sum()),
                "px_count_hemisphere": view.bump_pixels,
                "hemisphere": view.shows,
            }
        ]
    for name, content in (("scene_camera", camera), ("scene_gt_info", info), ("scene_gt", gt)):
        (folder / f"{name}.json").write_text(json.dumps(content))


def is_whole(folder: Path) -> bool:
    return (folder / "scene_gt.json").exists()


def read_scene(folder: Path) -> list[Image]:
    """All images of a scene that show one object of the data set."""
    camera, gt, info = (
        json.loads((folder / f"{name}.json").read_text())
        for name in ("scene_camera", "scene_gt", "scene_gt_info")
    )
    images = []
    for key in sorted(camera, key=int):
        pose, about = gt[key][0], info[key][0]
        x, y, w, h = about["bbox_obj"]
        images.append(
            Image(
                path=folder / "rgb" / f"{int(key):06d}.jpg",
                coords_path=folder / "coords" / f"{int(key):06d}.png",
                k=np.reshape(camera[key]["cam_K"], (3, 3)),
                cam_from_world=pose_from_bop(camera[key]["cam_R_w2c"], camera[key]["cam_t_w2c"]),
                cam_from_obj=pose_from_bop(pose["cam_R_m2c"], pose["cam_t_m2c"]),
                box=np.array([x, y, x + w, y + h]),
                visible_box=np.array(about["bbox_visib"]),
                shows=about["hemisphere"],
            )
        )
    return images


def write_models(folder: Path):
    """`models/` with the object's mesh points (PLY, mm, vertex colours) and `models_info.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "models_info.json").write_text(json.dumps(mvball.models_info(), indent=1))
    points, colours = mvball.surface_points(4000)
    lines = [
        "ply", "format ascii 1.0", f"element vertex {len(points)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")), "end_header",
    ]  # fmt: skip
    lines += [
        f"{x:.4f} {y:.4f} {z:.4f} {r:.0f} {g:.0f} {b:.0f}"
        for (x, y, z), (r, g, b) in zip(points * 1000, colours, strict=True)
    ]
    (folder / f"obj_{mvball.OBJ_ID:06d}.ply").write_text("\n".join(lines) + "\n")
