"""Lines of sight, rotations and losses: hand-worked cases and the places where they break."""

import pytest
import torch
from conftest import MVBALL

from mvtop_train.network import losses, pose, rays
from mvtop_train.network.config import LOS_CHANNELS

K = torch.tensor([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])


def test_first_cell_of_a_stride_16_map_looks_from_its_center():
    pixel = rays.cell_centers([(30, 40)], [16])[0]
    assert pixel.tolist() == [7.5, 7.5]
    d = rays.unproject(K, pixel[None])[0]
    assert d.tolist() == pytest.approx([-0.436855, -0.325020, 0.838761], abs=1e-5)


def test_cells_of_a_level_share_the_whole_input():
    centers = rays.cell_centers([(30, 40), (8, 10)], [16, 64])
    assert centers[1200].tolist() == [31.5, 29.5]  # 64 x 60 px cells
    assert centers[-1].tolist() == [640 - 32.5, 480 - 30.5]


def test_encodings_of_a_camera_behind_the_object():
    ref_from_cam = torch.diag(torch.tensor([-1.0, 1, -1, 1]))
    ref_from_cam[:3, 3] = torch.tensor([0.0, 0, 2])
    d = rays.unproject(K, torch.tensor([[7.5, 7.5]]))
    line = rays.encode(d, ref_from_cam, "plucker_origin")[0].tolist()
    assert line[:3] == pytest.approx([0.436855, -0.325020, -0.838761], abs=1e-5)
    assert line[3:6] == pytest.approx([-0.650040, -0.873709, 0], abs=1e-5)
    assert line[6:] == [0, 0, 2]


@pytest.mark.parametrize("encoding", LOS_CHANNELS)
def test_a_cell_without_a_ray_is_zero_in_every_encoding(encoding):
    camera_rays = torch.tensor([[0.0, 0, 1], [0, 0, 0]])
    ref_from_cam = torch.eye(4)
    ref_from_cam[:3, 3] = 1.0
    line = rays.encode(camera_rays, ref_from_cam, encoding)
    assert line.shape == (2, LOS_CHANNELS[encoding])
    assert (line[0] != 0).any() and (line[1] == 0).all()


def test_rotation_from_6d_by_hand():
    r = pose.rotation_from_6d(torch.tensor([1.0, 2, 2, 0, 3, 4]))
    assert r[:, 0].tolist() == pytest.approx([1 / 3, 2 / 3, 2 / 3], abs=1e-6)
    assert r[:, 1].tolist() == pytest.approx([-0.866578, -0.061898, 0.495188], abs=1e-5)
    assert r[:, 2].tolist() == pytest.approx([0.371391, -0.742781, 0.557086], abs=1e-5)


@pytest.mark.parametrize("degrees", [0.0, 0.05, 90.0, 179.95, 180.0])
def test_rotation_loss_and_its_gradient_are_finite(degrees):
    angle = torch.deg2rad(torch.tensor(degrees))
    zero, one = torch.zeros(()), torch.ones(())
    c, s = angle.cos(), angle.sin()
    r = torch.stack([c, -s, zero, s, c, zero, zero, zero, one]).reshape(3, 3).requires_grad_()
    loss = pose.rotation_angle(r, torch.eye(3))
    loss.backward()
    assert torch.rad2deg(loss).item() == pytest.approx(degrees, abs=0.02)
    assert torch.isfinite(r.grad).all()


def test_uncertainty_loss_is_lowest_at_the_expected_errors():
    rot = torch.tensor([2.0, 10.0, 30.0])
    t = torch.tensor([0.01, 0.02, 0.03])

    def loss(rot_sigma, t_sigma):
        sigma = torch.tensor([rot_sigma, t_sigma]).expand(3, 2)
        return losses.uncertainty_loss(sigma, rot, t).mean().item()

    best = loss(rot.mean().item(), (t.square().mean() / 3).sqrt().item())
    for factor in (0.8, 1.25):
        assert loss(14 * factor, 0.0125) > best
        assert loss(14, (t.square().mean() / 3).sqrt().item() * factor) > best


def test_uncertainty_does_not_touch_the_pose():
    sigma = torch.ones(1, 2, requires_grad=True)
    error = torch.ones(1, requires_grad=True)
    losses.uncertainty_loss(sigma, error, error).sum().backward()
    assert sigma.grad is not None and error.grad is None


def giou(a, b):
    """Rezatofighi et al. 2019, as written there: IoU - (hull - union) / hull of boxes [..., 4]."""
    overlap = torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])
    inter = overlap.clamp_min(0).prod(-1)
    union = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1) - inter
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    return inter / union - (hull.prod(-1) - union) / hull.prod(-1)


def test_boxes_are_learnt_by_giou_on_the_cells_near_the_center():
    """Weighted by the center map there; a view without the object adds nothing."""
    torch.manual_seed(0)
    stride, cells = 8, 10
    truth = torch.tensor([[10.0, 7, 50, 48], [0, 0, 0, 0], [30, 5, 71, 60]])
    low = torch.rand(3, 2, cells, cells) * 60
    boxes = torch.cat([low, low + 2 + torch.rand(3, 2, cells, cells) * 60], 1).requires_grad_()
    logits, index = torch.randn(3, 1, cells, cells), torch.zeros(3, dtype=torch.long)

    def loss(boxes):
        return losses.detection_loss(logits, boxes, truth[:, None], index[:, None], stride)

    pixel = (torch.arange(cells) + 0.5) * stride - 0.5
    expected, weights = torch.zeros(()), torch.zeros(())
    for view in (0, 2):
        (x0, y0, x1, y1), box = truth[view], boxes[view].permute(1, 2, 0)
        u, v = (pixel - (x0 + x1) / 2) * 8 / (x1 - x0), (pixel - (y0 + y1) / 2) * 8 / (y1 - y0)
        heat = torch.exp(-(u[None] ** 2 + v[:, None] ** 2) / 2)
        heat = torch.where(heat == heat.max(), 1.0, heat)
        heat = heat * (heat > 0.3)
        expected = expected + 2 * (heat * (1 - giou(box, truth[view]))).sum()
        weights = weights + heat.sum()
    expected = expected / weights
    exact = truth[:, :, None, None].expand_as(boxes)
    got = loss(boxes) - loss(exact)  # what is left is of the scores
    torch.testing.assert_close(got, expected, rtol=1e-5, atol=1e-5)
    grads = [torch.autograd.grad(x, boxes)[0] for x in (got, expected)]
    torch.testing.assert_close(*grads, rtol=1e-5, atol=1e-7)


def test_boxes_alone_put_a_sphere_where_it_is():
    """One view by the box's size, two views by triangulation; the correction is zero."""
    from mvtop_train.network import config
    from mvtop_train.network.decoder import Boxes
    from mvtop_train.network.heads import PoseHeads

    heads = PoseHeads(config.preset("tiny", MVBALL))
    radius = heads.radii[0].item()
    center = torch.tensor([0.1, -0.05, 0.8])
    side = torch.tensor([[0.0, 0, -1, 0.8], [0, 1, 0, 0], [1, 0, 0, 0.8], [0, 0, 0, 1]])
    poses = torch.stack([torch.eye(4), side])  # the second camera looks along the first's -x
    k = K.expand(2, 3, 3)
    boxes = []
    for pose_ in poses:
        in_cam = pose_[:3, :3].T @ (center - pose_[:3, 3])
        u, v = (K @ in_cam)[:2] / in_cam[2]
        half = 600 * radius / in_cam.norm()
        boxes.append(torch.stack([u - half, v - half, u + half, v + half]))
    lines = rays.box_rays(k, torch.stack(boxes)[:, None], poses)[None]
    index = torch.zeros(1, 1, dtype=torch.long)
    for valid, tolerance in (([1.0, 0.0], 0.02), ([1.0, 1.0], 0.003)):
        given = Boxes(None, None, lines, torch.tensor(valid)[None, :, None])
        t = heads._placed(torch.zeros(1, 1, 3), index, given)[0, 0]
        assert (t - center).norm() < tolerance


def test_solve3_solves():
    from mvtop_train.network.heads import solve3

    torch.manual_seed(0)
    m = torch.randn(5, 3, 3, dtype=torch.float64)
    a = m @ m.mT + 0.1 * torch.eye(3)
    b = torch.randn(5, 3, dtype=torch.float64)
    torch.testing.assert_close((a @ solve3(a, b)[..., None])[..., 0], b)
