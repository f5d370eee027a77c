"""One step of the optimiser."""

import math

import torch

from ..data.inputs import to_device, to_views
from ..network import losses
from ..network.precision import autocast
from .checkpoint import TrainingState
from .runconfig import RunConfig

TRUTH = (
    "cam_from_obj", "class_index", "true_box", "coords", "extent", "search_boxes", "search_class",
)  # fmt: skip


def learning_rate(step: int, progress: float, peak: float, warmup: int) -> float:
    """Linear over the first steps, then half a cosine down to 2 % as `progress` goes to 1."""
    if step < warmup:
        peak = peak * (step + 1) / warmup
    return peak * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(progress, 1))))


def optimise(state: TrainingState, model, batch, settings: RunConfig, lr: float) -> dict:
    """One step of `model` on `batch`; returns the parts of the loss, still on the device.

    model: that of `state`, or the same one in all processes (`processes.distributed`)
    """
    views = to_views(batch, state.config, state.device)
    with autocast(state.device, settings.precision):
        prediction = model(views)
    truth = to_device({n: batch[n] for n in TRUTH if n in batch}, state.device)
    loss, parts = losses.total(
        prediction, truth, state.config.strides[0], state.symmetries, dict(settings.loss)
    )
    norm = descend(state, loss, lr, settings.clip)
    return {"loss": loss, "norm": norm, **parts}


def descend(state: TrainingState, loss: torch.Tensor, lr: float, clip: float) -> torch.Tensor:
    """One step down the gradient of `loss`, whose norm is returned.

    clip  greatest norm of each part that is learnt apart
    """
    for group in state.optimizer.param_groups:
        group["lr"] = group["scale"] * lr
    state.optimizer.zero_grad()
    loss.backward()
    clipped = torch.nn.utils.clip_grad_norm_
    norms = torch.stack([clipped(part, clip) for part in state.model.apart()])
    for parameter in state.model.parameters():
        if parameter.grad is not None:  # not finite anywhere: counts as zero everywhere
            parameter.grad.nan_to_num_(0, 0, 0)
    state.optimizer.step()
    return norms.norm()
