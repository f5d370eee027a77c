"""The kernel against its definition in standard operators."""

import pytest
import torch

from mvtop_train.network import sampling

needs_kernel = pytest.mark.usefixtures("kernel")


@pytest.fixture
def kernel():
    assert sampling.kernel_available(), "fix: make wheel"


def hand_case(x, y):
    """Value 10 row + column + 1 on a 2 x 3 map, one sample at (x, y)."""
    value = torch.tensor([[1.0, 2, 3], [11, 12, 13]]).reshape(1, 6, 1, 1)
    location = torch.tensor([x, y]).reshape(1, 1, 1, 1, 1, 2)
    return value, location, torch.ones(1, 1, 1, 1, 1), [(2, 3)]


CASES = [
    (0.5, 0.5, 7.0), (0.0, 0.0, 0.25), (1.0, 1.0, 3.25), (0.25, 0.75, 11.25), (-0.1, 0.5, 1.2),
    (-0.2, 0.5, 0.0),
]  # fmt: skip


@pytest.mark.parametrize("x, y, expected", CASES)
def test_hand_worked_samples_in_torch(x, y, expected):
    assert sampling.sample_torch(*hand_case(x, y)).item() == pytest.approx(expected, abs=1e-5)


@needs_kernel
@pytest.mark.parametrize("x, y, expected", CASES)
def test_hand_worked_samples_in_the_kernel(x, y, expected):
    assert sampling.deformable_sampling(*hand_case(x, y)).item() == pytest.approx(
        expected, abs=1e-5
    )


@needs_kernel
@pytest.mark.parametrize("head_dim", [3, 8, 16, 32])
def test_kernel_and_torch_agree_forward_and_backward(head_dim):
    torch.manual_seed(0)
    shapes = [(7, 5), (4, 3)]
    n = sum(r * c for r, c in shapes)
    inputs = [
        torch.randn(2, n, 3, head_dim),
        torch.rand(2, 11, 3, 2, 4, 2) * 1.4 - 0.2,
        torch.rand(2, 11, 3, 2, 4),
    ]
    grad = torch.randn(2, 11, 3 * head_dim)
    results = []
    for function in (sampling.deformable_sampling, sampling.sample_torch):
        leaves = [x.clone().requires_grad_() for x in inputs]
        out = function(*leaves, shapes)
        results.append((out.detach(), *torch.autograd.grad(out, leaves, grad)))
    for ours, theirs in zip(*results, strict=True):
        torch.testing.assert_close(ours, theirs, atol=2e-4, rtol=1e-4)
