"""Views as arrays, put together to a batch of tensors."""

import numpy as np
import torch


def collate(items: list[list[dict]], boxes_of, jitter: float):
    """Scenes x views of `make_view` dicts to a dict of tensors.

    images [B, V, H, W, 3] uint8, k, ref_from_cam, cam_from_obj, boxes (true, clipped to the
    crop), boxes_in (jittered, what the decoder is given), coords, image_from_crop, image_size.
    """

    def stack(key):
        return np.stack([[view[key] for view in views] for views in items])

    k, cam_from_obj, cam_from_world = stack("k"), stack("cam_from_obj"), stack("cam_from_world")
    images = stack("image")
    size = images.shape[2]
    boxes = boxes_of(k, cam_from_obj)
    extent = np.concatenate([boxes[..., 2:] - boxes[..., :2]] * 2, -1)
    boxes_in = boxes + stack("box_noise") * jitter * extent
    boxes, boxes_in = boxes.clip(-0.5, size - 0.5), boxes_in.clip(-0.5, size - 0.5)
    ref_from_cam = cam_from_world[:, :1] @ np.linalg.inv(cam_from_world)
    tensors = {
        "k": k, "ref_from_cam": ref_from_cam, "cam_from_obj": cam_from_obj,
        "boxes": boxes, "boxes_in": boxes_in,
    }  # fmt: skip
    tensors = {name: torch.from_numpy(x.astype(np.float32)) for name, x in tensors.items()}
    for name, x in (("images", images), ("coords", stack("coords"))):
        tensors[name] = torch.from_numpy(np.ascontiguousarray(x))
    for name in ("image_from_crop", "image_size"):
        tensors[name] = torch.from_numpy(stack(name).astype(np.float32))
    return tensors


def collate_negatives(items: list[dict]) -> dict[str, torch.Tensor]:
    """`make_negative` dicts to negatives [M, H, W, 3] uint8 and where they lie on their images."""
    tensors = {"negatives": torch.from_numpy(np.stack([x["image"] for x in items]))}
    for name in ("image_from_crop", "image_size"):
        stacked = np.stack([x[name] for x in items]).astype(np.float32)
        tensors[f"negatives_{name}"] = torch.from_numpy(stacked)
    return tensors
