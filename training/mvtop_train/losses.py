"""From a prediction and the truth to one number to minimise."""

import torch
import torch.nn.functional as F

from . import pose
from .features import detection_loss
from .processes import mean_count

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
        "uncertainty": pose.uncertainty_loss(sigma, degrees, t).mean(),
    }
    if prediction.scores is not None:
        terms |= image_terms(prediction, batch, stride)
    parts = {
        "rotation_deg": degrees[-1].mean(),
        "translation_m": t[-1].mean(),
        **{name: term for name, term in terms.items() if name not in ("rotation", "translation")},
    }
    return sum(weights[name] * term for name, term in terms.items()), parts


def image_terms(prediction, batch, stride: int) -> dict:
    """What the images alone teach: boxes and object coordinates."""
    boxes = batch["boxes"].flatten(0, 1)
    absent = boxes.new_zeros(len(prediction.scores) - len(boxes), 4)  # the negatives' boxes
    detection = detection_loss(
        prediction.scores,
        prediction.boxes,
        torch.cat([boxes, absent]),
        torch.zeros(len(prediction.scores), dtype=torch.long, device=boxes.device),
        stride,
    )
    code = batch["coords"].flatten(0, 1).float().permute(0, 3, 1, 2)
    # Networks whose finest level is coarser take every other sample, and so on.
    skip = code.shape[-1] // prediction.coordinates.shape[-1]
    code = code[..., skip // 2 :: skip, skip // 2 :: skip]
    mask = (code != 0).all(1)
    wanted = (code - 128) / 120  # `bop.decode_coords`
    difference = F.smooth_l1_loss(prediction.coordinates, wanted, beta=0.1, reduction="none")
    coordinates = (difference.sum(1) * mask).sum() / mean_count(mask.sum())
    return {"detection": detection, "coordinates": coordinates}
