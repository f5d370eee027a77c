"""Several processes that train one network (`torchrun`), each on its part of every batch.

Their averaged gradients are those of one process on the whole batch, because whatever one process
would take over the batch is taken over all of them: the counts that losses are divided by
(`losses.mean_count`) and the statistics of batch normalisation (`share_batch_norm`).
"""

import os
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn

from ..errors import UserError


@dataclass(frozen=True)
class Processes:
    """This process among all; rank 0 alone writes files and validates."""

    rank: int
    count: int
    device: str


def join() -> Processes:
    """The process that `torchrun` started, or the only one; with CUDA, each has its own GPU."""
    rank, count = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
    device = "cpu"
    if torch.cuda.is_available():
        local = int(os.environ.get("LOCAL_RANK", 0))
        if local >= torch.cuda.device_count():
            raise UserError(
                f"processes: expected at most {torch.cuda.device_count()} on this machine, "
                f"one per GPU, got {local + 1} or more; fix: --nproc_per_node"
            )
        torch.cuda.set_device(local)
        torch.backends.cudnn.benchmark = True  # crops of one size: the search pays
        device = f"cuda:{local}"
    if "WORLD_SIZE" in os.environ:
        dist.init_process_group("gloo" if device == "cpu" else "nccl")
    return Processes(rank, count, device)


def leave():
    if dist.is_initialized():
        dist.destroy_process_group()


def from_first(value: float, device: str) -> float:
    """What rank 0 has (of clocks, which differ)."""
    if not dist.is_initialized():
        return value
    shared = torch.tensor(value, dtype=torch.float64, device=device)
    dist.broadcast(shared, 0)
    return shared.item()


class _Mean(torch.autograd.Function):
    """Mean over the processes; each one's loss depends on it, so gradients are averaged too."""

    @staticmethod
    def forward(ctx, x):
        total = x.clone()
        dist.all_reduce(total)
        return total / dist.get_world_size()

    backward = forward


class SharedBatchNorm(nn.BatchNorm2d):
    """Batch normalisation over all processes. PyTorch's SyncBatchNorm is for GPUs only."""

    def forward(self, x):
        if not self.training:
            return super().forward(x)
        values = x.float()
        mean = _Mean.apply(values.mean((0, 2, 3)))
        values = values - mean[:, None, None]
        variance = _Mean.apply(values.square().mean((0, 2, 3)))
        n = values.numel() // values.shape[1] * dist.get_world_size()
        with torch.no_grad():
            self.num_batches_tracked.add_(1)
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * n / (n - 1), self.momentum)
        scale = self.weight * torch.rsqrt(variance + self.eps)
        return (values * scale[:, None, None] + self.bias[:, None, None]).to(x.dtype)


def share_batch_norm(model: nn.Module) -> nn.Module:
    """`model` with batch normalisation over all processes; its parameters stay the same ones."""
    if next(model.parameters()).device.type == "cuda":
        return nn.SyncBatchNorm.convert_sync_batchnorm(model)
    for module in model.modules():
        if type(module) is nn.BatchNorm2d:
            module.__class__ = SharedBatchNorm
    return model


def distributed(model: nn.Module, processes: Processes, unused: bool) -> nn.Module:
    """`model` so that its gradients are averaged over the processes.

    `unused`: some parameters do not take part in the loss.
    """
    if not dist.is_initialized():
        return model
    share_batch_norm(model)
    gpu = None if processes.device == "cpu" else [torch.device(processes.device).index]
    return nn.parallel.DistributedDataParallel(
        model, device_ids=gpu, broadcast_buffers=False, find_unused_parameters=unused
    )
