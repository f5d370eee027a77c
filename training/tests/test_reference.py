"""The Rust pipeline's reference: against the training's close-ups, and on the shipped model."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import mvtop
import numpy as np
import pytest
import torch

from mvtop_train.data import closeup, objects
from mvtop_train.data.views import warp
from mvtop_train.export import bundle, optics, reference
from mvtop_train.network import config as configs
from mvtop_train.network.model import Mvtop

ROOT = Path(__file__).parents[2]
K = np.array([[610.0, 0, 322], [0, 590, 236], [0, 0, 1]])


@pytest.mark.parametrize("seed", range(10))
def test_the_training_s_closeups_are_the_reference_s(seed):
    rng = np.random.default_rng(seed)
    middle, extent = rng.uniform([40, 40], [600, 440]), rng.uniform(10, 200, 2)
    box = np.concatenate([middle - extent / 2, middle + extent / 2])
    v, u = np.meshgrid(np.arange(480), np.arange(640), indexing="ij")
    rgb = np.stack([u % 256, v % 256, 127 + 100 * np.sin(u / 17 + v / 15)], -1).astype(np.uint8)
    rgb[:, :, :2] = np.minimum(rgb[:, :, :2], 255 - rgb[:, :, :2])  # without steps
    close = closeup.camera_of(K, box, 96)
    picture, on_image = warp(rgb, close.view_from_image(K), (96, 96), close.taps)

    real = optics.Camera("real", 640, 480, K, np.eye(4))
    virtual, bounds, step = optics.closeup_of(real, box, 96)
    assert np.ceil(step) == close.taps
    np.testing.assert_allclose(close.k, virtual.k, rtol=1e-10)
    np.testing.assert_allclose(close.box, bounds, atol=1e-9)
    np.testing.assert_allclose(close.view_from_cam, virtual.world_from_cam[:3, :3].T, atol=1e-12)
    expected, shown = optics.picture_of(virtual, real, rgb, step)
    np.testing.assert_array_equal(on_image, shown)
    # OpenCV's bilinear weights are multiples of 1/32, and it rounds.
    np.testing.assert_allclose(picture[shown], expected[shown], atol=3)


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_lenses_end_where_those_of_rust_do(model):
    params = (-0.006, 0.016, -0.024, 0.0155)
    size, fisheye = (640, 480), model == "fisheye"
    reference = optics.Camera("real", *size, K, np.eye(4), params, fisheye, max_angle_deg=25.5)
    camera = mvtop.Camera(K, size, distortion=params, model=model, max_angle_deg=25.5)
    rng = np.random.default_rng(2)
    points = rng.normal(size=(200, 3)) * [0.5, 0.5, 0.1] + [0, 0, 1]
    pixels = rng.uniform([0, 0], size, (200, 2))
    for given, there, back in (
        (points, reference.project, camera.project),
        (pixels, reference.unproject, camera.unproject),
    ):
        assert 20 < np.isnan(there(given)).any(-1).sum() < 180
        np.testing.assert_allclose(back(given), there(given), atol=1e-6)


def test_the_chordal_mean_by_hand():
    def turned(degrees):
        cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        pose = np.eye(4)
        pose[:2, :2] = [[cos, -sin], [sin, cos]]
        pose[:3, 3] = degrees
        return pose

    mean = reference.mean_pose([turned(20), turned(50), turned(80)])
    np.testing.assert_allclose(mean, turned(50), atol=1e-12)


def test_the_pipeline_poses_the_shipped_example_as_pytorch_does(tmp_path):
    torch.manual_seed(0)
    known = objects.classes_of(objects.ball())
    shipped = dataclasses.replace(configs.preset("small", known), hypotheses=6)
    model = Mvtop(shipped).eval()  # untrained
    folder = ROOT / "examples/mvball"
    cameras, images, boxes, _ = reference.load_sample(folder)
    expected = reference.predict(bundle.fold_batch_norm(model), cameras, images, boxes)
    bundle.write_bundle(model, tmp_path, {})
    command = [
        Path(sys.executable).with_name("mvtop-cli"), "infer", "--rig", folder / "rig.json",
        *(folder / f"{camera.id}.png" for camera in cameras),
        "--boxes", folder / "truth.json", "--model", tmp_path, "--json", "--no-refine",
        "--set", "search.schedule=[]",
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    (found,) = json.loads(result.stdout)["objects"]
    # Of several hypotheses the images choose.
    poses = [np.array(one["T_world_obj"]) for one in found["hypotheses"]]
    away = [np.abs(pose - expected["world_from_obj"]).max() for pose in poses]
    pose, nearest = poses[np.argmin(away)], found["hypotheses"][np.argmin(away)]
    chord = np.linalg.norm(pose[:3, :3] - expected["world_from_obj"][:3, :3])
    assert 2 * np.degrees(np.arcsin(chord / np.sqrt(8))) < 1e-3
    np.testing.assert_allclose(pose[:3, 3], expected["world_from_obj"][:3, 3], atol=1e-6)
    sigma = [nearest["sigma"]["rot_deg"], nearest["sigma"]["t_m"]]
    np.testing.assert_allclose(sigma, expected["sigma"], rtol=1e-4)
