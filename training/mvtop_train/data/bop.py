"""Scenes in BOP layout (millimetres, OpenCV axes, integer pixel = center): written here, read and
checked by mvtop.

Beside BOP's own files a scene has `coords/IM.png`: the object-frame position of each visible
object pixel, coded in 8 bits per axis, 0 meaning "not the object"; its first pixel is the corner of
`bbox_visib` (of the image, where there is none). Data sets of others lack it, and at times
`scene_gt_info.json`: both may be absent. `scene_unsure.json`, of photographs, has by image the
boxes in which an object may be or not. See docs/how-to/data-sets.md.
"""

import itertools
import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from ..errors import UserError, asking_mvtop
from ..files import read_json
from ..network.coordinates import STEPS, ZERO
from .boxes import amodal_boxes
from .objects import Object
from .rendered import Seen, View, amodal_box, object_coordinates

JPEG_QUALITY = 95
OTHER = 255  # in the fourth channel of `coords/`: something that is no object of the data set
UNSURE = "scene_unsure.json"
LEAST_SHARE = 0.2  # of an object in sight, from which on its pose is learnt
SAME_PLACE = 0.02  # of its diameter; poses of others' data sets are not exact


@dataclass
class Instance:
    """An object that is annotated in an image."""

    obj_id: int
    cam_from_obj: np.ndarray  # [4, 4], m
    box: np.ndarray | None  # amodal [x0, y0, x1, y1], px; None: the data set does not say
    visible_box: np.ndarray | None = None  # [x0, y0, x1, y1] int; the coords file begins there
    visible_share: float | None = None
    annotation: int = 0  # its place in the image's list in scene_gt.json
    coords_path: Path | None = None  # None: no object coordinates are known
    info: dict = field(default_factory=dict)  # what else scene_gt_info.json says of it

    @property
    def shows(self) -> str | None:
        """Of MV-ball: the one hemisphere in sight."""
        return self.info.get("hemisphere")


@dataclass
class Image:
    """An image and all that is annotated in it."""

    number: int  # in its scene
    path: Path
    k: np.ndarray  # [3, 3], px
    cam_from_world: np.ndarray  # [4, 4], m
    instances: list[Instance]
    # [n, 4], px: where an object may be that is not annotated
    unsure: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def only(self) -> Instance:
        """The instance, of an image that `read_scene` has narrowed down to one."""
        (instance,) = self.instances
        return instance

    # Its attributes, for all that looks at one object.
    cam_from_obj = property(lambda self: self.only.cam_from_obj)
    box = property(lambda self: self.only.box)
    visible_box = property(lambda self: self.only.visible_box)
    annotation = property(lambda self: self.only.annotation)
    coords_path = property(lambda self: self.only.coords_path)
    shows = property(lambda self: self.only.shows)


def encode_coords(coords: np.ndarray, extent_m: float) -> np.ndarray:
    """Metres [.., 3] (NaN: none) to uint8; back by `network.coordinates.decode`."""
    code = np.round(ZERO + coords / extent_m * STEPS)
    return np.where(np.isnan(coords), 0, code).astype(np.uint8)


def read_rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)


def write_image(path: Path, image: np.ndarray, options: list[int] = ()):
    if not cv2.imwrite(str(path), image, options):
        raise UserError(
            f"{path}: expected to write an image, could not (is the disk full?); fix: make room, "
            "then the same command again"
        )


def write_scene(folder: Path, views: list[View], cameras: list[str] | None = None):
    """Write one scene; the annotation comes last, so a folder that has it is whole.

    `cameras`: name of the rig's camera that each view is of.
    """
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    (folder / "coords").mkdir(exist_ok=True)
    camera, gt, info = {}, {}, {}
    for i, view in enumerate(views):
        jpeg = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        write_image(folder / "rgb" / f"{i:06d}.jpg", view.rgb[:, :, ::-1], jpeg)
        write_image(folder / "coords" / f"{i:06d}.png", _coords(view))
        camera[i] = {
            "cam_K": view.k.ravel().tolist(),
            "depth_scale": 1.0,
            "cam_R_w2c": view.cam_from_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (view.cam_from_world[:3, 3] * 1000).tolist(),
        }
        if cameras:
            camera[i]["camera"] = cameras[i]
        gt[i] = [_annotation(view, seen) for seen in view.seen]
        info[i] = [_about(view, seen) for seen in view.seen]
    for name, content in (("scene_camera", camera), ("scene_gt_info", info), ("scene_gt", gt)):
        write_json(folder / f"{name}.json", content)


def _coords(view: View) -> np.ndarray:
    """Codes in BGR and whose they are in A: number of the annotation + 1, or `OTHER`."""
    picture = np.zeros((*view.rgb.shape[:2], 4), np.uint8)
    if view.other is not None:
        picture[view.other, 3] = OTHER
    for n, seen in enumerate(view.seen):
        code = encode_coords(object_coordinates(view, seen), seen.obj.extent_m)
        picture[seen.mask, :3] = code[seen.mask][:, ::-1]
        picture[seen.mask, 3] = n + 1
    return picture


def _annotation(view: View, seen: Seen) -> dict:
    pose = view.cam_from_obj(seen)
    return {
        "cam_R_m2c": pose[:3, :3].ravel().tolist(),
        "cam_t_m2c": (pose[:3, 3] * 1000).tolist(),
        "obj_id": seen.obj.id,
    }


def _about(view: View, seen: Seen) -> dict:
    v, u = np.nonzero(seen.mask)
    visible = [-1, -1, -1, -1]
    if len(u):
        visible = [int(x) for x in (u.min(), v.min(), np.ptp(u), np.ptp(v))]
    box = amodal_box(view, seen)
    about = {
        "bbox_obj": [*box[:2].tolist(), *(box[2:] - box[:2]).tolist()],
        "bbox_visib": visible,
        "px_count_all": seen.full_pixels,
        "px_count_visib": len(u),
        "visib_fract": len(u) / max(seen.full_pixels, 1),
    }
    if seen.shows:
        about |= {"px_count_hemisphere": seen.bump_pixels, "hemisphere": seen.shows}
    return about


def write_json(path: Path, content):
    """Write so that a kill leaves no file or a whole one."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content))
    part.replace(path)


def is_whole(folder: Path) -> bool:
    return (folder / "scene_gt.json").exists()


def read_images(folder: Path) -> list[Image]:
    """All images of a scene, with every instance of every object."""
    fix = "see docs/how-to/data-sets.md; of a scene that was generated, delete the folder"
    with asking_mvtop(fix):
        import mvtop  # loads its compiled part

        found = mvtop.bop.read_scene(folder, whole=True)
    coords = {path.stem: path for path in (folder / "coords").glob("*.png")}
    unsure = {}
    if (folder / UNSURE).exists():
        unsure = read_json(folder / UNSURE, "delete the folder of the scene")
    images = []
    for image in found:
        if image.sensor:  # a camera beside the scene's own
            continue
        if image.cam_from_world is None:
            raise UserError(
                f"{folder}/scene_camera.json: image {image.number}: expected the camera's pose "
                "(cam_R_w2c, cam_t_w2c), got none; fix: add it, as several views need to know "
                "where their cameras stand"
            )
        path = image.path
        instances = [
            Instance(
                obj_id=one.obj_id,
                cam_from_obj=one.cam_from_obj,
                box=one.box,
                visible_box=None if one.visible_box is None else one.visible_box.astype(int),
                visible_share=one.visible_share,
                annotation=annotation,
                coords_path=coords.get(path.stem),
                info=one.more,
            )
            for annotation, one in enumerate(image.instances)
        ]
        boxes = np.array(unsure.get(str(image.number), []), float).reshape(-1, 4)
        images.append(Image(image.number, path, image.K, image.cam_from_world, instances, boxes))
    return images


def read_scene(folder: Path, obj: Object | None = None) -> list[Image]:
    """The images of a scene in which `obj` is annotated once, with this instance alone.

    Without `obj`, every image must have exactly one annotation. Amodal boxes that the data set
    lacks are projected from `obj`.
    """
    narrowed = []
    for image in read_images(folder):
        found = [one for one in image.instances if obj is None or one.obj_id == obj.id]
        if obj is None and len(found) != 1:
            raise UserError(
                f"{folder}/scene_gt.json: image {image.number}: expected one object, got "
                f"{len(found)}; fix: choose the object to read"
            )
        if len(found) == 1:
            narrowed.append(replace(image, instances=[_boxed(folder, image, found[0], obj)]))
    return narrowed


def _boxed(folder: Path, image: Image, instance: Instance, obj: Object | None) -> Instance:
    if instance.box is not None:
        return instance
    if obj is None:
        raise UserError(
            f"{folder}/scene_gt_info.json: expected bbox_obj, got none; "
            "fix: give the object, from which boxes follow"
        )
    return replace(instance, box=amodal_boxes(obj.bounds, image.k, instance.cam_from_obj))


def load_index(root: Path, split: str = "train", obj: Object | None = None) -> list[list[Image]]:
    """The images of each whole scene of a split that show `obj` once (`objects.read`).

    Without `obj`, every image must have exactly one annotation.
    """
    return list(read_split(root, split, obj).values())


def read_split(root: Path, split: str, obj: Object | None) -> dict[int, list[Image]]:
    """The same by the scene's number."""
    scenes = {int(path.name): read_scene(path, obj) for path in whole_scenes(Path(root) / split)}
    scenes = {number: images for number, images in scenes.items() if images}
    if not scenes:
        refuse_empty(root, split)
    return scenes


def refuse_empty(root: Path, split: str):
    raise UserError(f"no scenes in {Path(root) / split}; fix: mvtop-train generate --out {root}")


def whole_scenes(split: Path) -> list[Path]:
    """The folders of a split's scenes that are whole."""
    folders = split.iterdir() if split.is_dir() else ()
    return sorted(path for path in folders if path.name.isdigit() and is_whole(path))


def read_coords(image: Image, shape) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Codes [h, w, 3], and whose they are [h, w]: 0 nobody's, an annotation's number + 1, `OTHER`.

    Of data sets of one object the file has no owners, and only the part that shows the object.
    """
    if not image.instances or image.instances[0].coords_path is None:
        return None, None
    one = image.instances[0]
    picture = cv2.imread(str(one.coords_path), cv2.IMREAD_UNCHANGED)
    if picture.shape[2] == 4:
        return picture[:, :, 2::-1], picture[:, :, 3]
    x, y = (0, 0) if one.visible_box is None else np.maximum(one.visible_box[:2], 0)
    code = np.zeros((*shape, 3), np.uint8)
    height, width = np.minimum(picture.shape[:2], np.array(shape) - [y, x])
    code[y : y + height, x : x + width] = picture[:height, :width, ::-1]
    return code, (code != 0).all(-1) * np.uint8(one.annotation + 1)


def sightings(images: list[Image], known: dict[int, Object]) -> list[list[Image]]:
    """The images of a scene by what they show: for each thing that stands in it, those in which
    enough of it is seen, with this instance alone.

    Images number their instances as they like: the same is what is in the same place.
    """
    things: list[tuple[int, np.ndarray, list[Image]]] = []
    for image in images:
        for one in image.instances:
            obj = known.get(one.obj_id)
            if obj is None or (one.visible_share is not None and one.visible_share < LEAST_SHARE):
                continue
            if one.box is None:
                one = replace(one, box=amodal_boxes(obj.bounds, image.k, one.cam_from_obj))
            narrowed = replace(image, instances=[one])
            place = np.linalg.inv(image.cam_from_world) @ one.cam_from_obj
            for obj_id, other, list_ in things:
                near = np.linalg.norm(place[:3, 3] - other[:3, 3]) < SAME_PLACE * obj.diameter_m
                if obj_id == one.obj_id and near:
                    list_.append(narrowed)
                    break
            else:
                things.append((one.obj_id, place, [narrowed]))
    return [list_ for _, _, list_ in things]


def rig_of(images: list[Image]):
    """The cameras of a scene, and what they show: a rig of `mvtop`, and RGB arrays by camera."""
    import mvtop  # loads its compiled part

    pictures = {str(n): read_rgb(one.path) for n, one in enumerate(images)}
    cameras = []
    for (name, picture), image in zip(pictures.items(), images, strict=True):
        size, pose = picture.shape[1::-1], np.linalg.inv(image.cam_from_world)
        cameras.append(mvtop.Camera(image.k, size, world_from_cam=pose, id=name))
    # A data set says its unit; two of its cameras may be in one housing.
    return mvtop.Rig(cameras, trust_unit=True), pictures


def scenes_of(images: list[Image]) -> list[list[Image]]:
    """The images of each scene."""
    by_folder = itertools.groupby(images, lambda image: image.path.parent.parent)
    return [list(group) for _, group in by_folder]
