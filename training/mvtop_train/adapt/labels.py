"""A data set of photographs: what accepted poses say that each of them shows.

Boxes, masks and object coordinates are drawn from the meshes. What may be an object but is not
accepted, or is not seen where an accepted one should be, becomes a box in which the detector is
taught neither that there is one nor that there is none.
"""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import trimesh
from torchvision.ops import box_iou

from ..data import bop, objects
from ..data.rendered import Seen, View
from ..evaluation.boxes import Detector, cut_box, inside, pixels_of
from ..evaluation.matching import IOU
from .accept import Judge, Pose
from .exposures import Exposure

SUSPECTED = 0.1  # score from which on a box may be an object
LEAST_INSIDE = 0.3  # share of an object in the image, from which on it is learnt
LEAST_PIXELS = 100  # of its visible part


@dataclass
class Labels:
    """What is known of some exposures.

    accepted, others   by exposure; `others` may be objects or not
    seen               by exposure and camera, which of the accepted poses its image speaks for
    """

    accepted: dict[str, list[Pose]] = field(default_factory=dict)
    others: dict[str, list[Pose]] = field(default_factory=dict)
    seen: dict[str, dict[str, list[bool]]] = field(default_factory=dict)

    @property
    def poses(self) -> list[Pose]:
        return [one for poses in self.accepted.values() for one in poses]

    def images_of(self, pose: Pose) -> int:
        """How many images speak for an accepted pose."""
        number = self.accepted[pose.scene].index(pose)
        return sum(seen[number] for seen in self.seen[pose.scene].values())

    @property
    def count(self) -> int:
        """Of all accepted poses, the images that speak for them."""
        return sum(map(self.images_of, self.poses))


def of(
    judge: Judge, exposures: list[Exposure], struck: list[Pose], before: Labels | None = None
) -> Labels:
    """What a bundle makes of exposures.

    - struck: poses that a person has struck out; objects there are not accepted
    - before: of an earlier bundle: what that had accepted counts as well
    """
    labels = Labels()
    for one in exposures:
        accepted, others = judge.poses(one)
        kept = before.accepted[one.name] if before else []
        accepted = kept + [x for x in accepted if not any(map(x.same_object, kept))]
        out = [x for x in accepted if any(map(x.same_object, struck))]
        labels.accepted[one.name] = [x for x in accepted if x not in out]
        labels.others[one.name] = others + out + [x for x in struck if x.scene == one.name]
        labels.seen[one.name] = judge.seen_by(one, labels.accepted[one.name])
    return labels


def write(root: Path, exposures: list[Exposure], labels: Labels, data: Path, detector: Detector):
    """Writes the split `train` at `root` anew, a scene for each exposure with accepted poses.

    - data: data set with the meshes
    """
    shutil.rmtree(root / "train", ignore_errors=True)
    meshes = {}
    for number, exposure in enumerate(exposures):
        accepted = labels.accepted[exposure.name]
        if not accepted:
            continue
        for obj in (one.obj for one in accepted):
            if obj.id not in meshes:
                meshes[obj.id] = mesh_of(data, obj.id)
        folder = root / "train" / f"{number:06d}"
        folder.mkdir(parents=True)
        views, unsure = [], {}
        for n, (camera_id, rgb) in enumerate(exposure.images().items()):
            camera = next(one for one in exposure.rig.cameras if one.id == camera_id)
            camera, rgb = straight(camera, rgb)
            seen = labels.seen[exposure.name][camera_id]
            view = _view(camera, rgb, accepted, seen, meshes)
            boxes = _unsure(view, camera, accepted, labels.others[exposure.name], detector)
            view.other = _within(boxes, rgb.shape)
            views.append(view)
            unsure[n] = [box.tolist() for box in boxes]
        bop.write_json(folder / bop.UNSURE, unsure)
        bop.write_scene(folder, views, list(exposure.paths))


def mesh_of(data: Path, obj_id: int):
    """mvtop.metrics.Mesh of an object, m."""
    import mvtop  # loads its compiled part

    mesh: trimesh.Trimesh = objects.read_mesh(data, obj_id)
    return mvtop.metrics.Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces).tolist())


def straight(camera, rgb: np.ndarray):
    """A camera without distortion in the place of one (mvtop.Camera), and its image, black where
    the lens sees nothing."""
    import mvtop  # loads its compiled part

    k = camera.K.copy()
    if camera.model == "pinhole" and not np.any(camera.distortion) and k[0, 1] == 0:
        return camera, rgb
    k[0, 1] = 0
    pinhole = mvtop.Camera(k, camera.size, world_from_cam=camera.world_from_cam, id=camera.id)
    u, v = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(u.shape)], -1)
    pixels = np.nan_to_num(camera.project(rays), nan=-1e4).astype(np.float32)
    return pinhole, cv2.remap(rgb, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR)


def _view(camera, rgb: np.ndarray, accepted: list[Pose], seen: list[bool], meshes: dict) -> View:
    """A photograph with the accepted objects that it speaks for; those hide each other."""
    cam_from_world = np.linalg.inv(camera.world_from_cam)
    view = View(camera.K.copy(), cam_from_world, [], rgb)
    depths = []
    for pose in accepted:
        depth = meshes[pose.obj.id].depth(cam_from_world @ pose.world_from_obj, camera)
        depths.append(np.where(depth > 0, depth, np.inf))
    view.depth = np.min(depths, 0)
    for pose, speaks, depth in zip(accepted, seen, depths, strict=True):
        whole = np.isfinite(depth)
        mask = whole & (depth <= view.depth)
        share = inside(pixels_of(pose.obj.points, pose.world_from_obj, camera), camera)
        if speaks and share >= LEAST_INSIDE and mask.sum() >= LEAST_PIXELS:
            full = round(whole.sum() / share)
            view.seen.append(Seen(pose.obj, pose.world_from_obj, mask, full))
    return view


def _unsure(
    view: View, camera, accepted: list[Pose], others: list[Pose], detector: Detector
) -> list[np.ndarray]:
    """Boxes [4] px in which there may be an object that is not labelled."""
    labelled = [seen.world_from_obj for seen in view.seen]
    poses = [one for one in accepted if not any(one.world_from_obj is x for x in labelled)] + others
    boxes = [cut_box(pixels_of(x.obj.bounds, x.world_from_obj, camera), camera) for x in poses]
    found, scores, _ = detector(view.rgb)
    known = np.zeros(len(found), bool)  # what is where a labelled object is, is that
    for seen in view.seen:
        box = cut_box(pixels_of(seen.obj.bounds, seen.world_from_obj, camera), camera)
        known |= (box_iou(found, found.new_tensor(box)[None])[:, 0] >= IOU).numpy()
    suspected = (scores >= SUSPECTED).numpy() & ~known
    return [box for box in boxes if box is not None] + list(found.numpy()[suspected])


def _within(boxes: list[np.ndarray], shape) -> np.ndarray:
    """Pixels [h, w] of an image (`shape`) that lie within one of the boxes."""
    mask = np.zeros(shape[:2], bool)
    for box in boxes:
        x0, y0, x1, y1 = np.rint(np.maximum(box, 0)).astype(int)
        mask[y0 : y1 + 1, x0 : x1 + 1] = True
    return mask
