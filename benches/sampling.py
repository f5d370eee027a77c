"""Deformable sampling on one thread: mvtop's kernel beside ONNX Runtime and PyTorch.

    make wheel && PYTHONPATH=training .venv/bin/python benches/sampling.py

The same arrays for all: an encoder layer of two views, where each cell asks, at the sizes of the
shipped network's close-ups and of the `paper` preset. The others sample by their `grid_sample`, the
formulation in standard operators: ONNX Runtime as an exported graph, PyTorch as it is, with its
gradients too. They run in turn, round after round, so that all see the machine in the same state;
medians count. Results are compared, and the command fails where they differ.

Beside them, what this thread gets out of the processor where arithmetic is all (a product of two
matrices) and where reading is (the scalar product of two arrays as large as the feature map).
"""

import json
import os
import statistics
import time

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[threads] = "1"

import numpy as np  # noqa: E402
import onnxruntime as ort  # noqa: E402
import torch  # noqa: E402
from mvtop_train.errors import UserError, argument_parser, command  # noqa: E402
from mvtop_train.export import bundle  # noqa: E402
from mvtop_train.export.fixtures.operator import Sample  # noqa: E402
from mvtop_train.network import config, sampling  # noqa: E402

import mvtop  # noqa: E402 (after the threads)

VIEWS = 2
TOLERANCE = 1e-4
SECONDS = 0.05  # of one contestant in one round
NAMES = ("value", "locations", "weights")


def problem(preset: config.Config, seed: int):
    """(height, width) of each level, and value, locations, weights of an encoder layer."""
    rng = np.random.default_rng(seed)
    levels = preset.decoder_shapes()
    cells = sum(rows * columns for rows, columns in levels)
    taps = (VIEWS, cells, preset.heads, len(levels), preset.points)
    value = rng.normal(size=(VIEWS, cells, preset.heads, preset.d_model // preset.heads))
    inputs = (
        value,
        rng.uniform(-0.1, 1.1, (*taps, 2)),
        rng.dirichlet(np.ones(preset.points), taps[:-1]),
    )
    return levels, [x.astype(np.float32) for x in inputs]


def contestants(levels, inputs):
    """By name: what runs once and returns its results."""
    value, locations, weights = inputs
    shape = (value.shape[0], locations.shape[1], value.shape[2] * value.shape[3])
    out, grads = np.empty(shape, np.float32), [np.empty_like(x) for x in inputs]
    grad_out = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    tensors = [torch.from_numpy(x) for x in inputs]
    leaves = [x.clone().requires_grad_() for x in tensors]
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    with torch.no_grad(), sampling.standard_operators():
        graph = bundle.graph_of(Sample(levels), dict(zip(NAMES, tensors, strict=True)), ["out"], {})
    session = ort.InferenceSession(graph.SerializeToString(), options)
    feed = dict(zip(NAMES, inputs, strict=True))

    def kernel():
        mvtop.deformable_sampling_forward(*inputs, levels, out)
        return [out]

    def kernel_gradients():
        mvtop.deformable_sampling_backward(*inputs, levels, grad_out, *grads)
        return grads

    def torch_forward():
        with torch.no_grad():
            return [sampling.sample_torch(*tensors, levels).numpy()]

    sampled = sampling.sample_torch(*leaves, levels)

    def torch_gradients():
        given = torch.from_numpy(grad_out)
        return [x.numpy() for x in torch.autograd.grad(sampled, leaves, given, retain_graph=True)]

    return {
        "mvtop": kernel,
        "ONNX Runtime, GridSample": lambda: session.run(None, feed),
        "PyTorch, grid_sample": torch_forward,
        "mvtop, gradients": kernel_gradients,
        "PyTorch, gradients": torch_gradients,
    }


def ceilings(inputs):
    """By name: what runs once, and how many floating-point operations and bytes that is."""
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 512, 512)).astype(np.float32)
    x = inputs[0].ravel()
    y = x.copy()
    return {
        "matrices": (lambda: a @ b, 2 * 512**3, 0),
        "reading": (lambda: x @ y, 0, x.nbytes + y.nbytes),
    }


def medians(runs: dict, rounds: int) -> dict:
    """Seconds of one call of each."""
    times = {name: [] for name in runs}
    for run in runs.values():
        run()
    for _ in range(rounds):
        for name, run in runs.items():
            start, calls = time.perf_counter(), 0
            while time.perf_counter() - start < SECONDS:
                run()
                calls += 1
            times[name].append((time.perf_counter() - start) / calls)
    return {name: statistics.median(all_rounds) for name, all_rounds in times.items()}


def check(runs: dict) -> None:
    """Whether all give the same."""
    for ours, theirs in (
        ("mvtop", "ONNX Runtime, GridSample"),
        ("mvtop", "PyTorch, grid_sample"),
        ("mvtop, gradients", "PyTorch, gradients"),
    ):
        for a, b in zip(runs[ours](), runs[theirs](), strict=True):
            off = float(np.abs(a - b).max() / np.abs(b).max())
            if off > TOLERANCE:
                raise UserError(f"{ours} and {theirs}: results differ by {off:.1e} of the largest")


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(1)
    mvtop.set_num_threads(1)
    for name in ("tiny", "small"):
        levels, inputs = problem(config.PRESETS[name], args.seed)
        runs, known = contestants(levels, inputs), ceilings(inputs)
        check(runs)
        took = medians(runs | {name: run for name, (run, _, _) in known.items()}, args.rounds)
        value, _, weights = inputs
        # Of each tap four corners: a product and a sum of each channel.
        reads = weights.size * 4 * value.shape[3]
        figures = {
            "preset": name,
            "levels": levels,
            "cells": value.shape[1],
            "heads, channels": value.shape[2:],
            "ms": {name: round(took[name] * 1e3, 3) for name in runs},
            "as long as mvtop": {
                "ONNX Runtime": round(took["ONNX Runtime, GridSample"] / took["mvtop"], 1),
                "PyTorch": round(took["PyTorch, grid_sample"] / took["mvtop"], 1),
                "PyTorch, gradients": round(
                    took["PyTorch, gradients"] / took["mvtop, gradients"], 1
                ),
            },
            "GFLOP/s": {
                "mvtop": round(2 * reads / took["mvtop"] / 1e9, 1),
                "matrices": round(known["matrices"][1] / took["matrices"] / 1e9, 1),
            },
            "GB/s": {
                "mvtop": round(4 * reads / took["mvtop"] / 1e9, 1),
                "reading": round(known["reading"][2] / took["reading"] / 1e9, 1),
            },
        }
        print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
