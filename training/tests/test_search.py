"""Whole images for the detector: boxes lie where the objects are shown, and what they teach."""

import cv2
import numpy as np
import pytest
import torch
from conftest import random_pose

from mvtop_train.data import bop, objects, search
from mvtop_train.data.boxes import amodal_boxes
from mvtop_train.network import config, losses
from mvtop_train.training import thresholds

BALL = objects.ball()
NETWORK = config.preset("lite", objects.classes_of(BALL))
K = np.array([[560.0, 0, 331], [0, 560, 228], [0, 0, 1]])


@pytest.fixture
def image(tmp_path, monkeypatch):
    """Black, with a bright spot at the middle of each of three balls; one of them mostly hidden."""
    monkeypatch.setattr(search, "photometric", lambda rgb, rng: rgb)
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    rgb, instances = np.zeros((480, 640)), []
    for n, (place, share) in enumerate(
        [([-0.2, -0.1, 0.9], 1.0), ([0.15, 0.1, 0.8], 0.6), ([0.0, -0.15, 1.0], 0.2)]
    ):
        pose = random_pose(np.random.default_rng(n), place)
        spot = K @ place
        spot = spot[:2] / spot[2]
        rgb += (90 + 60 * n) * np.exp(-((u - spot[0]) ** 2 + (v - spot[1]) ** 2) / 18)
        instances.append(bop.Instance(1, pose, None, visible_share=share, annotation=n))
    path = tmp_path / "image.png"
    cv2.imwrite(str(path), np.repeat(rgb.round().astype(np.uint8)[..., None], 3, 2))
    return bop.Image(0, path, K, np.eye(4), instances)


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_boxes_lie_around_what_they_are_of(image, augment, seed, monkeypatch):
    # In smaller pictures the spots' brightness no longer tells which is which.
    monkeypatch.setattr(search, "LIMITS", (0.7, 2.5))
    made = search.Searches(NETWORK, (BALL,)).make(image, np.random.default_rng(seed), augment)
    assert made["search_image"].shape == (384, 512, 3)
    there = made["search_boxes"][:, 2] > made["search_boxes"][:, 0]
    inside = 0
    for box, index in zip(made["search_boxes"][there], made["search_class"][there], strict=True):
        x0, y0, x1, y1 = box
        assert x0 >= -0.5 and y0 >= -0.5 and x1 <= 511.5 and y1 <= 383.5
        if min(x0, y0) < 0 or x1 > 511 or y1 > 383:
            continue  # cut off: its middle is another
        piece = made["search_image"][..., 0].astype(float)
        v, u = np.mgrid[:384, :512]
        near = piece * (np.hypot(u - (x0 + x1) / 2, v - (y0 + y1) / 2) < (x1 - x0) / 4)
        middle = np.array([(near * u).sum(), (near * v).sum()]) / near.sum()
        # With knobs, and seen aslant, the outline is not around the ball's middle.
        center, size = np.array([x0 + x1, y0 + y1]) / 2, np.array([x1 - x0, y1 - y0])
        assert (abs(middle - center) < 0.05 * size).all()
        assert index == (-1 if near.max() > 180 else 0)  # the third, mostly hidden
        inside += 1
    assert inside >= 1 or augment
    if not augment:
        assert inside == 3


def test_scales_spread_about_that_of_inference(image):
    fit = 512 / 640
    for zoom, spread in ((0.0, 0.0), (0.35, 0.345)):
        searches = search.Searches(NETWORK, (BALL,), zoom=zoom)
        scales = [
            searches._camera(image, (480, 640), np.random.default_rng(seed), True)[0][0, 0]
            / (fit * image.k[0, 0])
            for seed in range(2000)
        ]
        assert abs(np.log(scales).mean()) < 0.05
        assert np.log(scales).std() == pytest.approx(spread, abs=0.02)
        assert min(scales) >= 0.35 and max(scales) <= 2.5


def test_what_the_image_cuts_off_is_counted_once(image):
    """Half of a ball at the border is in sight: by its annotation, which is that of the image."""
    at_border = np.eye(4)
    at_border[:3, 3] = (-331.5 / 560, 0.0, 1.0)
    image.instances[:] = [bop.Instance(1, at_border, None, visible_share=0.5)]
    made = search.Searches(NETWORK, (BALL,)).make(image, np.random.default_rng(0), augment=False)
    assert made["search_class"].tolist() == [0] + [-1] * (search.MOST - 1)
    # Of data without annotated shares all is as much in sight as lies in the image.
    at_border[0, 3] *= 1.06
    image.instances[:] = [bop.Instance(1, at_border, None)]
    made = search.Searches(NETWORK, (BALL,)).make(image, np.random.default_rng(0), augment=False)
    assert made["search_boxes"].any() and (made["search_class"] == -1).all()


@pytest.mark.parametrize("seed", range(3))
def test_where_an_object_may_be_it_may_be_found_or_not(image, seed):
    """An unsure box moves with the picture; here it is that of the third ball."""
    one = image.instances[2]
    image.unsure = amodal_boxes(BALL.bounds, K, one.cam_from_obj)[None]
    del image.instances[:2]
    made = search.Searches(NETWORK, (BALL,)).make(image, np.random.default_rng(seed), augment=True)
    there = made["search_boxes"][made["search_boxes"].any(1)]
    assert len(there) in (0, 1, 2) and (made["search_class"] == -1).all()
    if len(there) == 2:
        middles = (there[:, :2] + there[:, 2:]) / 2
        np.testing.assert_allclose(middles[0], middles[1], atol=12)


class Screen:
    """In place of a composer: covers most of the first box, then all of the second."""

    def __init__(self):
        self.shares = iter([0.65, 1.0, 0.0])

    def behind(self, picture, whose, rng):
        return picture

    def before(self, picture, box, rng):
        x0, y0, x1, y1 = np.rint(box).astype(int)
        mask = np.zeros(picture.shape[:2], np.uint8)
        mask[y0 : y1 + 1, x0 : x0 + round(next(self.shares) * (x1 + 1 - x0))] = 1
        return picture * (mask == 0)[..., None], mask


def test_what_something_is_put_before_is_seen_less(image, monkeypatch):
    """Of three balls, the last of which is mostly hidden as it is: one may be found, one not."""
    whose = np.zeros((480, 640), np.uint8)
    for one in image.instances[:2]:  # of the last no pixels are known
        place = one.cam_from_obj[:3, 3]
        middle = K @ place / place[2]
        radius = round(0.03 * 560 / place[2])
        center = np.rint(middle[:2]).astype(int).tolist()
        cv2.circle(whose, center, radius, one.annotation + 1, -1)
    monkeypatch.setattr(search.bop, "read_coords", lambda image, shape: (None, whose))
    monkeypatch.setattr(search, "OCCLUDED", 1.0)
    searches, covers = (search.Searches(NETWORK, (BALL,), one) for one in (None, Screen()))
    camera = search.Searches._camera  # that does not move
    monkeypatch.setattr(search.Searches, "_camera", lambda *given: camera(*given[:-1], False))
    rng = np.random.default_rng(0)
    before, made = searches.make(image, rng, augment=False), covers.make(image, rng)
    assert before["search_class"][:4].tolist() == [0, 0, -1, -1]
    np.testing.assert_allclose(made["search_boxes"][:2], before["search_boxes"][[0, 2]])
    assert made["search_class"][:2].tolist() == [-1, -1]
    assert (made["search_boxes"][2:] == 0).all()
    x0, y0, x1, y1 = before["search_boxes"][1].astype(int)
    assert not made["search_image"][y0:y1, x0:x1].any(), "the second is covered"


def loss(logits, boxes, truth, index):
    return losses.detection_loss(logits, boxes, truth, index, 8)


def test_each_class_has_its_own_map():
    """A peak in the right class's map at the box's middle costs little, in the other's much."""
    truth = torch.tensor([[[20.0, 20, 60, 52], [0, 0, 0, 0]]])
    index = torch.tensor([[1, -1]])
    boxes = truth[:, 0, :, None, None].expand(1, 4, 8, 12).contiguous()
    quiet = torch.full((1, 2, 8, 12), -6.0)
    right, wrong = quiet.clone(), quiet.clone()
    right[0, 1, 4, 5], wrong[0, 0, 4, 5] = 6.0, 6.0  # whose middle is nearest to (40, 36)
    assert loss(right, boxes, truth, index) < 0.1
    assert loss(wrong, boxes, truth, index) > loss(quiet, boxes, truth, index) + 3


def test_what_is_mostly_hidden_may_be_found_or_not():
    truth = torch.tensor([[[20.0, 20, 60, 52], [64.0, 24, 88, 48]]])
    boxes = torch.zeros(1, 4, 8, 12)
    boxes[:, 2:] = 10
    quiet = torch.full((1, 1, 8, 12), -4.0)
    found = quiet.clone()
    found[0, 0, 4, 9] = 3.0
    unsure, sure = torch.tensor([[0, -1]]), torch.tensor([[0, 0]])
    torch.testing.assert_close(loss(found, boxes, truth, unsure), loss(quiet, boxes, truth, unsure))
    assert loss(found, boxes, truth, sure) < loss(quiet, boxes, truth, sure)


def test_a_cell_speaks_of_the_nearer_object():
    """Perfect boxes of two neighbours at their own middles cost nothing."""
    truth = torch.tensor([[[0.0, 0, 32, 32], [32.0, 0, 64, 32]]])
    boxes = torch.zeros(1, 4, 4, 8)
    boxes[0, :, :, :4] = truth[0, 0][:, None, None]
    boxes[0, :, :, 4:] = truth[0, 1][:, None, None]
    logits = torch.full((1, 1, 4, 8), -8.0)
    swapped = boxes.flip(-1)
    index = torch.tensor([[0, 0]])
    assert loss(logits, boxes, truth, index) + 1 < loss(logits, swapped, truth, index)


def test_boxes_are_matched_by_hand():
    truth = torch.tensor([[0.0, 0, 10, 10], [20.0, 0, 30, 10], [40.0, 0, 50, 10]])
    index = torch.tensor([0, 1, -1])
    boxes = torch.tensor(
        [
            [0.0, 0, 10, 10],  # right
            [0.0, 0, 10, 9],  # the same once more: one too many
            [20.0, 0, 30, 10],  # of the wrong class
            [40.0, 0, 50, 10],  # may be found or not: counts neither way
        ]
    )
    scores, classes = torch.tensor([0.9, 0.8, 0.7, 0.6]), torch.tensor([0, 0, 0, 0])
    found = thresholds.matched(boxes, scores, classes, truth, index)
    assert [(round(s, 1), round(iou, 1)) for s, iou in found] == [
        (0.9, 1.0),
        (0.8, 0.0),
        (0.7, 0.0),
    ]
