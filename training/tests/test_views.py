"""Every virtual camera is exact: what a view shows lies where its k and pose put it."""

import cv2
import numpy as np
import pytest
import torch
from conftest import MVBALL, random_pose

from mvtop_train.data import bop, objects, views
from mvtop_train.data.boxes import amodal_boxes
from mvtop_train.data.closeup import CloseUps
from mvtop_train.data.crops import Augmentation, Crops
from mvtop_train.data.inputs import to_views
from mvtop_train.network import config
from mvtop_train.network.rays import cell_centers
from mvtop_train.study.canonical import Canonical

HEIGHT, WIDTH = 480, 640
K = np.array([[560.0, 0, 331], [0, 610, 228], [0, 0, 1]])  # fx unlike fy
BALL = objects.ball()
BOUNDS = BALL.bounds
NETWORK = config.preset("tiny", MVBALL, closeup=96, closeup_strides=(16, 32))
CHOICES = {
    "crop": Crops(160, Augmentation(scale=0.8)),
    "close-up": CloseUps(96),
    "reduced close-up": CloseUps(32),  # several samples a pixel
    "canonical": Canonical(),
}


def project(k, cam_from_obj, points):
    """Pixels [n, 2] of points [n, 3]."""
    pixels = (points @ cam_from_obj[:3, :3].T + cam_from_obj[:3, 3]) @ k.T
    return pixels[:, :2] / pixels[:, 2:]


def image_of(folder, rng, corner=False):
    """An image of black with one bright spot, at a point of the object; and the point [1, 3]."""
    place = [-0.42, -0.3, 0.9] if corner else [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.6, 0.9)]
    cam_from_obj = random_pose(rng, place)
    point = rng.uniform(-0.02, 0.02, (1, 3))
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    spot = project(K, cam_from_obj, point)[0]
    rgb = 250 * np.exp(-((u - spot[0]) ** 2 + (v - spot[1]) ** 2) / (2 * 3.0**2))
    path = folder / "image.png"
    cv2.imwrite(str(path), np.repeat(rgb.round().astype(np.uint8)[..., None], 3, 2))
    box = amodal_boxes(BOUNDS, K, cam_from_obj).clip(-0.5, [WIDTH - 0.5, HEIGHT - 0.5] * 2)
    return bop.Image(0, path, K, np.eye(4), [bop.Instance(1, cam_from_obj, box)]), point


@pytest.fixture
def plain(monkeypatch):
    """Colors as they are, to find the spot by."""
    monkeypatch.setattr(views, "photometric", lambda rgb, rng: rgb)


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("seed", range(6))
def test_a_point_is_shown_where_the_view_says(tmp_path, plain, name, augment, seed):
    rng = np.random.default_rng(seed)
    image, point = image_of(tmp_path, rng)
    view = views.ViewMaker(CHOICES[name], NETWORK, (BALL,), augment).make_view(image, rng)
    weight = view["image"][..., 0].astype(float)
    v, u = np.mgrid[: len(weight), : len(weight)]
    found = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    expected = project(view["k"], view["cam_from_obj"], point)[0]
    np.testing.assert_allclose(found, expected, atol=0.1)
    # The camera is where it was, and the box is the object's extent in it.
    np.testing.assert_allclose(view["cam_from_world"][:3, 3], 0, atol=1e-12)
    np.testing.assert_allclose(view["cam_from_world"] @ image.cam_from_obj, view["cam_from_obj"])
    extent = project(view["k"], view["cam_from_obj"], BOUNDS)
    end = len(weight) - 0.5
    np.testing.assert_allclose(view["true_box"][:2], extent.min(0).clip(-0.5, end))
    np.testing.assert_allclose(view["true_box"][2:], extent.max(0).clip(-0.5, end))
    size = np.ptp(extent, axis=0)
    assert (np.abs(view["box"] - view["true_box"]) < 0.4 * np.tile(size, 2)).all()


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("seed", range(4))
def test_what_lies_off_the_image_is_known_and_shown_as_zero(tmp_path, name, seed):
    """Pixels and cells are traced back through the turned camera, one by one."""
    rng = np.random.default_rng(seed)
    image, _ = image_of(tmp_path, rng, corner=True)
    view = views.ViewMaker(CHOICES[name], NETWORK, (BALL,)).make_view(image, rng)
    size = len(view["image"])
    cells = cell_centers(NETWORK.level_shapes(size, size), NETWORK.pose_strides).numpy()
    pixels = np.mgrid[:size, :size][::-1].reshape(2, -1).T
    off = 0
    for points, given in ((cells, view["inside"]), (pixels, view["on_image"].ravel())):
        rays = np.concatenate([points, np.ones((len(points), 1))], 1) @ np.linalg.inv(view["k"]).T
        source = project(K, np.linalg.inv(view["cam_from_world"]), rays)
        expected = ((source >= -0.5) & (source <= [WIDTH - 0.5, HEIGHT - 0.5])).all(1)
        np.testing.assert_array_equal(given, expected)
        off += (~expected).sum()
    assert off > 0 and view["on_image"].any()
    batch = views.collate([[view]])
    shown = to_views(batch, NETWORK).shown.images[0, 0]
    assert (shown[:, ~torch.from_numpy(view["on_image"])] == 0).all()
    assert shown[:, torch.from_numpy(view["on_image"])].any()
