"""The precision that networks are trained in."""

import functools
import time

import torch

PRECISIONS = ("auto", "bf16", "fp32")
# bf16 is chosen if a matrix product takes at most this share of its time in fp32: what is gained
# must pay for casts and copies, which are about 15 % of a step.
WORTH = 0.7
SIDES, REPEATS = (2048, 512, 512), 8


def autocast(device, precision: str = "auto"):
    """The context in which layers compute in `precision`, one of `PRECISIONS`.

    "auto" is bf16 on GPUs; on processors whatever is faster there, which is measured once
    """
    kind = torch.device(device).type
    if precision == "auto":
        precision = _fastest(kind)
    return torch.autocast(kind, dtype=torch.bfloat16, enabled=precision == "bf16")


@functools.cache
def _fastest(kind: str) -> str:
    if kind != "cpu":
        return "bf16"
    seconds = {dtype: _product(dtype) for dtype in (torch.float32, torch.bfloat16)}
    return "bf16" if seconds[torch.bfloat16] < WORTH * seconds[torch.float32] else "fp32"


def _product(dtype) -> float:
    """Least seconds of a matrix product."""
    rows, inner, columns = SIDES
    a, b = torch.ones(rows, inner, dtype=dtype), torch.ones(inner, columns, dtype=dtype)
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        a @ b
        times.append(time.perf_counter() - begun)
    return min(times)
