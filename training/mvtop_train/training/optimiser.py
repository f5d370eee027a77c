"""What takes the weights down the gradient: AdamW, and Muon for the matrices inside lite networks.

Muon goes along the orthogonal matrix that is nearest to the momentum, so that no direction of a
layer is learnt before the others (Jordan et al. 2024, kellerjordan.github.io/posts/muon). Its steps
are scaled to AdamW's size (Liu et al. 2025, arXiv 2502.16982), so that one learning rate is right
for both.
"""

import torch

from ..network.model import Mvtop

MOMENTUM = 0.95
NEWTON_SCHULZ = (3.4445, -4.7750, 2.0315)  # coefficients of Jordan et al.
ITERATIONS = 5
ADAMW_SIZE = 0.2  # root mean square of a step of AdamW at a learning rate of 1
LEAST_SIDE = 17  # of a matrix inside; smaller ones give results, or are depthwise
DECAY = 1e-4
PRETRAINED, OFFSETS = 0.25, 0.1  # shares of the learning rate; of offsets as in Deformable DETR


def orthogonal(matrix: torch.Tensor) -> torch.Tensor:
    """About the nearest matrix [n, m] with orthonormal rows, or columns of a tall one: singular
    values become 0.7 to 1.2."""
    tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if tall else matrix
    x = x / (x.norm() + 1e-7)
    a, b, c = NEWTON_SCHULZ
    # All iterations are polynomials of the same small square: the long side comes in only twice. In
    # half precision it would be too far off.
    square = x @ x.T
    whole = unit = torch.eye(len(x), device=x.device)
    for _ in range(ITERATIONS):
        factor = a * unit + b * square + c * (square @ square)
        whole, square = factor @ whole, factor @ square @ factor
    x = whole @ x
    return x.T if tall else x


class Muon(torch.optim.Optimizer):
    """For weights [out, in, ...], matrices [out, the rest]."""

    def __init__(self, groups: list[dict]):
        super().__init__(groups, {"lr": 1e-3, "weight_decay": DECAY})

    @torch.no_grad()
    def step(self):
        for group in self.param_groups:
            for weight in group["params"]:
                if weight.grad is None:
                    continue
                state = self.state[weight]
                if not state:
                    state["momentum"] = torch.zeros_like(weight)
                momentum = state["momentum"].lerp_(weight.grad, 1 - MOMENTUM)
                ahead = weight.grad.lerp(momentum, MOMENTUM).flatten(1)  # Nesterov's
                size = ADAMW_SIZE * max(ahead.shape) ** 0.5
                weight.mul_(1 - group["lr"] * group["weight_decay"])
                weight.add_(orthogonal(ahead).view(weight.shape), alpha=-group["lr"] * size)


class Optimizer:
    """Both; groups have a `scale`, their share of the learning rate."""

    def __init__(self, model: Mvtop):
        decay, plain, slow, pretrained = [], [], [], []
        matrices, pretrained_matrices = [], []
        lite = model.config.backbone == "lite"
        for name, p in model.named_parameters():
            if not p.requires_grad:
                continue
            learnt_before = lite and ".stage" in name
            if lite and p.ndim > 1 and min(p.shape[0], p.shape[1:].numel()) >= LEAST_SIDE:
                (pretrained_matrices if learnt_before else matrices).append(p)
            elif ".offsets." in name:
                slow.append(p)
            elif learnt_before:
                pretrained.append(p)
            else:
                (decay if p.ndim > 1 else plain).append(p)
        self.parts = {
            "adamw": _made(torch.optim.AdamW, (
                {"params": decay, "weight_decay": DECAY, "scale": 1.0},
                {"params": plain, "weight_decay": 0.0, "scale": 1.0},
                {"params": slow, "weight_decay": 0.0, "scale": OFFSETS},
                {"params": pretrained, "weight_decay": DECAY, "scale": PRETRAINED},
            ), lr=1e-3, fused=True),
            "muon": _made(Muon, (
                {"params": matrices, "scale": 1.0},
                {"params": pretrained_matrices, "scale": PRETRAINED},
            )),
        }  # fmt: skip
        self.parts = {name: part for name, part in self.parts.items() if part is not None}

    @property
    def param_groups(self) -> list[dict]:
        return [group for part in self.parts.values() for group in part.param_groups]

    def zero_grad(self):
        for part in self.parts.values():
            part.zero_grad(set_to_none=True)

    def step(self):
        for part in self.parts.values():
            part.step()

    def state_dict(self) -> dict:
        return {name: part.state_dict() for name, part in self.parts.items()}

    def load_state_dict(self, state: dict):
        for name, part in self.parts.items():
            part.load_state_dict(state[name])


def _made(kind, groups: tuple[dict, ...], **options):
    """An optimiser of the groups that have weights; None of none."""
    groups = [group for group in groups if group["params"]]
    return kind(groups, **options) if groups else None
