"""Reading and writing scenes in BOP layout (millimetres, OpenCV axes, integer pixel = center).

Beside BOP's own files a scene has `coords/IM.png`: the object-frame position of each visible
object pixel, coded in 8 bits per axis, 0 meaning "not the object"; its first pixel is the corner of
`bbox_visib` (of the image, where there is none). Data sets of others lack it, and at times
`scene_gt_info.json`: both may be absent. See docs/data.md.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..errors import UserError
from ..network.coordinates import STEPS, ZERO
from .boxes import amodal_boxes
from .objects import Object
from .rendered import View, amodal_box, object_coordinates

JPEG_QUALITY = 95


@dataclass
class Image:
    """One annotated image of one object."""

    path: Path
    coords_path: Path | None  # None: no object coordinates are known
    k: np.ndarray  # [3, 3], px
    cam_from_world: np.ndarray  # [4, 4], m
    cam_from_obj: np.ndarray  # [4, 4], m
    box: np.ndarray  # amodal [x0, y0, x1, y1], px
    visible_box: np.ndarray | None  # [x, y, w, h], px; the coords file begins at (x, y)
    annotation: int  # its place in the image's list in scene_gt.json
    shows: str | None  # of MV-ball: the one hemisphere in sight
    info: dict  # its entry in scene_gt_info.json


def encode_coords(coords: np.ndarray, extent_m: float) -> np.ndarray:
    """Metres [.., 3] (NaN: none) to uint8; back by `network.coordinates.decode`."""
    code = np.round(ZERO + coords / extent_m * STEPS)
    return np.where(np.isnan(coords), 0, code).astype(np.uint8)


def read_rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)


def pose_from_bop(rotation, translation_mm) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(rotation, (3, 3))
    pose[:3, 3] = np.array(translation_mm) / 1000
    return pose


def write_scene(folder: Path, views: list[View], obj: Object, cameras: list[str] | None = None):
    """Write one scene; the annotation comes last, so a folder that has it is whole.

    `cameras`: name of the rig's camera that each view is of.
    """
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    (folder / "coords").mkdir(exist_ok=True)
    camera, gt, info = {}, {}, {}
    for i, view in enumerate(views):
        jpeg = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        cv2.imwrite(str(folder / "rgb" / f"{i:06d}.jpg"), view.rgb[:, :, ::-1], jpeg)
        v, u = np.nonzero(view.mask)
        x, y, w, h = u.min(), v.min(), u.max() - u.min(), v.max() - v.min()
        code = encode_coords(object_coordinates(view), obj.extent_m)[y : y + h + 1, x : x + w + 1]
        cv2.imwrite(str(folder / "coords" / f"{i:06d}.png"), code[:, :, ::-1])
        camera[i] = {
            "cam_K": view.k.ravel().tolist(),
            "depth_scale": 1.0,
            "cam_R_w2c": view.cam_from_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (view.cam_from_world[:3, 3] * 1000).tolist(),
        }
        if cameras:
            camera[i]["camera"] = cameras[i]
        pose = view.cam_from_obj
        gt[i] = [
            {
                "cam_R_m2c": pose[:3, :3].ravel().tolist(),
                "cam_t_m2c": (pose[:3, 3] * 1000).tolist(),
                "obj_id": obj.id,
            }
        ]
        box = amodal_box(view, obj.bounds)
        visible = int(view.mask.sum())
        about = {
            "bbox_obj": [*box[:2].tolist(), *(box[2:] - box[:2]).tolist()],
            "bbox_visib": [int(x), int(y), int(w), int(h)],
            "px_count_all": view.full_pixels,
            "px_count_visib": visible,
            "visib_fract": visible / view.full_pixels,
        }
        if view.shows:
            about |= {"px_count_hemisphere": view.bump_pixels, "hemisphere": view.shows}
        info[i] = [about]
    for name, content in (("scene_camera", camera), ("scene_gt_info", info), ("scene_gt", gt)):
        write_json(folder / f"{name}.json", content)


def write_json(path: Path, content):
    """Write so that a kill leaves no file or a whole one."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content))
    part.replace(path)


def is_whole(folder: Path) -> bool:
    return (folder / "scene_gt.json").exists()


def read_scene(folder: Path, obj: Object | None = None) -> list[Image]:
    """The images of a scene in which `obj` is annotated once.

    Without `obj`, every image must have exactly one annotation. Amodal boxes that the data set
    lacks are projected from `obj`.
    """
    camera, gt = _read(folder / "scene_camera.json"), _read(folder / "scene_gt.json")
    info_path = folder / "scene_gt_info.json"
    info = _read(info_path) if info_path.exists() else {}
    rgb, coords = _by_number(folder / "rgb"), _by_number(folder / "coords")
    images = []
    for key in sorted(gt, key=int):
        found = [n for n, entry in enumerate(gt[key]) if obj is None or entry["obj_id"] == obj.id]
        if obj is None and len(found) != 1:
            raise UserError(
                f"{folder}/scene_gt.json: image {key}: expected one object, got "
                f"{len(found)}; fix: choose the object to read"
            )
        if len(found) != 1:
            continue
        pose, about = gt[key][found[0]], info[key][found[0]] if key in info else {}
        if key not in camera or "cam_R_w2c" not in camera[key] or "cam_t_w2c" not in camera[key]:
            raise UserError(
                f"{folder}/scene_camera.json: image {key}: expected the camera's pose "
                "(cam_R_w2c, cam_t_w2c), got none; fix: add it, as several views need to know "
                "where their cameras stand"
            )
        if int(key) not in rgb:
            raise UserError(
                f"{folder}/rgb: image {key}: expected a png or jpg, got none; "
                "fix: unpack the data set's images"
            )
        k = np.reshape(camera[key]["cam_K"], (3, 3))
        cam_from_obj = pose_from_bop(pose["cam_R_m2c"], pose["cam_t_m2c"])
        images.append(
            Image(
                path=rgb[int(key)],
                coords_path=coords.get(int(key)),
                k=k,
                cam_from_world=pose_from_bop(camera[key]["cam_R_w2c"], camera[key]["cam_t_w2c"]),
                cam_from_obj=cam_from_obj,
                box=_box(folder, about, k, cam_from_obj, obj),
                visible_box=np.array(about["bbox_visib"]) if "bbox_visib" in about else None,
                annotation=found[0],
                shows=about.get("hemisphere"),
                info=about,
            )
        )
    return images


def load_index(root: Path, split: str = "train", obj: Object | None = None) -> list[list[Image]]:
    """The images of each whole scene of a split that show `obj` once (`objects.read`).

    Without `obj`, every image must have exactly one annotation.
    """
    scenes = [scene for scene in (read_scene(p, obj) for p in _folders(root, split)) if scene]
    return scenes or _refuse_empty(root, split)


def _folders(root: Path, split: str) -> list[Path]:
    folder = Path(root) / split
    return sorted(p for p in folder.iterdir() if is_whole(p)) if folder.is_dir() else []


def read_split(root: Path, split: str, obj: Object) -> dict[int, list[Image]]:
    """The images of `obj` in each whole scene, by the scene's number."""
    scenes = {int(path.name): read_scene(path, obj) for path in _folders(root, split)}
    scenes = {number: images for number, images in scenes.items() if images}
    return scenes or _refuse_empty(root, split)


def _refuse_empty(root: Path, split: str):
    folder = Path(root) / split
    raise UserError(f"no scenes in {folder}; fix: python -m mvtop_train.generate --out {root}")


def _read(path: Path) -> dict:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise UserError(
            f"{path}: expected a JSON file of BOP's layout, got {error}; "
            "fix: delete the scene's folder or write it again"
        ) from None


def _by_number(folder: Path) -> dict[int, Path]:
    """Image files by their number, whatever their format."""
    if not folder.is_dir():
        return {}
    return {
        int(stem): folder / f"{stem}{end}"
        for stem, end in map(os.path.splitext, os.listdir(folder))
        if stem.isdigit()
    }


def _box(folder, about: dict, k, cam_from_obj, obj: Object | None) -> np.ndarray:
    if "bbox_obj" in about:
        x, y, w, h = about["bbox_obj"]
        return np.array([x, y, x + w, y + h], float)
    if obj is None:
        raise UserError(
            f"{folder}/scene_gt_info.json: expected bbox_obj, got none; "
            "fix: give the object, from which boxes follow"
        )
    return amodal_boxes(obj.bounds, k, cam_from_obj)
