"""Training resumes where it was killed, and learns."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pytest
import torch
from conftest import random_views

from mvtop_train import bop, data, generate, losses, objects
from mvtop_train.train import load_weights


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("mvball")
    objects.write(root, objects.ball(), objects.ball_mesh())
    gl = generate.open_gl()
    for index in range(6):
        order = ["green", "red"] * 2
        views = generate.scene_views(gl, 5, "train", index, order, (320, 320))
        bop.write_scene(root / "train" / f"{index:06d}", views, objects.ball())
    return root


def train(dataset, run, steps, lr=1e-3):
    command = [
        sys.executable, "-m", "mvtop_train.train", "--data", str(dataset), "--preset", "tiny",
        "--run", str(run), "--crop", "64", "--images", "16", "--workers", "0", "--log", "5",
        "--save", "5", "--validate", "1000", "--steps", str(steps), "--lr", str(lr),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]


def test_a_run_resumes_from_its_last_step(dataset, tmp_path):
    train(dataset, tmp_path / "run", 5)
    before = torch.load(tmp_path / "run" / "last.pt", weights_only=True)
    records = train(dataset, tmp_path / "run", 10)
    assert before["step"] == 5
    steps = [r["step"] for r in records if "loss" in r]
    assert steps == [5, 10]
    model, config, step = load_weights(tmp_path / "run" / "last.pt")
    assert step == 10 and config.preset == "tiny"


def test_the_loss_falls(dataset, tmp_path):
    records = train(dataset, tmp_path / "run", 120, lr=5e-3)  # within the warm-up of 300 steps
    losses = [r["loss"] for r in records if "loss" in r]
    assert losses[-1] < 0.8 * losses[0]


def test_no_data_is_one_clear_sentence(tmp_path):
    objects.write(tmp_path, objects.ball(), objects.ball_mesh())
    command = [sys.executable, "-m", "mvtop_train.train", "--data", str(tmp_path)]
    command += ["--run", str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode != 0
    assert "error: no scenes in" in result.stderr and "Traceback" not in result.stderr


def test_crops_without_the_object_show_nothing_of_it(dataset):
    rng = np.random.default_rng(0)
    aug = data.Augmentation(scale=0.8)
    for scene in data.load_index(dataset):
        for image in scene:
            a = data.negative_camera(image, (320, 320), 160, rng, aug)
            if a is None:
                continue
            code = cv2.imread(str(image.coords_path))
            shift = a.copy()
            shift[:, 2] += a[:, :2] @ image.visible_box[:2]
            assert code.any() and not cv2.warpAffine(code, shift, (160, 160)).any()
    boxed_in = bop.Image(None, None, None, None, None, np.array([5, 5, 315, 315]), None, "green")
    assert data.negative_camera(boxed_in, (320, 320), 160, rng, aug) is None


def test_crops_without_the_object_teach_the_detector_and_nothing_else(tiny):
    views = random_views(tiny.config, 2)
    with torch.no_grad():
        alone = tiny(views)
        views.negatives = views.images[0, :1].flip(-1)
        both = tiny(views)
    for a, b in zip(alone.poses[-1], both.poses[-1], strict=True):
        torch.testing.assert_close(a, b)
    assert len(both.scores) == 3
    pose = torch.eye(4).expand(1, 2, 4, 4)
    batch = {"cam_from_obj": pose, "boxes": views.boxes[:, :, 0]}
    batch["coords"] = torch.zeros(1, 2, *both.coordinates.shape[-2:], 3)
    quiet = losses.total(both, batch, 8)[1]
    both.scores[2] += 5
    loud = losses.total(both, batch, 8)[1]
    assert loud["detection"] > quiet["detection"] + 0.1
    assert loud["coordinates"] == quiet["coordinates"]
