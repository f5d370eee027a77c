"""Of poses that look alike the nearest to a prediction is taken: by hand, and by trying all."""

import numpy as np
import pytest
import torch

from mvtop_train.network import losses, symmetry
from mvtop_train.network.config import ObjectClass


def turn(axis, angle, point=(0.0, 0.0, 0.0)):
    axis = np.array(axis) / np.linalg.norm(axis)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    pose[:3, 3] = point - pose[:3, :3] @ point
    return pose


def known(discrete=(), continuous=()):
    rows = tuple(tuple(pose.ravel().tolist()) for pose in discrete)
    return symmetry.of((ObjectClass(1, "part", 0.1, rows, tuple(continuous)),))


def nearest(prediction, truth, symmetries):
    prediction, truth = (torch.tensor(pose, dtype=torch.float32) for pose in (prediction, truth))
    index = torch.zeros((), dtype=torch.long)
    found = symmetry.nearest(prediction[:3, :3], prediction[:3, 3], truth, index, symmetries)
    return truth.numpy() @ found.numpy()


def random_pose(rng):
    pose = turn(rng.normal(size=3), rng.uniform(0, np.pi))
    pose[:3, 3] = rng.normal(0, 0.3, 3)
    return pose


def test_a_part_without_symmetries_keeps_its_pose():
    rng = np.random.default_rng(0)
    truth = random_pose(rng)
    np.testing.assert_allclose(nearest(random_pose(rng), truth, known()), truth, atol=1e-6)


@pytest.mark.parametrize("number", range(5))
def test_of_a_nut_the_nearest_sixth_is_taken(number):
    rng = np.random.default_rng(number)
    sixths = [turn([0, 0, 1], np.pi / 3 * n) for n in range(1, 6)]
    truth = random_pose(rng)
    wanted = truth @ sixths[number]
    slightly_off = wanted @ turn(rng.normal(size=3), np.deg2rad(12))
    np.testing.assert_allclose(nearest(slightly_off, truth, known(sixths)), wanted, atol=1e-6)


@pytest.mark.parametrize("number", range(8))
def test_about_an_axis_no_turn_is_nearer(number):
    """The best angle of the closed form against 3600 of them, with the axis off the origin."""
    rng = np.random.default_rng(number)
    axis, point = rng.normal(size=3), np.array([0.02, -0.01, 0.03])
    flip = [turn(np.cross(axis, [1, 0, 0]), np.pi, point)] if number % 2 else []
    truth, prediction = random_pose(rng), random_pose(rng)
    found = nearest(prediction, truth, known(flip, [(*axis, *point)]))

    def away(pose):
        return np.linalg.norm(pose[:3, :3] - prediction[:3, :3])

    angles = np.linspace(0, 2 * np.pi, 3600)
    tried = [truth @ f @ turn(axis, a, point) for f in [np.eye(4), *flip] for a in angles]
    least = min(map(away, tried))
    if not flip:  # with two branches translation has a say in which is taken
        assert away(found) == pytest.approx(least, abs=1e-3)
    assert min(np.abs(pose - found).max() for pose in tried) < 2e-3  # it is one of them
    # A symmetry leaves the axis where it was.
    np.testing.assert_allclose((found @ [*point, 1])[:3], (truth @ [*point, 1])[:3], atol=1e-6)


def test_rotation_and_translation_are_of_one_symmetry():
    """A half turn about an axis off the origin: what fits by rotation alone is 40 mm away."""
    half = turn([0, 0, 1], np.pi, (0.02, 0, 0))
    truth = np.eye(4)
    prediction = turn([0, 0, 1], np.deg2rad(91))
    prediction[:3, 3] = truth[:3, 3]  # rotation says half turn, by a degree; translation says none
    np.testing.assert_allclose(nearest(prediction, truth, known([half])), truth, atol=1e-6)


def test_poses_a_half_turn_beside_the_origin_apart_stand_upright_as_one():
    half = turn([0, 0, 1], np.pi, (0.04, 0, 0))
    truth = np.linalg.inv(turn([0, 0, 1], 3.0, (0.02, 0.5, 0)))
    poses = torch.tensor(np.stack([truth, truth @ half])[None], dtype=torch.float32)
    turns = losses.upright(poses, torch.zeros(1, 1, dtype=torch.long), known([half]))
    one, other = (poses @ turns)[0].numpy()
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert one[0, 0] > 0
