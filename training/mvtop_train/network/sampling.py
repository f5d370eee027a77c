"""Deformable sampling: weighted bilinear samples around reference points.

One definition, three carriers: mvtop's Rust kernel with its backward pass (CPU training, several
times faster than `grid_sample`), plain PyTorch (GPU, and the reference of the tests), and the
operator `mvtop::DeformableSampling` in exported graphs.
"""

import functools

import torch
import torch.nn.functional as F


@functools.cache
def _kernel():
    """mvtop with its Rust kernel, imported when it is first asked for; None where there is none."""
    try:
        import mvtop
    except ImportError:
        return None
    mvtop.set_num_threads(torch.get_num_threads())
    return mvtop


def kernel_available() -> bool:
    """Whether mvtop's wheel, which has the Rust kernel, is installed (`make wheel` does it)."""
    return _kernel() is not None


def sample_torch(value, locations, weights, level_shapes):
    """Reference in standard operators; shapes as `deformable_sampling`."""
    b, _, h, d = value.shape
    q, k = locations.shape[1], locations.shape[4]
    sampled = []
    levels = value.split([rows * columns for rows, columns in level_shapes], dim=1)
    for level, (rows, columns) in enumerate(level_shapes):
        maps = levels[level].permute(0, 2, 3, 1).reshape(b * h, d, rows, columns)
        grid = 2 * locations[:, :, :, level] - 1  # [B, Q, H, K, 2]
        grid = grid.transpose(1, 2).reshape(b * h, q, k, 2)
        sampled.append(F.grid_sample(maps, grid, padding_mode="zeros", align_corners=False))
    sampled = torch.stack(sampled, -2)  # [B*H, D, Q, L, K]
    weights = weights.transpose(1, 2).reshape(b * h, 1, q, len(level_shapes), k)
    summed = (sampled * weights).sum((-2, -1))  # [B*H, D, Q]
    return summed.reshape(b, h * d, q).transpose(1, 2)


def _arrays(tensors):
    """NumPy's views of tensors: nothing is copied."""
    return [tensor.detach().numpy() for tensor in tensors]


class _RustSampling(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value, locations, weights, shapes):
        inputs = [t.contiguous() for t in (value, locations, weights)]
        ctx.save_for_backward(*inputs)
        ctx.shapes = shapes
        out = value.new_empty(value.shape[0], locations.shape[1], value.shape[2] * value.shape[3])
        _kernel().deformable_sampling_forward(*_arrays(inputs), shapes, *_arrays([out]))
        return out

    @staticmethod
    def backward(ctx, grad_out):
        grads = [torch.empty_like(t) for t in ctx.saved_tensors]
        _kernel().deformable_sampling_backward(
            *_arrays(ctx.saved_tensors), ctx.shapes, *_arrays([grad_out.contiguous(), *grads])
        )
        return *grads, None


class _ExportedSampling(torch.autograd.Function):
    """Traced into `mvtop::DeformableSampling` by the ONNX exporter."""

    @staticmethod
    def forward(ctx, value, locations, weights, shapes, channels):
        return sample_torch(value, locations, weights, shapes)

    @staticmethod
    def symbolic(g, value, locations, weights, shapes, channels):
        out = g.op(
            "mvtop::DeformableSampling", value, locations, weights,
            level_shapes_i=[s for shape in shapes for s in shape],
        )  # fmt: skip
        # Providers that take the dense runs between the operators need the rank of its output.
        out.setType(value.type().with_sizes([None, None, channels]))
        return out


def deformable_sampling(value, locations, weights, level_shapes):
    """Sum over levels and points of `weight * bilinear(value at location)`, per head.

    value      [B, N, H, D]  N cells: all levels one after the other, row by row
    locations  [B, Q, H, L, K, 2]  (x, y) in 0..1 over the whole level; zero outside
    weights    [B, Q, H, L, K]
    returns    [B, Q, H * D]

    Source: Deformable DETR (Zhu et al. 2021), equation 3.
    """
    if torch.onnx.is_in_onnx_export() and not _portable:
        channels = int(value.shape[2] * value.shape[3])
        return _ExportedSampling.apply(value, locations, weights, level_shapes, channels)
    inputs = (value, locations, weights)
    rust = _kernel() is not None and all(
        x.device.type == "cpu" and x.dtype == torch.float32 for x in inputs
    )
    if rust and not torch.onnx.is_in_onnx_export():
        return _RustSampling.apply(value, locations, weights, level_shapes)
    return sample_torch(value, locations, weights, level_shapes)


_portable = False


class portable_export:
    """Within this context, exports use standard operators only."""

    def __enter__(self):
        global _portable
        _portable = True

    def __exit__(self, *_):
        global _portable
        _portable = False
