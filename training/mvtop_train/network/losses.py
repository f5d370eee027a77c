"""From a prediction and the truth to one number to minimise."""

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torchvision.ops import generalized_box_iou_loss

from . import coordinates, pose, symmetry

ROTATION, TRANSLATION, DETECTION, COORDINATES, UNCERTAINTY = 1.0, 10.0, 2.0, 6.0, 0.02
TRUST = 1.0
SCORE = 0.2
# What all hypotheses together learn of the truth, beside the one that is nearest to it: those that
# never win would otherwise learn nothing.
SHARED = 0.08
EXACT = 0.02  # of the extent: coordinates that are farther off count by how far, not by its square
HALF_TRUSTED = 0.1  # coordinates that are this far off, in extents, are trusted by half
WEIGHTS = {
    "rotation": ROTATION,
    "translation": TRANSLATION,
    "detection": DETECTION,
    "coordinates": COORDINATES,
    "uncertainty": UNCERTAINTY,
    "trust": TRUST,
    "score": SCORE,
}


def nearest_truth(poses, cam_from_obj, class_index, known: symmetry.Symmetries):
    """Of the poses that look like the truth, the one nearest to each layer's prediction.

    cam_from_obj [B, Q, 4, 4], class_index [B, Q]; returns poses and symmetries [layers, B, Q, 4, 4]
    """
    rotations = torch.stack([pose.rotation_from_6d(six) for six, _, _ in poses])
    translations = torch.stack([t for _, t, _ in poses])
    truth = cam_from_obj.expand(len(poses), *cam_from_obj.shape)
    index = class_index.expand(len(poses), *class_index.shape)
    turns = symmetry.nearest(rotations, translations, truth, index, known)
    return truth @ turns, turns


def pose_errors(poses, cam_from_obj):
    """Rotation (radians) and translation (m) error [layers, B, Q] of `Prediction.poses`.

    cam_from_obj  [B, Q, 4, 4], or one for each layer
    """
    rotations = torch.stack([pose.rotation_from_6d(six) for six, _, _ in poses])
    translations = torch.stack([t for _, t, _ in poses])
    rot = pose.rotation_angle(rotations, cam_from_obj[..., :3, :3].expand_as(rotations))
    return rot, pose.translation_error(translations, cam_from_obj[..., :3, 3])


def total(prediction, batch, stride: int, known: symmetry.Symmetries, weights=WEIGHTS):
    """Loss and its parts. Every decoder layer counts alike (auxiliary losses, PoET)."""
    terms, shown = {}, {}
    in_ref = batch["cam_from_obj"][:, :1]  # one object
    if prediction.poses:
        truth, turns = nearest_truth(prediction.poses, in_ref, batch["class_index"], known)
        rot, t = pose_errors(prediction.poses, truth)
        degrees = torch.rad2deg(rot)
        if prediction.hypotheses:
            terms |= hypotheses_loss(prediction.hypotheses, batch, known, weights)
        else:
            sigma = torch.stack([s for _, _, s in prediction.poses])
            terms |= {
                "rotation": rot.mean(1).sum(),
                "translation": t.mean(1).sum(),
                "uncertainty": uncertainty_loss(sigma, degrees, t).mean(),
            }
        shown |= {"rotation_deg": degrees[-1].mean(), "translation_m": t[-1].mean()}
        turns = turns[-1].expand_as(batch["cam_from_obj"])
    else:  # a view knows nothing of the others
        turns = upright(batch["cam_from_obj"], batch["class_index"], known)
    if prediction.found is not None:
        terms |= image_terms(prediction.found, batch, stride, turns)
    parts = shown | {
        name: term for name, term in terms.items() if name not in ("rotation", "translation")
    }
    return sum(weights[name] * term for name, term in terms.items()), parts


def hypotheses_loss(several, batch, known: symmetry.Symmetries, weights) -> dict:
    """Of several poses the one nearest to the truth learns it, and the scores learn which that is
    (winner takes most: Rupprecht et al. 2017).

    several  per layer, see `heads.Hypotheses`
    """
    count = several[0].score.shape[-1]
    flat = [[x.flatten(1, 2) for x in layer[:3]] for layer in several]
    class_index = batch["class_index"].repeat_interleave(count, 1)
    in_ref = batch["cam_from_obj"][:, :1].repeat_interleave(count, 1)
    truth, _ = nearest_truth(flat, in_ref, class_index, known)
    rot, t = pose_errors(flat, truth)
    sigma = torch.stack([layer[2] for layer in flat])
    unsure = uncertainty_loss(sigma, torch.rad2deg(rot), t)
    rot, t, unsure = (x.unflatten(-1, (-1, count)) for x in (rot, t, unsure))  # [layers, B, Q, K]
    cost = weights["rotation"] * rot + weights["translation"] * t
    winner = cost.argmin(-1)
    share = F.one_hot(winner, count) * (1 - SHARED) + SHARED / count
    score = torch.stack([layer.score for layer in several])
    return {
        "rotation": (rot * share).sum(-1).mean(1).sum(),
        "translation": (t * share).sum(-1).mean(1).sum(),
        "uncertainty": (unsure * share).sum(-1).mean(),
        "score": F.cross_entropy(score.flatten(0, 2), winner.flatten()),
    }


def upright(cam_from_obj, class_index, known: symmetry.Symmetries):
    """The symmetries [B, V, 4, 4] after which objects stand as upright in each view as they can.

    cam_from_obj [B, V, 4, 4], class_index [B, 1]
    """
    identity = torch.eye(3, device=cam_from_obj.device).expand_as(cam_from_obj[..., :3, :3])
    index = class_index.expand(cam_from_obj.shape[:2])
    return symmetry.nearest(identity, None, cam_from_obj, index, known)


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


def image_terms(found, batch, stride: int, turns) -> dict:
    """What the images alone teach: boxes and object coordinates.

    turns  [B, V, 4, 4], the symmetries after which the coordinates are wanted
    """
    terms = {}
    if found.coordinates is not None:
        terms |= coordinates_loss(found, batch, turns)
    if found.scores is not None:
        if "search_boxes" in batch:
            truth, index = batch["search_boxes"], batch["search_class"]
        else:  # the views themselves, then images without objects
            shown = batch["true_box"].flatten(0, 1)[:, None]
            truth = shown.new_zeros(len(found.scores), 1, 4)
            truth[: len(shown)] = shown
            index = torch.zeros(truth.shape[:2], dtype=torch.long, device=truth.device)
            views = batch["true_box"].shape[1]
            index[: len(shown)] = batch["class_index"].repeat_interleave(views, 0)
        terms["detection"] = detection_loss(found.scores, found.boxes, truth, index, stride)
    return terms


def coordinates_loss(found, batch, turns) -> dict:
    """Of the coordinates where the object is seen, and of the trust in them everywhere."""
    code = batch["coords"].flatten(0, 1)
    # Networks whose finest level is coarser take every other sample, and so on.
    skip = code.shape[2] // found.coordinates.shape[-1]
    wanted, mask = coordinates.decode(code[:, skip // 2 :: skip, skip // 2 :: skip])
    extent, back = batch["extent"].flatten(0, 1), turns.flatten(0, 1).inverse()
    wanted = torch.einsum("nij,nhwj->nhwi", back[:, :3, :3], wanted)
    wanted = wanted + (back[:, :3, 3] / extent[:, None])[:, None, None]
    wanted = wanted.permute(0, 3, 1, 2)
    difference = F.smooth_l1_loss(found.coordinates, wanted, beta=EXACT, reduction="none")
    terms = {"coordinates": (difference.sum(1) * mask).sum() / mean_count(mask.sum())}
    if found.trust is not None:
        off = (found.coordinates.detach() - wanted).square().sum(1, keepdim=True)
        right = mask[:, None] / (1 + off / HALF_TRUSTED**2)
        terms["trust"] = F.binary_cross_entropy_with_logits(found.trust, right)
    return terms


def detection_loss(logits, boxes, truth, class_index, stride: int):
    """Focal loss on the center maps and GIoU on the cells near each center.

    logits       [N, C, h, w]
    boxes        [N, 4, h, w] input px
    truth        [N, K, 4] the objects' boxes in each image; no object where x1 <= x0
    class_index  [N, K]; -1: something that may be found or not, as too little of it is seen
    """
    _, classes, rows, columns = logits.shape
    there = truth[..., 2] > truth[..., 0]
    some = there.any(0)  # K is room for many more than most images show
    some[0] = True
    truth, class_index, there = truth[:, some], class_index[:, some], there[:, some]
    present = there & (class_index >= 0)
    center = (truth[..., :2] + truth[..., 2:]) / 2
    size = (truth[..., 2:] - truth[..., :2]).clamp_min(1)
    u = (torch.arange(columns, device=logits.device) + 0.5) * stride - 0.5
    v = (torch.arange(rows, device=logits.device) + 0.5) * stride - 0.5
    sigma = (size / 8).clamp_min(stride * 0.6)
    dx = (u - center[..., :1]) / sigma[..., :1]
    dy = (v - center[..., 1:]) / sigma[..., 1:]
    heat = torch.exp(-0.5 * (dx[..., None, :] ** 2 + dy[..., :, None] ** 2))  # [N, K, h, w]
    either = (heat * (there & ~present)[..., None, None]).amax(1, keepdim=True) > 0.1
    heat = heat * present[..., None, None]
    # The cell next to the center is the positive: its target is exactly 1.
    heat = torch.where(
        heat == heat.amax((2, 3), keepdim=True), present[..., None, None] * 1.0, heat
    )
    of_class = F.one_hot(class_index.clamp_min(0), classes)[..., None, None]
    target = (heat[:, :, None] * of_class).amax(1)
    p = logits.sigmoid()
    positive = target == 1
    pos_loss = -F.logsigmoid(logits) * (1 - p) ** 2 * positive
    neg_loss = -F.logsigmoid(-logits) * p**2 * (1 - target) ** 4 * ~positive * ~either
    score_loss = (pos_loss.sum() + neg_loss.sum()) / mean_count(present.sum())
    best, owner = heat.max(1)  # a cell speaks of the object whose center is nearest
    near = best > 0.3
    view, row, column = near.nonzero(as_tuple=True)
    box_losses = generalized_box_iou_loss(boxes[view, :, row, column], truth[view, owner[near]])
    box_loss = (box_losses * best[near]).sum() / mean_count(best[near].sum())
    return score_loss + 2 * box_loss
