"""Errors on scenes that are not trained on."""

import numpy as np
import torch

from ..data import closeup
from ..data.boxes import amodal_boxes
from ..data.choice import fixed_views
from ..data.collate import collate
from ..data.crops import make_view
from ..data.inputs import to_views
from ..network import losses
from .optimise import autocast
from .runconfig import RunConfig


@torch.no_grad()
def validate(model, scenes, points, settings: RunConfig, views: int, per_scene=2) -> dict:
    """Errors on held-out scenes with lightly jittered true boxes, without augmentation."""
    config, device = model.config, next(model.parameters()).device
    aug, rng = settings.augmentation_of(config), np.random.default_rng(0)
    boxes_of = amodal_boxes(points)

    def make(image):
        if config.closeup:
            return closeup.make_view(image, config, points, rng, augment=False)
        return make_view(image, settings.crop, rng, aug, augment=False)

    items = [
        [make(image) for image in chosen]
        for scene in scenes
        if len(scene) >= views
        for chosen in fixed_views(scene, views, per_scene)
    ]
    rot, t = [], []
    for start in range(0, len(items), 32):
        part = items[start : start + 32]
        batch = closeup.collate_items(part) if config.closeup else collate(part, boxes_of, 0.02)
        with autocast(device, settings.precision):
            prediction = model(to_views(batch, config, device))
        r, d = losses.pose_errors(prediction.poses, batch["cam_from_obj"][:, :1].to(device))
        rot.append(torch.rad2deg(r[-1]).flatten().cpu())
        t.append(d[-1].flatten().cpu())
    rot, t = torch.cat(rot), torch.cat(t)
    return {
        "rot_mean_deg": rot.mean().item(),
        "rot_median_deg": rot.median().item(),
        "share_over_30_deg": (rot > 30).float().mean().item(),
        "trans_mean_m": t.mean().item(),
    }
