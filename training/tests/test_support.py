"""The least support of an object that is believed."""

from pathlib import Path

import mvtop
import numpy as np
import pytest

from mvtop_train.data import bop
from mvtop_train.training import support


def test_the_threshold_lies_between_what_is_there_and_what_is_not():
    found = [(0.9, True), (0.1, False), (0.5, True), (0.2, False)]
    assert support.choose(found, 2) == pytest.approx(0.35)
    assert support.choose(found[::-1], 2) == pytest.approx(0.35)


def test_one_that_is_wrong_is_taken_for_two_that_are_right():
    found = [(0.9, True), (0.8, False), (0.7, True), (0.6, True), (0.2, False), (0.1, False)]
    assert support.choose(found, 3) == pytest.approx(0.4)


def test_of_thresholds_that_are_as_good_the_least_is_taken():
    """What is left out is lost; what is let in too much, print and confidence tell still."""
    found = [(0.9, True)] * 200 + [(0.5, False)] * 3 + [(0.4, True)]
    assert support.choose(found, 201) == pytest.approx(0.2)
    assert support.choose(found[:20] + found[200:], 21) == pytest.approx(0.7)


def test_without_objects_none_is_refused():
    assert support.choose([], 3) == support.choose([(0.3, False)], 0) == 0


def test_cameras_may_be_in_one_housing(monkeypatch):
    monkeypatch.setattr(bop, "read_rgb", lambda path: np.zeros((48, 64, 3), np.uint8))
    k, beside = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4)
    beside[0, 3] = -0.001
    images = [bop.Image(0, Path(), k, pose, []) for pose in (np.eye(4), beside)]
    rig, _ = support.rig_of(images)
    assert rig.cameras[1].world_from_cam[0, 3] == pytest.approx(0.001)


def test_of_a_network_that_gives_no_poses_what_is_there_is_counted(monkeypatch):
    class Hopeless:
        def predict(self, *args, **options):
            raise mvtop.Error("poses that cannot be")

    monkeypatch.setattr(mvtop.Estimator, "load", lambda bundle: Hopeless())
    monkeypatch.setattr(support, "rig_of", lambda images: (None, {}))
    thing = bop.Instance(1, np.eye(4), None)
    image = bop.Image(0, Path("0.png"), np.eye(3), np.eye(4), [thing])
    monkeypatch.setattr(bop, "sightings", lambda images, by_id: [images, images])
    assert support.found_in(Path("bundle"), [[image]], ()) == ([], 2)


def test_images_are_told_apart_by_scene(tmp_path):
    def image(scene, number):
        path = tmp_path / scene / "rgb" / f"{number}.jpg"
        return bop.Image(number, path, np.eye(3), np.eye(4), [])

    scenes = support.scenes_of([image("1", 0), image("1", 1), image("2", 0)])
    assert [[one.number for one in scene] for scene in scenes] == [[0, 1], [0]]
