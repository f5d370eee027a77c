"""From a batch to what the network takes."""

import torch

from ..network.views import Cached, Pictures, Views


def to_device(batch: dict, device) -> dict:
    """Does not wait for the copies where the loader has pinned the memory."""
    return {name: x.to(device, non_blocking=True) for name, x in batch.items()}


def to_views(batch: dict, config, device="cpu") -> Views:
    """A batch of `batches.Batches` as the network takes it."""
    batch = to_device(batch, device)
    shape = batch["box"].shape[:2]
    return Views(
        shown=_pictures(batch, config) if "image" in batch else _cached(batch, config),
        k=batch["k"],
        ref_from_cam=batch["ref_from_cam"],
        boxes=batch["box"][:, :, None],
        valid=torch.ones(*shape, 1, device=device),
        class_index=batch["class_index"],
        inside=batch["inside"].float(),
    )


def _cached(batch: dict, config) -> Cached:
    maps = [batch[name].float() for name in sorted(batch) if name.startswith("features")]
    return Cached(maps, _searched(batch, config))


def _pictures(batch: dict, config) -> Pictures:
    return Pictures(normalised(batch["image"], batch["on_image"], config), _searched(batch, config))


def _searched(batch: dict, config) -> torch.Tensor | None:
    if "search_image" not in batch:
        return None
    return normalised(batch["search_image"], batch["search_on_image"], config)


def normalised(images, on_image, config) -> torch.Tensor:
    """[..., H, W, 3] uint8 to [..., 3, H, W] with the mean and spread that the network expects.

    Exactly 0 where it is not on the source image [..., H, W], as the padding of inference.
    """
    mean = torch.tensor(config.mean, device=images.device)[:, None, None]
    std = torch.tensor(config.std, device=images.device)[:, None, None]
    x = (images.movedim(-1, -3).float() / 255 - mean) / std
    return x * on_image[..., None, :, :]
