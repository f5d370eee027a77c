"""Errors on scenes that are not trained on."""

import numpy as np
import torch

from ..data.choice import fixed_views
from ..data.closeup import CloseUps
from ..data.crops import Crops
from ..data.inputs import to_views
from ..data.views import ViewMaker, collate
from ..network import losses, symmetry
from ..network.precision import autocast
from .runconfig import RunConfig


def pose_views(settings: RunConfig, config, objects, augment: bool, composer=None) -> ViewMaker:
    """Views like those that poses are decoded from: close-ups, where the network has them."""
    crops = Crops(settings.crop, settings.augmentation_of(config))
    choose = CloseUps(config.closeup) if config.closeup else crops
    return ViewMaker(choose, config, objects, augment, composer)


@torch.no_grad()
def validate(model, scenes, maker: ViewMaker, precision: str, views: int, per_scene=2) -> dict:
    """Errors on held-out scenes with lightly jittered true boxes, without augmentation."""
    device, rng = next(model.parameters()).device, np.random.default_rng(0)
    items = [
        [maker.make_view(image, rng) for image in chosen]
        for scene in scenes
        if len(scene) >= views
        for chosen in fixed_views(scene, views, per_scene)
        if len(chosen) == views
    ]
    known = symmetry.of(model.config.classes).to(device)
    rot, t = [], []
    for start in range(0, len(items), 32):
        batch = collate(items[start : start + 32])
        with autocast(device, precision):
            prediction = model(to_views(batch, maker.config, device))
        truth, index = batch["cam_from_obj"][:, :1].to(device), batch["class_index"].to(device)
        truth, _ = losses.nearest_truth(prediction.poses, truth, index, known)
        r, d = losses.pose_errors(prediction.poses, truth)
        rot.append(torch.rad2deg(r[-1]).flatten().cpu())
        t.append(d[-1].flatten().cpu())
    rot, t = torch.cat(rot), torch.cat(t)
    return {
        "rot_mean_deg": rot.mean().item(),
        "rot_median_deg": rot.median().item(),
        "share_over_30_deg": (rot > 30).float().mean().item(),
        "trans_mean_m": t.mean().item(),
    }
