"""The inference pipeline in PyTorch, for given boxes: what the Rust pipeline is compared with."""

import json
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image as PilImage

from ..data import rig
from ..network import rays
from ..network.model import Mvtop
from .bundle import ExportedDecoder, ExportedFeatures


def letterbox(rgb: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """The image resized to fit, and its scale per axis; nothing is padded here."""
    h, w = rgb.shape[:2]
    scale = min(width / w, height / h)
    size = round(w * scale), round(h * scale)
    if size != (w, h):
        image = PilImage.fromarray(rgb).resize(size, PilImage.Resampling.BILINEAR)
        rgb = np.asarray(image)
    return rgb, np.array([size[0] / w, size[1] / h])


@torch.no_grad()
def predict(model: Mvtop, cameras: list[rig.Camera], images, boxes) -> dict:
    """Pose of one object, given its box in every view; the first camera is the reference.

    images  per camera [H, W, 3] uint8;  boxes  per camera [4] px
    returns every intermediate result by the name it has in the exported graphs
    """
    config = model.config
    mean, std = np.array(config.mean), np.array(config.std)
    count = len(cameras)
    tensors = np.zeros((count, 3, config.height, config.width))
    k_net, net_boxes = np.zeros((count, 3, 3)), np.zeros((count, 4))
    inside = []
    pixels = rays.cell_centers(config.level_shapes(), config.strides)
    for i, (camera, rgb, box) in enumerate(zip(cameras, images, boxes, strict=True)):
        small, scale = letterbox(rgb, config.width, config.height)
        h, w = small.shape[:2]
        tensors[i, :, :h, :w] = ((small / 255 - mean) / std).transpose(2, 0, 1)
        k_net[i] = camera.k
        k_net[i, :2, :2] *= scale[:, None]
        k_net[i, :2, 2] = (camera.k[:2, 2] + 0.5) * scale - 0.5
        net_boxes[i] = (np.array(box) + 0.5) * np.tile(scale, 2) - 0.5
        inside.append((pixels[:, 0] <= w - 0.5) & (pixels[:, 1] <= h - 0.5))
    ref_from_cam = [
        cameras[0].cam_from_rig @ np.linalg.inv(camera.cam_from_rig) for camera in cameras
    ]
    k = torch.tensor(k_net, dtype=torch.float64)
    ref_from_cam = torch.tensor(np.stack(ref_from_cam), dtype=torch.float64)
    camera_rays = rays.unproject(k, pixels.double()) * torch.stack(inside)[..., None]
    lines = rays.encode(camera_rays, ref_from_cam, config.los_encoding)
    b = torch.tensor(net_boxes)[:, None]  # [V, 1, 4]
    size = torch.tensor([config.width, config.height])
    low, high = (b[..., :2] + 0.5) / size, (b[..., 2:] + 0.5) / size
    decoder_inputs = {
        "rays": lines,
        "centers": (low + high) / 2,
        "half_sizes": (high - low) / 2,
        "box_rays": rays.box_rays(k, b, ref_from_cam),
        "valid": torch.ones(count, 1),
    }
    decoder_inputs = {name: x.float() for name, x in decoder_inputs.items()}
    decoder_inputs["class_index"] = torch.zeros(1, dtype=torch.long)
    features_inputs = {
        "images": torch.tensor(tensors).float(),
        "camera_rays": camera_rays.float(),
    }
    names = ("memory", "det_scores", "det_boxes")
    features = dict(zip(names, ExportedFeatures(model)(**features_inputs), strict=True))
    names = ("rotation_6d", "translation", "sigma")
    poses = ExportedDecoder(model)(features["memory"], **decoder_inputs)
    return features_inputs | features | decoder_inputs | dict(zip(names, poses, strict=True))


def load_sample(folder: Path):
    """Cameras, images and true boxes of a sample folder (`samples.py`)."""
    cameras = rig.load(folder / "rig.json")
    images = [cv2.imread(str(folder / f"{c.id}.png"))[:, :, ::-1] for c in cameras]
    truth = json.loads((folder / "truth.json").read_text())["objects"][0]
    boxes = [truth["boxes"][c.id] for c in cameras]
    return cameras, images, boxes, np.array(truth["T_world_obj"])
