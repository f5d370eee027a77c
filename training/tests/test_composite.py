"""What is put behind and before an object leaves the object, and its share in sight, alone."""

import os

import cv2
import numpy as np
import pytest

from mvtop_train.data import backgrounds, composite
from mvtop_train.data.bop import OTHER
from mvtop_train.errors import UserError


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    (folder / "deeper").mkdir()
    rng = np.random.default_rng(0)
    for name in ("a.jpg", "deeper/b.PNG"):
        cv2.imwrite(str(folder / name), rng.integers(0, 256, (300, 400, 3), np.uint8))
    (folder / "notes.txt").write_text("no picture")
    return backgrounds.pictures(folder)


def test_the_pictures_of_a_folder_are_found(pictures, tmp_path):
    assert sorted(path.name for path in pictures) == ["a.jpg", "b.PNG"]
    with pytest.raises(UserError, match="expected a folder of pictures .*, got none; fix: "):
        backgrounds.pictures(tmp_path)
    broken = tmp_path / "broken.png"
    broken.write_text("not a picture")
    with pytest.raises(UserError, match="broken.png: expected a picture, .*; fix: "):
        backgrounds.cut([broken], np.random.default_rng(0), 8, 8)


def test_pictures_are_files_of_bounded_size(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(bytes(100))
    os.mkfifo(tmp_path / "b.png")
    with pytest.raises(UserError, match="b.png: expected a file of .* pipe or device; fix: "):
        backgrounds.fingerprint(tmp_path)
    (tmp_path / "b.png").unlink()
    monkeypatch.setattr(backgrounds, "BYTES", 99)
    with pytest.raises(UserError, match="a.png: expected a file of .* larger one.*; fix: "):
        backgrounds.pictures(tmp_path)


def test_the_fingerprint_is_of_all_that_is_in_a_picture(tmp_path):
    found = set()
    for last in (b"a", b"b"):
        (tmp_path / "a.png").write_bytes(bytes(1 << 17) + last)
        found.add(backgrounds.fingerprint(tmp_path))
    assert len(found) == 2


@pytest.mark.parametrize("size", [(160, 160), (384, 512), (50, 700)])
def test_a_piece_has_the_size_asked_for(pictures, size):
    for seed in range(5):
        assert backgrounds.cut(pictures, np.random.default_rng(seed), *size).shape == (*size, 3)


def test_the_object_stays_and_the_background_changes(pictures):
    composer = composite.Composer(pictures, occluders=0.0)
    picture = np.full((80, 80, 3), 77, np.uint8)
    who = np.zeros((80, 80), np.uint8)
    who[20:60, 20:60], who[5:15, 5:15], who[65:75, 65:75] = 3, 4, OTHER
    changed = {"background": 0, "neighbor": 0, "thing": 0}
    for seed in range(60):
        made, before = composer.around(
            picture, who, 3, np.array([20, 20, 60, 60]), np.random.default_rng(seed)
        )
        assert not before.any()
        assert (made[26:54, 26:54] == 77).all()
        changed["background"] += (made[40, 62:] != 77).any()
        changed["neighbor"] += (made[9:11, 9:11] != 77).any()
        changed["thing"] += (made[69:71, 69:71] != 77).any()
    assert 15 < changed["background"] < 45
    assert 0 < changed["neighbor"] < changed["thing"] < changed["background"]


def test_what_comes_before_is_told_and_hides_a_part(pictures):
    composer = composite.Composer(pictures, occluders=1.0)
    picture = np.random.default_rng(0).integers(0, 256, (80, 80, 3), np.uint8)
    box, shares = np.array([20, 20, 60, 60]), []
    for seed in range(200):
        made, before = composer.around(picture, None, 1, box, np.random.default_rng(seed))
        changed = (made != picture).any(-1)
        softened = cv2.dilate(before, np.ones((7, 7), np.uint8))
        assert not changed[softened == 0].any(), f"seed {seed}: changed where nothing is before"
        core = cv2.erode(before, np.ones((5, 5), np.uint8)) != 0
        assert changed[core].all(), f"seed {seed}: something is before, and nothing changed"
        shares.append(before[20:60, 20:60].mean())
    assert 0.1 < np.mean(shares) < 0.4
    assert np.mean(np.array(shares) > 0.5) < 0.2, "most of the time, most is left to see"


def test_an_occluder_may_have_the_colors_of_what_it_hides():
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 256, (40, 50, 3), np.uint8)
    like = rng.normal([180, 60, 40], [12, 9, 15], (30, 20, 3)).clip(0, 255).astype(np.uint8)
    found = composite.recolored(picture, like)
    assert np.allclose(found.mean((0, 1)), like.mean((0, 1)), atol=0.5)
    assert np.allclose(found.std((0, 1)), like.std((0, 1)), atol=0.5)
    assert (composite.recolored(picture, like[:0]) == picture).all(), "the box is off the picture"


def test_pictures_that_changed_under_their_names_are_told_apart(tmp_path):
    picture = tmp_path / "a" / "floor.png"
    picture.parent.mkdir()
    cv2.imwrite(str(picture), np.zeros((8, 8, 3), np.uint8))
    before = backgrounds.fingerprint(tmp_path)
    assert backgrounds.fingerprint(tmp_path) == before
    cv2.imwrite(str(picture), np.full((8, 8, 3), 9, np.uint8))
    changed = backgrounds.fingerprint(tmp_path)
    assert changed != before
    picture.rename(picture.with_name("wall.png"))
    assert backgrounds.fingerprint(tmp_path) != changed
