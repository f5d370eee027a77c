"""The inference pipeline in PyTorch, from images to a pose: what the Rust pipeline must equal.

For one object, so that nothing need be matched across views: a view's box is its detector's best.
The deformable sampling is PyTorch's own, not mvtop's kernel.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch

from ..data.letterbox import image_tensor, letterbox, normalised_picture
from ..network import pose, rays, sampling
from ..network.model import Mvtop
from .bundle import ExportedCloseUps, ExportedDecoder, ExportedDetector, outputs_of
from .optics import Camera, closeup_of, load_rig, picture_of, rays_of_box, seen_by

# Of `search` in mvtop-core/src/config.rs: max_anchors, merge_deg.
MAX_ANCHORS = 4
NEAR_DEG = 25.0


@dataclass
class Picture:
    """What the network is shown of a view."""

    tensor: np.ndarray  # [3, H, W], normalised
    camera_rays: np.ndarray  # [N, 3], unit or 0, in the frame of the camera that took it
    box_rays: np.ndarray  # [5, 3], in that frame
    center: np.ndarray  # [2], of the box, 0 to 1 over the picture
    half_size: np.ndarray  # [2]
    extent: float  # of the box's longer side, at distance 1
    world_from_cam: np.ndarray  # [4, 4], m


def _over(box, width: int, height: int) -> dict:
    low, high = (box[:2] + 0.5) / [width, height], (box[2:] + 0.5) / [width, height]
    return {"center": (low + high) / 2, "half_size": (high - low) / 2}


def close_up(config, camera: Camera, rgb: np.ndarray, box: np.ndarray) -> Picture:
    size = config.closeup
    virtual, bounds, step = closeup_of(camera, box, size)
    picture, on_image = picture_of(virtual, camera, rgb, step)
    pixels = rays.cell_centers(config.decoder_shapes(), config.pose_strides).double().numpy()
    return Picture(
        normalised_picture(config, picture) * on_image,
        virtual.unproject(pixels) * camera.shows(seen_by(camera, virtual, pixels))[:, None],
        rays_of_box(virtual, bounds),
        **_over(bounds, size, size),
        extent=max(bounds[2:] - bounds[:2]) / virtual.k[0, 0],
        world_from_cam=virtual.world_from_cam,
    )


def decoder_inputs(config, pictures: list[Picture], anchor: int) -> dict:
    """By the names of the exported graph, in the pictures' order, in the anchor's frame."""
    ref_from_world = np.linalg.inv(pictures[anchor].world_from_cam)
    out = {"rays": [], "centers": [], "half_sizes": [], "box_rays": []}
    for picture in pictures:
        ref_from_cam = ref_from_world @ picture.world_from_cam
        lines = torch.from_numpy(picture.camera_rays), torch.from_numpy(ref_from_cam)
        out["rays"].append(rays.encode(*lines, config.los_encoding).numpy())
        out["centers"].append(picture.center[None])
        out["half_sizes"].append(picture.half_size[None])
        d, left, right, top, bottom = picture.box_rays @ ref_from_cam[:3, :3].T
        e_x, e_y = (rays.BOX_RAY_GAIN / 2 * e for e in (right - left, bottom - top))
        out["box_rays"].append(np.concatenate([ref_from_cam[:3, 3], d, e_x, e_y])[None])
    return {name: torch.from_numpy(np.stack(x)) for name, x in out.items()}


@torch.no_grad()
def decode(model: Mvtop, memory, inputs: dict, order: list[int]) -> dict:
    """rotation_6d [1, 6], translation [1, 3], sigma [1, 2] from views `order`, the anchor first; of
    networks with hypotheses these as well."""
    given = {name: x[order].float() for name, x in inputs.items()}
    given |= {"valid": torch.ones(len(order), 1), "class_index": torch.zeros(1, dtype=torch.long)}
    outputs = ExportedDecoder(model)(memory[order], **given)
    return dict(zip(outputs_of(model.config), outputs, strict=True))


class Hypothesis(NamedTuple):
    """A pose [4, 4] that the object may have, world frame; sigma [2] if it is the right one."""

    probability: float
    world_from_obj: np.ndarray
    sigma: np.ndarray

    def away_deg(self, other: "Hypothesis") -> float:
        cos = (np.trace(self.world_from_obj[:3, :3].T @ other.world_from_obj[:3, :3]) - 1) / 2
        return float(np.degrees(np.arccos(np.clip(cos, -1, 1))))


def hypotheses_of(decoded: dict, world_from_anchor: np.ndarray) -> list[Hypothesis]:
    """Of the one object that was decoded."""
    keys = ("rotation_6d", "translation", "sigma")
    several = "hypotheses_score" in decoded
    given = [decoded[f"hypotheses_{key}"][0] if several else decoded[key] for key in keys]
    share = decoded["hypotheses_score"][0].double().softmax(-1) if several else torch.ones(1)
    found = []
    for probability, six, translation, sigma in zip(share, *given, strict=True):
        anchor_from_obj = np.eye(4)
        anchor_from_obj[:3, :3] = pose.rotation_from_6d(six.double())
        anchor_from_obj[:3, 3] = translation
        world_from_obj = world_from_anchor @ anchor_from_obj
        found.append(Hypothesis(probability.item(), world_from_obj, sigma.double().numpy()))
    return found


def grouped(found: list[Hypothesis]) -> list[list[Hypothesis]]:
    """The most probable first, each with those that are turned by less than `NEAR_DEG`."""
    groups: list[list[Hypothesis]] = []
    for one in sorted(found, key=lambda one: -one.probability):
        near = (group for group in groups if group[0].away_deg(one) < NEAR_DEG)
        group = next(near, None)
        groups.append([one]) if group is None else group.append(one)
    return groups


def most_probable(found: list[Hypothesis]) -> tuple[np.ndarray, np.ndarray]:
    """The pose [4, 4] that is the mean of the most probable ones near each other, and their mean
    expected error."""
    group = max(grouped(found), key=lambda group: sum(one.probability for one in group))
    weights = np.array([one.probability for one in group])
    mean = mean_pose([one.world_from_obj for one in group], weights)
    return mean, np.average([one.sigma for one in group], 0, weights)


def mean_pose(poses: list[np.ndarray], weights=None) -> np.ndarray:
    """[4, 4]: the chordal mean of the rotations, and the translations' arithmetic one."""
    out = np.average(poses, 0, weights)
    u, _, vt = np.linalg.svd(out[:3, :3])
    out[:3, :3] = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return out


@torch.no_grad()
def detect(model: Mvtop, cameras: list[Camera], images) -> dict:
    """The detector's maps, and per view its best box, on the image, in px, with its score."""
    config = model.config
    tensors = torch.from_numpy(np.stack([image_tensor(config, rgb) for rgb in images])).float()
    scores, maps = ExportedDetector(model)(tensors)
    out = {"images": tensors, "det_scores": scores, "det_boxes": maps}
    boxes = []
    for camera, rgb, view, sides in zip(cameras, images, scores, maps, strict=True):
        box = sides.flatten(1)[:, view[0].argmax()].double().numpy()
        _, scale = letterbox(rgb, config.width, config.height)
        end = np.tile([camera.width, camera.height], 2) - 0.5
        boxes.append(np.clip((box + 0.5) / np.tile(scale, 2) - 0.5, -0.5, end))
    best = scores.flatten(1).amax(1).double()
    return out | {"detected": torch.from_numpy(np.stack(boxes)), "scores": best}


@sampling.standard_operators()
@torch.no_grad()
def predict(model: Mvtop, cameras: list[Camera], images, boxes) -> dict:
    """Pose of one object, given its box in every view that sees it.

    It is decoded with each of the `MAX_ANCHORS` views with the largest boxes as the reference; the
    mean of those of these poses that are near the most probable one is the result.

    images  per camera [H, W, 3] uint8;  boxes  per camera [4] px
    returns every intermediate result; `inputs` of every view as the reference, `decoded` of those
        that are one, by view; `world_from_obj` [4, 4] and `sigma` [2], the error of this pose
    """
    config = model.config
    views = zip(cameras, images, boxes, strict=True)
    pictures = [close_up(config, camera, rgb, np.array(box)) for camera, rgb, box in views]
    tensors = torch.from_numpy(np.stack([picture.tensor for picture in pictures]))
    camera_rays = torch.from_numpy(np.stack([picture.camera_rays for picture in pictures]))
    memory = ExportedCloseUps(model)(tensors.float(), camera_rays.float())
    out = {"pictures": tensors, "camera_rays": camera_rays, "memory": memory}
    out["inputs"] = [decoder_inputs(config, pictures, view) for view in range(len(pictures))]
    largest = sorted(range(len(pictures)), key=lambda view: -pictures[view].extent)
    out["decoded"], found = {}, []
    for anchor in sorted(largest[:MAX_ANCHORS]):
        order = [anchor, *(v for v in range(len(pictures)) if v != anchor)]
        decoded = decode(model, memory, out["inputs"][anchor], order)
        found += hypotheses_of(decoded, pictures[anchor].world_from_cam)
        out["decoded"][anchor] = decoded
    world_from_obj, sigma = most_probable(found)
    return out | {"world_from_obj": world_from_obj, "sigma": sigma}


def load_sample(folder: Path):
    """Cameras, images, true boxes and world_from_obj of a sample (`synthesis/samples.py`)."""
    cameras = load_rig(folder / "rig.json")
    images = [cv2.imread(str(folder / f"{c.id}.png"))[:, :, ::-1] for c in cameras]
    truth = json.loads((folder / "truth.json").read_text())["objects"][0]
    boxes = [np.array(truth["boxes"][c.id]) for c in cameras]
    return cameras, images, boxes, np.array(truth["T_world_obj"])
