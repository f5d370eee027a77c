"""Close-ups are exact cameras, and are exported with the rest."""

import itertools
import json

import numpy as np
import onnxruntime
import pytest
import torch
from test_export import decoder_inputs, run

from mvtop_train.data import bop, closeup
from mvtop_train.data.views import warp
from mvtop_train.export import bundle, self_test

K = np.array([[610.0, 0, 322], [0, 590, 236], [0, 0, 1]])


@pytest.mark.parametrize("seed", range(20))
def test_a_closeup_is_the_camera_turned_towards_the_box(seed):
    rng = np.random.default_rng(seed)
    middle, extent = rng.uniform([40, 40], [600, 440]), rng.uniform(10, 80, 2)
    box = np.concatenate([middle - extent / 2, middle + extent / 2])
    close = closeup.camera_of(K, box, 96)
    turn = close.view_from_cam
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    ray = np.linalg.inv(K) @ [*middle, 1]
    np.testing.assert_allclose(turn @ ray / np.linalg.norm(ray), [0, 0, 1], atol=1e-12)
    # No turn that takes the ray to the axis is smaller.
    angle = np.arccos((np.trace(turn) - 1) / 2)
    assert angle == pytest.approx(np.arccos(ray[2] / np.linalg.norm(ray)), abs=1e-9)
    reach = np.abs(close.box - 47.5).max()
    assert reach == pytest.approx(closeup.FILL * 48)


def test_a_point_is_where_both_cameras_see_it():
    """A bright dot of the image is found where the virtual camera projects its ray."""
    image = np.zeros((480, 640, 3), np.uint8)
    image[200:203, 150:153] = 255
    close = closeup.camera_of(K, np.array([130.0, 170, 190, 220]), 96)
    picture, on_image = warp(image, close.view_from_image(K), (96, 96), close.taps)
    v, u = np.meshgrid(np.arange(96), np.arange(96), indexing="ij")
    weight = picture[..., 0].astype(float)
    found = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    expected = close.k @ close.view_from_cam @ np.linalg.inv(K) @ [151, 201, 1]
    np.testing.assert_allclose(found, expected[:2] / expected[2], atol=0.05)
    assert on_image.all()


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_closeups_are_of_what_the_image_shows(turn):
    """A cube half off the image is shown by what is seen, whichever way up the camera is."""
    cube = np.array(list(itertools.product([-0.1, 0.1], repeat=3)))
    pose = np.eye(4)
    pose[:3, 3] = (-322.5 / 610, 0.0, 1.0)
    image = bop.Image(0, None, K, np.eye(4), [bop.Instance(1, pose, None)])
    rolled = closeup.roll_by(np.radians(turn))
    box = closeup.cut_box(cube, image, (480, 640, 3), rolled)
    whole = (cube + pose[:3, 3]) @ K.T
    right, top = whole[:, 0] / whole[:, 2], whole[:, 1] / whole[:, 2]
    corners = [[x, y, 1] for x in (-0.5, right.max()) for y in (top.min(), top.max())]
    turned = corners @ np.linalg.inv(K).T @ rolled.T @ K.T
    expected = [*turned[:, :2].min(0), *turned[:, :2].max(0)]
    np.testing.assert_allclose(box, expected, atol=1e-9)
    pose[0, 3] -= 1.0  # wholly beside it
    beside = closeup.cut_box(cube, image, (480, 640, 3), np.eye(3))
    assert np.ptp(beside.reshape(2, 2), axis=0).min() > 50


def test_boxes_are_jittered_without_bias():
    rng, box = np.random.default_rng(0), np.array([100.0, 50, 180, 150])
    boxes = np.stack([closeup.jittered(box, rng, 1.0) for _ in range(4000)])
    np.testing.assert_allclose(boxes.mean(0), box, atol=0.5)
    assert closeup.jittered(box, rng, 0.0) == pytest.approx(box)


@pytest.mark.parametrize("bits", [32, 16, 8])
def test_exported_closeups_match_torch(closeups, tmp_path, bits):
    bundle.write_bundle(closeups, tmp_path, {}, portable=True, bits=bits)
    manifest = json.loads((tmp_path / "model.json").read_text())
    assert manifest["closeup"] == {"size": 64, "strides": [16, 32]}
    assert set(manifest["graphs"]) == {"features", "closeup", "decoder"}
    c, n, torch_seed = closeups.config, 4 * 4 + 2 * 2, 5
    torch.manual_seed(torch_seed)
    rays = torch.nn.functional.normalize(torch.randn(3, n, 3), dim=-1)
    given = {
        "features": (bundle.ExportedDetector, {"images": torch.randn(3, 3, c.height, c.width)}),
        "closeup": (
            bundle.ExportedCloseUps, {"images": torch.randn(3, 3, 64, 64), "camera_rays": rays}
        ),
    }  # fmt: skip
    decoder = decoder_inputs(c, 3, 1)
    decoder["memory"], decoder["rays"] = torch.randn(3, n, 32), torch.randn(3, n, c.los_channels)
    given["decoder"] = (bundle.ExportedDecoder, decoder)
    tolerance = {32: 1e-4, 16: 2e-2, 8: 5e-2}[bits]
    for name, (module, inputs) in given.items():
        session = onnxruntime.InferenceSession(tmp_path / f"{name}.onnx")
        with torch.no_grad():
            expected = module(closeups)(*inputs.values())
        expected = (expected,) if torch.is_tensor(expected) else expected
        for ours, theirs in zip(run(session, inputs), expected, strict=True):
            scale = theirs.abs().max().item()
            assert np.abs(ours - theirs.numpy()).max() < tolerance * scale, name


def test_the_self_test_is_of_the_weights_that_are_stored(closeups, tmp_path):
    bundle.write_bundle(closeups, tmp_path, {}, portable=True, bits=8)
    told = json.loads((tmp_path / "model.json").read_text())["self_test"]["outputs"]
    exact = self_test.outputs(self_test.OfModel(bundle.fold_batch_norm(closeups)))
    shape = 1, 3, closeups.config.height, closeups.config.width
    session = onnxruntime.InferenceSession(tmp_path / "features.onnx")
    _, boxes = run(session, {"images": self_test.numbers(*shape)})
    answer = boxes.mean((0, 2, 3))
    off, off_exact = (np.abs(answer - x["det_boxes"]).max() for x in (told, exact))
    assert off < 1e-3 and off < 0.1 * off_exact


def test_fewer_bits_make_smaller_files(closeups, tmp_path):
    sizes = []
    for bits in (32, 16, 8):
        bundle.write_bundle(closeups, tmp_path / str(bits), {}, portable=True, bits=bits)
        sizes.append((tmp_path / str(bits) / "features.onnx").stat().st_size)
    whole, half, quarter = sizes
    assert half < 0.75 * whole and quarter < 0.8 * half
