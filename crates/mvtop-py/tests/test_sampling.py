"""Deformable sampling as a function of arrays, and its gradients."""

import numpy as np
import pytest

import mvtop

LEVELS = [(4, 6), (2, 3)]


def test_sampling_is_a_weighted_sum_of_bilinear_reads(rng):
    value = rng.normal(size=(2, 30, 3, 5))
    locations = rng.uniform(-0.2, 1.2, size=(2, 7, 3, 2, 4, 2))
    weights = rng.uniform(size=(2, 7, 3, 2, 4))
    expected = np.zeros((2, 7, 3, 5))
    first = 0
    for level, (height, width) in enumerate(LEVELS):
        cells = value[:, first : first + height * width].reshape(2, height, width, 3, 5)
        first += height * width
        x = locations[:, :, :, level, :, 0] * width - 0.5
        y = locations[:, :, :, level, :, 1] * height - 0.5
        for b, q, h, k in np.ndindex(2, 7, 3, 4):
            for row in range(height):
                for column in range(width):
                    share = max(0, 1 - abs(x[b, q, h, k] - column))
                    share *= max(0, 1 - abs(y[b, q, h, k] - row))
                    weight = weights[b, q, h, level, k] * share
                    expected[b, q, h] += weight * cells[b, row, column, h]
    sampled = mvtop.deformable_sampling(value, locations, weights, LEVELS)
    np.testing.assert_allclose(sampled, expected.reshape(2, 7, 15), atol=1e-5)
    with pytest.raises(ValueError, match="value: expected"):
        mvtop.deformable_sampling(value[:, 1:], locations, weights, LEVELS)


def sampling_inputs(rng):
    """Value, locations and weights, float32; locations well between the centers of cells."""
    cells = rng.integers(-1, 3, size=(2, 7, 3, 2, 4, 2)) + rng.uniform(0.1, 0.9, (2, 7, 3, 2, 4, 2))
    sizes = np.array(LEVELS)[:, None, ::-1]  # width, height
    inputs = (
        rng.normal(size=(2, 30, 3, 5)),
        (cells + 0.5) / sizes,
        rng.uniform(size=(2, 7, 3, 2, 4)),
    )
    return [array.astype(np.float32) for array in inputs]


def test_sampling_writes_into_the_arrays_that_it_is_given(rng):
    inputs = sampling_inputs(rng)
    expected = mvtop.deformable_sampling(*inputs, LEVELS)
    out = np.full_like(expected, np.nan)
    for threads in (1, 3, 0):
        mvtop.set_num_threads(threads)
        out[:] = np.nan
        mvtop.deformable_sampling_forward(*inputs, LEVELS, out)
        np.testing.assert_array_equal(out, expected)


def test_gradients_of_sampling_are_slopes(rng):
    """The steepest of each input's, against a central difference."""
    inputs = sampling_inputs(rng)
    grad_out = rng.normal(size=(2, 7, 15)).astype(np.float32)
    grads = [np.full_like(array, np.nan) for array in inputs]
    mvtop.deformable_sampling_backward(*inputs, LEVELS, grad_out, *grads)
    for which, grad in enumerate(grads):
        index = np.unravel_index(np.abs(grad).argmax(), grad.shape)
        sums = []
        for step in (1e-3, -1e-3):
            moved = [array.copy() for array in inputs]
            moved[which][index] += step
            out = mvtop.deformable_sampling(*moved, LEVELS)
            sums.append((out.astype(float) * grad_out).sum())
        assert grad[index] == pytest.approx((sums[0] - sums[1]) / 2e-3, rel=0.01)


IN_PLACE = "expected a C-contiguous array of float32 with"


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda a: a.update(value=a["value"].astype(float)), f"value: {IN_PLACE} 4 axes, got fl"),
        (lambda a: a.update(value=a["value"].tolist()), f"value: {IN_PLACE} 4 axes, got <class"),
        (lambda a: a.update(locations=a["locations"][..., ::-1]), f"locations: {IN_PLACE} 6"),
        (lambda a: a.update(weights=a["weights"][..., 0]), f"weights: {IN_PLACE} 5 axes"),
        (lambda a: a.update(weights=a["weights"][:1].copy()), "weights: expected"),
        (lambda a: a.update(levels=[(4, 6)]), "value: expected"),
        (lambda a: a.update(levels=[(4, 0), (2, 3)]), "level: expected"),
        (lambda a: a.update(out=a["out"].reshape(2, 15, 7)), "out: expected shape [2, 7, 15], got"),
        (lambda a: a["out"].setflags(write=False), "out: "),
        (lambda a: a.update(out=a["value"].reshape(-1)[:210].reshape(2, 7, 15)), "out: "),
    ],
)
def test_sampling_in_place_refuses_what_it_would_have_to_copy(change, sentence, rng):
    names = ("value", "locations", "weights")
    arguments = dict(zip(names, sampling_inputs(rng), strict=True))
    arguments |= {"levels": LEVELS, "out": np.zeros((2, 7, 15), np.float32)}
    mvtop.deformable_sampling_forward(**arguments)
    change(arguments)
    with pytest.raises(ValueError) as refusal:
        mvtop.deformable_sampling_forward(**arguments)
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)
