"""One step of the optimiser."""

import math

import torch

from ..data.inputs import to_device, to_views
from . import losses, runconfig
from .checkpoint import Run


def autocast(device, precision: str = "bf16"):
    kind = torch.device(device).type
    return torch.autocast(kind, dtype=torch.bfloat16, enabled=precision == "bf16")


def learning_rate(step: int, progress: float, peak: float, warmup: int) -> float:
    """Linear over the first steps, then half a cosine down to 2 % as `progress` goes to 1."""
    if step < warmup:
        peak = peak * (step + 1) / warmup
    return peak * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(progress, 1))))


def optimise(run: Run, model, batch, settings: runconfig.RunConfig, lr: float, device) -> dict:
    """One step on `batch`; returns the parts of the loss, still on the device."""
    views = to_views(batch, run.config, device)
    with autocast(device, settings.precision):
        prediction = model(views)
    names = ("cam_from_obj", "true_box", "coords")
    truth = to_device({n: batch[n] for n in names if n in batch}, device)
    loss, parts = losses.total(prediction, truth, run.config.strides[0], settings.weights())
    norm = descend(run, loss, lr, settings.clip)
    return {"loss": loss, "norm": norm, **parts}


def descend(run: Run, loss: torch.Tensor, lr: float, clip: float) -> torch.Tensor:
    """One step down the gradient of `loss`, whose norm is returned."""
    for group in run.optimizer.param_groups:
        group["lr"] = group["scale"] * lr
    run.optimizer.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(run.model.parameters(), clip)
    for parameter in run.model.parameters():
        if parameter.grad is not None:  # not finite anywhere: counts as zero everywhere
            parameter.grad.nan_to_num_(0, 0, 0)
    run.optimizer.step()
    return norm
