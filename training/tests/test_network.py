"""What must not change a pose, and what the fusion of views is."""

import numpy as np
import pytest
import torch
from conftest import MVBALL, WHOLE, random_pose, random_views

from mvtop_train.errors import UserError
from mvtop_train.network import config
from mvtop_train.network.features import BACKBONES
from mvtop_train.network.geometries import GEOMETRIES
from mvtop_train.network.paper import ImageAttention


def last_pose(model, views):
    with torch.no_grad():
        return torch.cat(model(views).poses[-1], -1)


@pytest.mark.parametrize("views", [1, 2, 3, 4])
def test_shapes_for_any_number_of_views(tiny, views):
    prediction = tiny(random_views(tiny.config, views))
    assert len(prediction.poses) == tiny.config.decoder_layers
    assert [x.shape for x in prediction.poses[-1]] == [(1, 1, 6), (1, 1, 3), (1, 1, 2)]
    assert prediction.found.scores.shape == (views, 1, 16, 20)


def test_the_world_frame_does_not_matter(tiny):
    world = random_pose(np.random.default_rng(5), (3.0, -2.0, 1.0))
    a = last_pose(tiny, random_views(tiny.config, 3))
    b = last_pose(tiny, random_views(tiny.config, 3, world=world))
    torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4)


def test_the_order_of_the_other_views_does_not_matter(tiny):
    views = random_views(tiny.config, 4)
    expected = last_pose(tiny, views)
    order = torch.tensor([0, 3, 1, 2])
    views.shown.images = views.shown.images[:, order]
    for name in ("k", "ref_from_cam", "boxes", "valid", "inside"):
        setattr(views, name, getattr(views, name)[:, order])
    torch.testing.assert_close(last_pose(tiny, views), expected, atol=1e-5, rtol=1e-4)


def test_a_masked_view_changes_nothing(tiny):
    expected = last_pose(tiny, random_views(tiny.config, 2))
    views = random_views(tiny.config, 3)
    views.valid[:, 2] = 0
    torch.testing.assert_close(last_pose(tiny, views), expected, atol=1e-5, rtol=1e-4)


def test_every_other_view_matters(tiny):
    two = last_pose(tiny, random_views(tiny.config, 2))
    three = last_pose(tiny, random_views(tiny.config, 3))
    assert (two - three).abs().max() > 1e-4


def test_a_masked_query_changes_no_other(tiny):
    one = random_views(tiny.config, 2)
    expected = last_pose(tiny, one)
    one.boxes = one.boxes.repeat(1, 1, 2, 1) + torch.tensor([[0.0], [7.0]])
    one.valid = torch.tensor([1.0, 0.0]).repeat(1, 2, 1)
    one.class_index = one.class_index.repeat(1, 2)
    torch.testing.assert_close(last_pose(tiny, one)[:, :1], expected, atol=1e-5, rtol=1e-4)


def test_two_views_fuse_as_in_the_paper():
    """Concat(f_1, f_2) W^p with W^p = [W_reference; W_others]."""
    torch.manual_seed(0)
    attention = ImageAttention(config.preset("tiny", MVBALL, geometry="image", **WHOLE))
    d = 32
    gathered = torch.randn(1, 2, 3, 4, d // 4)
    fused = attention.fuse(gathered, torch.randn(1, 2, 3, 4), torch.ones(1, 2, 3))
    weight = torch.cat([attention.reference.weight, attention.others.weight], 1)
    concatenated = torch.cat([gathered[:, 0].flatten(-2), gathered[:, 1].flatten(-2)], -1)
    expected = concatenated @ weight.T + attention.reference.bias
    torch.testing.assert_close(fused, expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("geometry", ["image", "rays"])
@pytest.mark.parametrize("encoding", ["direction", "origin_direction", "plucker", "plucker_origin"])
def test_every_variant_builds_and_gives_finite_poses(geometry, encoding):
    from mvtop_train.network.model import Mvtop

    torch.manual_seed(0)
    model = Mvtop(
        config.preset("tiny", MVBALL, geometry=geometry, los_encoding=encoding, **WHOLE)
    ).eval()
    assert torch.isfinite(last_pose(model, random_views(model.config, 2))).all()


def test_what_a_config_may_name_is_there():
    assert {*config.BACKBONES} == {*BACKBONES, "lite"}
    assert {*config.GEOMETRIES} == {*GEOMETRIES}


@pytest.mark.parametrize("key", ["backbone", "geometry", "los_encoding"])
def test_what_a_config_may_not_name_is_one_sentence(key):
    with pytest.raises(UserError, match=f"network: {key}: expected one of .*, got 'imag'; fix: "):
        config.preset("tiny", MVBALL, **{key: "imag"})


def test_the_uncertainty_head_sends_no_gradient_into_the_network(tiny):
    prediction = tiny(random_views(tiny.config, 2))
    sigma = prediction.poses[-1][2]
    parameters = dict(tiny.named_parameters())
    shared = [p for n, p in parameters.items() if "uncertainty" not in n]
    grads = torch.autograd.grad(sigma.sum(), shared, allow_unused=True)
    assert all(g is None for g in grads)
