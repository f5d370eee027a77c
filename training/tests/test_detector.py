"""The detector's yardstick: boxes move as pixels do under conditions; recall worked by hand."""

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from mvtop_train.data import letterbox
from mvtop_train.errors import UserError
from mvtop_train.evaluation import boxes, conditions, detector, groups, sets
from mvtop_train.network.config import ObjectClass

NUT = ObjectClass(1, "nut", 0.2)
SIZE = 120, 80  # of images, px


class Found:
    """In place of a bundle's detector: the same boxes in every picture."""

    names, threshold = ["nut", "bolt"], 0.5

    def __init__(self, *rows):
        """rows: box, score, class"""
        self.rows = rows

    def __call__(self, rgb):
        found = torch.tensor([row[0] for row in self.rows], dtype=torch.float).reshape(-1, 4)
        scores = torch.tensor([float(row[1]) for row in self.rows])
        return found, scores, torch.tensor([row[2] for row in self.rows], dtype=torch.long)


def plain() -> conditions.Shown:
    return conditions.Shown(np.zeros((80, 120, 3), np.uint8), np.eye(3))


def visible(box, share: float = 1.0, kind: int = 0) -> boxes.Visible:
    return boxes.Visible(kind, np.array(box, float), share)


def test_found_near_false_and_what_counts_neither_way():
    there = [
        visible([0, 0, 20, 20]),  # found
        visible([40, 0, 60, 20]),  # a box in its middle that is too small
        visible([80, 0, 100, 20], share=0.4),  # mostly hidden: may be found
        visible([0, 40, 20, 60], kind=1),  # taken for another class
    ]
    given = Found(
        ([0, 0, 20, 18], 0.9, 0), ([0, 0, 20, 19], 0.8, 0), ([45, 5, 55, 15], 0.7, 0),
        ([80, 0, 100, 20], 0.6, 0), ([0, 40, 20, 60], 0.5, 0),
    )  # fmt: skip
    told = detector.looked_at(given, plain(), there, {"nut", "bolt"})
    assert told["objects"] == [
        {"class": "nut", "score": 0.9, "near": 0.9},
        {"class": "nut", "score": 0.0, "near": 0.7},
        {"class": "bolt", "score": 0.0, "near": 0.0},
    ]
    assert told["false"] == [0.8, 0.7, 0.5]
    only = detector.looked_at(given, plain(), there, {"bolt"})
    assert only["false"] == [], "of classes that are not asked for boxes do not count"


def picture(scores, false) -> dict:
    objects = [{"class": "nut", "score": x, "near": max(x, 0.3)} for x in scores]
    return {"image": "0", "objects": objects, "false": false}


def test_recall_at_both_thresholds():
    """Two pictures: at one false box in each the third best false box is too many."""
    pictures = [picture([0.9, 0.4], [0.8, 0.35, 0.2]), picture([0.25, 0.0], [])]
    told = detector.summary(pictures, 0.5)
    assert (told["images"], told["objects"], told["recall"]) == (2, 4, 0.25)
    assert told["false_per_image"] == 0.5
    assert 0.2 < told["threshold_at_one"] < 0.201
    assert told["recall_at_one"] == 0.75
    assert detector.summary(pictures, 0.3)["near"] == 1.0
    assert told["by_class"]["nut"]["objects"] == 4
    nothing = detector.summary([picture([], [])], 0.5)
    assert nothing["recall"] is None and nothing["threshold_at_one"] == 0.0
    assert "-" in detector.table({"plain": nothing})


def test_what_no_box_finds_is_not_found_at_any_score():
    assert detector.summary([picture([0.0], [])], 0.5)["recall_at_one"] == 0.0


@pytest.mark.parametrize("name", [*conditions.COLORS, conditions.HALF, conditions.TURNED])
def test_boxes_move_as_pixels_do(name):
    """A bright rectangle is where its box is, within a pixel."""
    rgb, box = np.zeros((80, 120, 3), np.uint8), np.array([29.5, 9.5, 69.5, 39.5])
    rgb[10:40, 30:70] = 100
    (shown,) = conditions.pictures(name, rgb, [box])
    v, u = np.nonzero(shown.rgb[..., 1] - (shown.rgb[0, 0, 1] if name == conditions.HALF else 0))
    if name == conditions.HALF:
        inner = cv2.inRange(shown.rgb, (90, 90, 90), (101, 101, 101))
        v, u = np.nonzero(inner)
    found = [u.min() - 0.5, v.min() - 0.5, u.max() + 0.5, v.max() + 0.5]
    np.testing.assert_allclose(shown.box(box), found, atol=1.0)
    expected = rgb.shape[1::-1] if name == conditions.TURNED else rgb.shape[:2]
    assert shown.rgb.shape[:2] == expected


def test_an_object_is_zoomed_at_in_the_middle_and_alone():
    rgb = np.zeros((80, 120, 3), np.uint8)
    there = [visible([10, 10, 30, 30]), visible([40, 20, 60, 40])]
    shown = list(conditions.pictures(conditions.ZOOMED, rgb, [one.box for one in there]))
    np.testing.assert_allclose(shown[0].box(there[0].box), [39.5, 19.5, 79.5, 59.5])
    assert shown[0].rgb[0, 0].tolist() == list(conditions.FILL)  # left of the image
    told = detector.looked_at(Found(([39.5, 19.5, 79.5, 59.5], 0.9, 0)), shown[1], there, {"nut"})
    assert [one["score"] for one in told["objects"]] == [0.9]


def test_colors_are_those_of_light():
    rgb = np.full((2, 2, 3), 100, np.uint8)
    (warm,) = conditions.pictures("warmer", rgb, [])
    assert warm.rgb[0, 0].tolist() == [114, 100, 85]
    (bright,) = conditions.pictures("brighter", np.full((2, 2, 3), 220, np.uint8), [])
    assert bright.rgb.max() == 255


def test_true_boxes_are_of_what_the_image_shows():
    """A cube of 0.2 m, 1 m off, half of it beyond the right border; another camera sees it not."""
    import mvtop

    k = np.array([[100.0, 0, 59.5], [0, 100, 39.5], [0, 0, 1]])
    camera = mvtop.Camera(k, SIZE, id="a")
    pose = np.eye(4)
    pose[:3, 3] = 0.6, 0, 1.0
    corners = np.array(np.meshgrid(*[[-0.1, 0.1]] * 3)).reshape(3, -1).T
    one = boxes.Detector.__new__(boxes.Detector)
    one.names, one._bounds = ["nut"], [corners]
    group = SimpleNamespace(truth=(groups.Truth(NUT, pose, {"a": None}),))
    (found,) = one.truth(group, camera)
    # The near face, at 0.9 m: from 0.5 to 0.7 m beside the axis; the far one begins at 0.5 / 1.1.
    expected = [59.5 + 50 / 1.1, 39.5 - 10 / 0.9, 119.5, 39.5 + 10 / 0.9]
    np.testing.assert_allclose(found.box, expected)
    assert (found.kind, found.share) == (0, 0.5)
    group = SimpleNamespace(truth=(groups.Truth(NUT, pose, {"b": None}),))
    assert one.truth(group, camera) == []
    group = SimpleNamespace(truth=(groups.Truth(NUT, pose, {"a": 0.9}),))
    assert one.truth(group, camera)[0].share == 0.9


def test_large_images_are_shown_larger():
    """The same cases as of `detector_input` in `mvtop-core/src/estimator/view.rs`."""
    tiling = {"full_scale": 0.8, "max_input": 1.75}
    for (width, height), expected in (
        ((640, 480), (512, 384)), ((1280, 720), (800, 448)), ((320, 240), (512, 384)),
        ((2448, 2048), (672, 544)), ((480, 640), (384, 512)),
    ):  # fmt: skip
        assert letterbox.input_size(512, 384, (height, width, 3), tiling) == expected


def test_each_image_of_a_set_is_looked_at_once():
    found = sets.single_views()
    assert found["photos"].views == 1 and found["ball"].views == 2
    assert "photos-4" not in found and len({one.folders for one in found.values()}) == len(found)


def test_a_bundle_on_its_example(monkeypatch, capsys, tmp_path):
    """The shipped model finds the shipped example's ball, and the command writes what it prints."""
    root = Path(__file__).parents[2]
    out = tmp_path / "new" / "out.json"
    arguments = ["detector", "--model", "models/mvball", "--set", "example-mvball"]
    monkeypatch.chdir(root)
    monkeypatch.setattr("sys.argv", [*arguments, "--condition", "plain", "--out", str(out)])
    detector.main()
    told = json.loads(out.read_text())["sets"]["example-mvball"]["summary"]["plain"]
    assert (told["images"], told["objects"], told["recall"]) == (2, 2, 1.0)
    assert "plain" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="expected no such file"):
        detector.main()
    monkeypatch.setattr("sys.argv", [*arguments, "--data", "x"])
    with pytest.raises(SystemExit, match="expected alone"):
        detector.main()


def test_other_objects_than_those_of_test_sets_need_data():
    args = SimpleNamespace(data=None, set=None, model="m")
    with pytest.raises(UserError, match="expected the objects of a test set, got washer"):
        detector.chosen(args, {"washer": None})
    assert {one.name for one in detector.chosen(args, {"mvball": NUT})} == {"ball", "path-ball"}
