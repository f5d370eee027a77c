"""From a batch to what the network takes."""

import torch

from ..network import rays
from ..network.views import Views


def to_device(batch: dict, device) -> dict:
    """Does not wait for the copies where the loader has pinned the memory."""
    return {name: x.to(device, non_blocking=True) for name, x in batch.items()}


def to_views(batch: dict, config, device="cpu") -> Views:
    """A batch of `collate.collate` or `closeup.collate` as the network takes it."""
    batch = to_device(batch, device)
    shape = batch["boxes_in"].shape[:2]
    seen = _of_closeups if "inside" in batch else _of_crops
    return Views(
        k=batch["k"],
        ref_from_cam=batch["ref_from_cam"],
        boxes=batch["boxes_in"][:, :, None],
        valid=torch.ones(*shape, 1, device=device),
        class_index=torch.zeros(shape[0], 1, dtype=torch.long, device=device),
        **seen(batch, config, device),
    )


def _of_closeups(batch: dict, config, device) -> dict:
    """Pictures of close-ups, or the levels that the backbone makes of them."""
    if "images" in batch:
        images = _standard(batch["images"], config) * batch["on_image"][..., None, :, :]
        return {"images": images, "inside": batch["inside"]}
    counts = [rows * columns for rows, columns in config.decoder_shapes()]
    tokens = batch["features"].float().split(counts, 2)
    levels = [
        part.transpose(2, 3).unflatten(-1, shape)
        for part, shape in zip(tokens, config.decoder_shapes(), strict=True)
    ]
    return {"images": None, "levels": levels, "inside": batch["inside"]}


def _of_crops(batch: dict, config, device) -> dict:
    height, width = batch["images"].shape[-3:-1]
    pixels = rays.cell_centers(config.level_shapes(height, width), config.pose_strides, device)
    source = _apply(batch["image_from_crop"][..., None, :, :], pixels)
    size = batch["image_size"][:, :, None]
    inside = ((source >= -0.5) & (source <= size - 0.5)).all(-1).float()
    negatives = None
    if "negatives" in batch:
        negatives = _normalised(
            batch["negatives"],
            batch["negatives_image_from_crop"],
            batch["negatives_image_size"],
            config,
        )
    images = _normalised(batch["images"], batch["image_from_crop"], batch["image_size"], config)
    return {"images": images, "inside": inside, "negatives": negatives}


def _apply(a, points):
    """Affine maps [..., 2, 3] on points [..., 2]."""
    return (a[..., :2] @ points[..., None])[..., 0] + a[..., 2]


def _normalised(images, image_from_crop, image_size, config):
    """Crops [..., H, W, 3] uint8 as [..., 3, H, W], 0 where they are off their source image."""
    mask = _pixel_mask(image_from_crop, image_size, *images.shape[-3:-1])
    return _standard(images, config) * mask[..., None, :, :]


def _standard(images, config):
    """[..., H, W, 3] uint8 to [..., 3, H, W] with the mean and spread that the network expects."""
    mean = torch.tensor(config.mean, device=images.device)[:, None, None]
    std = torch.tensor(config.std, device=images.device)[:, None, None]
    return (images.movedim(-1, -3).float() / 255 - mean) / std


def _pixel_mask(a, image_size, height, width):
    """1.0 where a crop pixel lies on its source image [..., H, W]; the rest is exactly 0, as the
    padding of inference."""
    u = torch.arange(width, device=a.device, dtype=torch.float32)
    v = torch.arange(height, device=a.device, dtype=torch.float32)[:, None]
    inside = torch.ones((), device=a.device)
    for axis in range(2):
        row = a[..., axis, :, None, None]
        s = row[..., 0, :, :] * u + row[..., 1, :, :] * v + row[..., 2, :, :]
        inside = inside * (s >= -0.5) * (s <= image_size[..., axis, None, None] - 0.5)
    return inside
