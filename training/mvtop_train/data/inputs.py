"""From a batch to what the network takes."""

import torch

from ..network.views import Levels, Pictures, Views


def to_device(batch: dict, device) -> dict:
    """Does not wait for the copies where the loader has pinned the memory."""
    return {name: x.to(device, non_blocking=True) for name, x in batch.items()}


def to_views(batch: dict, config, device="cpu") -> Views:
    """A batch of `batches.Batches` as the network takes it."""
    batch = to_device(batch, device)
    shape = batch["box"].shape[:2]
    return Views(
        shown=_levels(batch, config) if "features" in batch else _pictures(batch, config),
        k=batch["k"],
        ref_from_cam=batch["ref_from_cam"],
        boxes=batch["box"][:, :, None],
        valid=torch.ones(*shape, 1, device=device),
        class_index=torch.zeros(shape[0], 1, dtype=torch.long, device=device),
        inside=batch["inside"].float(),
    )


def _levels(batch: dict, config) -> Levels:
    shapes = config.decoder_shapes()
    tokens = batch["features"].float().split([rows * columns for rows, columns in shapes], 2)
    return Levels(
        [x.transpose(2, 3).unflatten(-1, shape) for x, shape in zip(tokens, shapes, strict=True)]
    )


def _pictures(batch: dict, config) -> Pictures:
    negatives = None
    if "negative_image" in batch:
        negatives = normalised(batch["negative_image"], batch["negative_on_image"], config)
    return Pictures(normalised(batch["image"], batch["on_image"], config), negatives)


def normalised(images, on_image, config) -> torch.Tensor:
    """[..., H, W, 3] uint8 to [..., 3, H, W] with the mean and spread that the network expects.

    Exactly 0 where it is not on the source image [..., H, W], as the padding of inference.
    """
    mean = torch.tensor(config.mean, device=images.device)[:, None, None]
    std = torch.tensor(config.std, device=images.device)[:, None, None]
    x = (images.movedim(-1, -3).float() / 255 - mean) / std
    return x * on_image[..., None, :, :]
