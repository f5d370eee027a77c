"""Scenes keep the rule of the paper, and what is written comes back."""

import json
import subprocess
import sys

import numpy as np
import pytest

from mvtop_train import children
from mvtop_train.data import bop, mvball, objects, rendered
from mvtop_train.data.boxes import amodal_boxes
from mvtop_train.data.crops import Augmentation, Crops
from mvtop_train.data.views import ViewMaker
from mvtop_train.errors import UserError
from mvtop_train.export import __main__ as export
from mvtop_train.network import config
from mvtop_train.network.coordinates import decode
from mvtop_train.synthesis import scenes
from mvtop_train.synthesis.generate import scene_views
from mvtop_train.synthesis.gl import open_gl


@pytest.fixture(scope="module")
def gl():
    return open_gl()


@pytest.fixture(scope="module")
def views(gl):
    return scene_views(gl, seed=11, split="hard", index=0, order=["green", "red"])


def pose_of(view):
    return view.cam_from_obj(view.seen[0])


def test_axes_of_every_camera_are_orthonormal():
    # Some of those above the ball look within 8 degrees of straight down, where z is no side.
    rng = np.random.default_rng(0)
    down = 0
    for _ in range(300):
        _, cam_from_world = scenes.random_camera(rng, np.array([0, 0, 0.06]), np.array([0, 0, 1.0]))
        rotation = cam_from_world[:3, :3]
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
        assert np.linalg.det(rotation) > 0
        down += -np.array([0, 0, 1.0]) @ rotation[2] > 0.99
    assert down > 0


def test_exactly_one_hemisphere_shows(views):
    assert [view.seen[0].shows for view in views] == ["green", "red"]
    for view in views:
        (ball,) = view.seen
        assert ball.bump_pixels > 10
        hidden = {"green": "red", "red": "green"}[ball.shows]
        coords = rendered.object_coordinates(view, ball)[ball.mask]
        assert np.isnan(coords).any(1).mean() < 0.05
        # No visible point lies on the other hemisphere (object coordinates from the depth map).
        on_hidden = coords @ mvball.BUMPS[hidden] > mvball.BUMP_CENTER + 0.3 * mvball.BUMP_RADIUS
        assert not on_hidden.any()  # comparisons with NaN are false


def test_a_scene_is_drawn_from_its_number_alone(gl, views):
    again = scene_views(gl, seed=11, split="hard", index=0, order=["green", "red"])
    for a, b in zip(views, again, strict=True):
        assert np.array_equal(a.rgb, b.rgb) and np.array_equal(pose_of(a), pose_of(b))
    other = scene_views(gl, seed=11, split="easy", index=0, order=["green", "red"])
    assert not np.allclose(pose_of(views[0]), pose_of(other[0]))


def test_the_camera_projects_the_ball_onto_its_mask(views):
    for view in views:
        (ball,) = view.seen
        box = rendered.amodal_box(view, ball)
        v, u = np.nonzero(ball.mask)
        assert box[0] <= u.min() + 1 and box[1] <= v.min() + 1
        assert box[2] >= u.max() - 1 and box[3] >= v.max() - 1
        radius = np.linalg.norm(rendered.object_coordinates(view, ball)[ball.mask], axis=1)
        assert np.nanmedian(radius) == pytest.approx(mvball.BALL_RADIUS, abs=5e-4)


def test_a_written_scene_reads_back(tmp_path, views):
    bop.write_scene(tmp_path, views)
    for image, view in zip(bop.read_scene(tmp_path), views, strict=True):
        np.testing.assert_allclose(image.cam_from_obj, pose_of(view), atol=1e-9)
        np.testing.assert_allclose(image.k, view.k)
        code, who = bop.read_coords(image, view.rgb.shape[:2])
        assert np.array_equal(who == 1, view.seen[0].mask)
        coords, mask = decode(code)
        expected = rendered.object_coordinates(view, view.seen[0])
        assert np.array_equal(mask, ~np.isnan(expected[..., 0]))
        error = np.abs(coords[mask] * mvball.EXTENT - expected[mask]).max()
        assert error < mvball.EXTENT / 120


def test_a_crop_is_an_exact_camera(tmp_path, views):
    """Object coordinates seen in a scaled, rolled, shifted crop project to where they are."""
    bop.write_scene(tmp_path, views)
    rng = np.random.default_rng(1)
    network = config.preset("tiny", objects.classes_of(objects.ball()))
    maker = ViewMaker(Crops(160, Augmentation(scale=0.8)), network, (objects.ball(),))
    for image in bop.read_scene(tmp_path):
        for _ in range(5):
            view = maker.make_view(image, rng)
            coords, mask = decode(view["coords"])
            v, u = np.nonzero(mask)
            points = coords[v, u] * mvball.EXTENT
            pose = view["cam_from_obj"]
            pixels = (points @ pose[:3, :3].T + pose[:3, 3]) @ view["k"].T
            pixels = pixels[:, :2] / pixels[:, 2:]
            seen = np.stack([u, v], 1) * 4 + 1.5  # centers of 4 x 4 blocks
            assert np.median(np.linalg.norm(pixels - seen, axis=1)) < 1.0
            box = amodal_boxes(mvball.bounding_points(), view["k"], pose)
            assert (pixels >= box[:2] - 2).all() and (pixels <= box[2:] + 2).all()


class Screen:
    """In place of a composer: hides all pixels left of a column."""

    def __init__(self, column: int):
        self.column = column

    def around(self, picture, who, of, box, rng):
        hidden = np.zeros(picture.shape[:2], np.uint8)
        hidden[:, : self.column] = 1
        return picture * (hidden == 0)[..., None], hidden


def test_no_coordinates_are_asked_for_where_something_was_put_before(tmp_path, views):
    bop.write_scene(tmp_path, views)
    network = config.preset("tiny", objects.classes_of(objects.ball()))
    image, column = bop.read_scene(tmp_path)[0], 80
    crops = Crops(160, Augmentation(scale=0.8))
    open_view, screened = (
        ViewMaker(crops, network, (objects.ball(),), composer=Screen(hides)).make_view(
            image, np.random.default_rng(4)
        )
        for hides in (0, column)
    )
    asked = open_view["coords"]
    assert asked[:, : column // 4].any() and asked[:, column // 4 :].any()
    assert not screened["coords"][:, : column // 4].any()
    np.testing.assert_array_equal(screened["coords"][:, column // 4 :], asked[:, column // 4 :])


@pytest.mark.parametrize(
    "name",
    ["../../PWNED", "a/b", "a\x1b[31m", "a\nb", "a\x9bb", "a\u202eb", "a\u200bb", "a\u2028b"],
)
def test_names_of_objects_are_names_that_files_can_have(name, tmp_path, monkeypatch):
    data, out = tmp_path / "data", tmp_path / "deep/b"
    objects.write(data, [(objects.ball(), objects.ball_mesh())])
    path = data / "models" / objects.INFO
    path.write_text(json.dumps({"1": {"diameter": 98.0, "name": name}}))
    before = sorted(tmp_path.rglob("*"))
    for read in (objects.read_all, objects.read):
        with pytest.raises(UserError, match="models_info.json: expected names .*; fix: "):
            read(data)
    options = ["--untrained", "tiny", "--data", str(data), "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["export", *options])
    with pytest.raises(SystemExit, match="error: .*models_info.json: expected names"):
        export.main()
    assert sorted(tmp_path.rglob("*")) == before


def test_workers_start_where_opencv_has_threads_already(tmp_path):
    """In a process of its own, as one that hangs would never end."""
    program = (
        "import cv2, numpy as np, torch\n"
        "from mvtop_train.data import batches\n"
        "cv2.setNumThreads(4)\n"
        "cv2.resize(np.zeros((2000, 2000, 3), np.uint8), (900, 900))\n"
        "class Items(torch.utils.data.Dataset):\n"
        "    def __getitem__(self, n):\n"
        "        cv2.setNumThreads(1)\n"
        "        return torch.zeros(1)\n"
        "print(next(batches.loader(Items(), 0, 1, False)).item())\n"
    )
    done = subprocess.run(
        children.python("-c", program), capture_output=True, text=True, timeout=120
    )
    assert done.stdout == "0.0\n", done.stderr
