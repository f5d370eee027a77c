"""From a prediction and the truth to one number to minimise."""

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torchvision.ops import generalized_box_iou_loss

from . import coordinates, pose

ROTATION, TRANSLATION, DETECTION, COORDINATES, UNCERTAINTY = 1.0, 10.0, 2.0, 6.0, 0.02
WEIGHTS = {
    "rotation": ROTATION,
    "translation": TRANSLATION,
    "detection": DETECTION,
    "coordinates": COORDINATES,
    "uncertainty": UNCERTAINTY,
}


def pose_errors(poses, cam_from_obj):
    """Rotation (radians) and translation (m) error [layers, B, Q] of `Prediction.poses`.

    cam_from_obj  [B, Q, 4, 4]
    """
    rotations = torch.stack([pose.rotation_from_6d(six) for six, _, _ in poses])
    translations = torch.stack([t for _, t, _ in poses])
    rot = pose.rotation_angle(rotations, cam_from_obj[..., :3, :3].expand_as(rotations))
    return rot, pose.translation_error(translations, cam_from_obj[..., :3, 3])


def total(prediction, batch, stride: int, weights=WEIGHTS):
    """Loss and its parts. Every decoder layer counts alike (auxiliary losses, PoET)."""
    truth = batch["cam_from_obj"][:, :1]  # in the reference view; one object
    rot, t = pose_errors(prediction.poses, truth)
    degrees = torch.rad2deg(rot)
    sigma = torch.stack([s for _, _, s in prediction.poses])
    terms = {
        "rotation": rot.mean(1).sum(),
        "translation": t.mean(1).sum(),
        "uncertainty": uncertainty_loss(sigma, degrees, t).mean(),
    }
    if prediction.detections is not None:
        terms |= image_terms(prediction.detections, batch, stride)
    parts = {
        "rotation_deg": degrees[-1].mean(),
        "translation_m": t[-1].mean(),
        **{name: term for name, term in terms.items() if name not in ("rotation", "translation")},
    }
    return sum(weights[name] * term for name, term in terms.items()), parts


def uncertainty_loss(sigma, rotation_error_deg, t_error):
    """Negative log likelihoods that make `sigma` [..., 2] the expected errors.

    Rotation: exponential distribution, minimal where sigma is the mean error. Translation:
    isotropic Gaussian, minimal where 3 sigma^2 is the mean squared distance.
    """
    rot, t = sigma.unbind(-1)
    rot_nll = rot.log() + rotation_error_deg.detach() / rot
    t_nll = 3 * t.log() + t_error.detach() ** 2 / (2 * t**2)
    return rot_nll + t_nll


def mean_count(count: torch.Tensor) -> torch.Tensor:
    """Mean of a count over the processes, at least 1; a sum in each is divided by it."""
    count = count.detach().float()
    if dist.is_initialized():
        dist.all_reduce(count)
        count = count / dist.get_world_size()
    return count.clamp_min(1)


def image_terms(found, batch, stride: int) -> dict:
    """What the images alone teach: boxes and object coordinates."""
    boxes = batch["true_box"].flatten(0, 1)
    absent = boxes.new_zeros(len(found.scores) - len(boxes), 4)  # the negatives' boxes
    detection = detection_loss(
        found.scores,
        found.boxes,
        torch.cat([boxes, absent]),
        torch.zeros(len(found.scores), dtype=torch.long, device=boxes.device),
        stride,
    )
    code = batch["coords"].flatten(0, 1)
    # Networks whose finest level is coarser take every other sample, and so on.
    skip = code.shape[2] // found.coordinates.shape[-1]
    wanted, mask = coordinates.decode(code[:, skip // 2 :: skip, skip // 2 :: skip])
    wanted = wanted.permute(0, 3, 1, 2)
    difference = F.smooth_l1_loss(found.coordinates, wanted, beta=0.1, reduction="none")
    shape = (difference.sum(1) * mask).sum() / mean_count(mask.sum())
    return {"detection": detection, "coordinates": shape}


def detection_loss(logits, boxes, truth, class_index, stride: int):
    """Focal loss on the center map and GIoU on the cells near each center.

    logits       [V, C, h, w]
    boxes        [V, 4, h, w] input px
    truth        [V, 4] the one object's box in each view; no object where x1 <= x0
    class_index  [V]
    """
    views, _, rows, columns = logits.shape
    present = truth[:, 2] > truth[:, 0]
    center = (truth[:, :2] + truth[:, 2:]) / 2
    size = (truth[:, 2:] - truth[:, :2]).clamp_min(1)
    u = (torch.arange(columns, device=logits.device) + 0.5) * stride - 0.5
    v = (torch.arange(rows, device=logits.device) + 0.5) * stride - 0.5
    sigma = (size / 8).clamp_min(stride * 0.6)
    dx = (u[None] - center[:, :1]) / sigma[:, :1]
    dy = (v[None] - center[:, 1:]) / sigma[:, 1:]
    heat = torch.exp(-0.5 * (dx[:, None, :] ** 2 + dy[:, :, None] ** 2)) * present[:, None, None]
    # The cell next to the center is the positive: its target is exactly 1.
    heat = torch.where(heat == heat.amax((1, 2), keepdim=True), present[:, None, None] * 1.0, heat)
    target = torch.zeros_like(logits)
    target[torch.arange(views, device=logits.device), class_index] = heat
    p = logits.sigmoid()
    positive = target == 1
    pos_loss = -F.logsigmoid(logits) * (1 - p) ** 2 * positive
    neg_loss = -F.logsigmoid(-logits) * p**2 * (1 - target) ** 4 * ~positive
    score_loss = (pos_loss.sum() + neg_loss.sum()) / mean_count(present.sum())
    near = heat > 0.3
    view, row, column = near.nonzero(as_tuple=True)
    box_losses = generalized_box_iou_loss(boxes[view, :, row, column], truth[view])
    box_loss = (box_losses * heat[near]).sum() / mean_count(heat[near].sum())
    return score_loss + 2 * box_loss
