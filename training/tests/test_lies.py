"""Lies about calibrations: what each one is, and that they are noticed."""

import json
from pathlib import Path

import numpy as np
import pytest

from mvtop_train.errors import UserError
from mvtop_train.study import lies

REPO = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def shots():
    return lies.read(REPO / "examples/mvball")


def told(name: str, shots: lies.Shots) -> lies.Shots:
    return lies.LIES[name](shots, np.random.default_rng(1))


def angle_deg(a: lies.Shot, b: lies.Shot) -> float:
    between = a.world_from_cam[:3, :3].T @ b.world_from_cam[:3, :3]
    return float(np.rad2deg(np.arccos((np.trace(between) - 1) / 2)))


def test_lies_are_what_their_names_say(shots):
    last = shots[-1]
    assert angle_deg(last, told("one camera turned by 2 degrees", shots)[-1]) == pytest.approx(2)
    rolled = told("one camera rolled by 10 degrees", shots)[-1]
    assert angle_deg(last, rolled) == pytest.approx(10)
    np.testing.assert_allclose(rolled.world_from_cam[:, 2], last.world_from_cam[:, 2])  # its axis
    moved = told("one camera moved by 20 mm", shots)[-1].world_from_cam - last.world_from_cam
    assert np.linalg.norm(moved[:3, 3]) == pytest.approx(0.02)

    def distance(rig):
        return np.linalg.norm(np.subtract(*(s.world_from_cam[:3, 3] for s in rig)))

    longer = told("translations 10 % too long", shots)
    assert distance(longer) == pytest.approx(1.1 * distance(shots))
    assert angle_deg(*longer) == pytest.approx(angle_deg(*shots))
    swapped = told("direction of poses swapped", shots)
    ref_from_last = np.linalg.inv(shots[0].world_from_cam) @ last.world_from_cam
    np.testing.assert_allclose(swapped[-1].world_from_cam @ ref_from_last, np.eye(4), atol=1e-12)
    np.testing.assert_array_equal(told("images swapped", shots)[0].image, last.image)
    assert told("images of half the size", shots)[0].image.shape == (240, 320, 3)
    # All but the last camera are as they were.
    for name in lies.LIES:
        if name.startswith("one "):
            assert told(name, shots)[0] is shots[0]


def test_the_fisheye_image_shows_what_the_pinhole_image_shows():
    """A bright spot 20 degrees off the axis."""
    k = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    image = np.zeros((240, 320, 3), np.uint8)
    column = 160 + 300 * np.tan(np.deg2rad(20))
    image[118:123, int(column) - 2 : int(column) + 3] = 255
    shot = lies._through_fisheye(lies.Shot("a", k, np.eye(4), image))
    _, columns = np.nonzero(shot.image[:, :, 0] > 128)
    assert columns.mean() == pytest.approx(160 + 300 * np.deg2rad(20), abs=1.0)


def test_wrong_calibrations_of_the_example_are_noticed(tmp_path):
    """One pair: the lies that leave no room for a pose that fits."""
    out = tmp_path / "lies.jsonl"
    lines = lies.measure([REPO / "examples/mvball"], REPO / "models/mvball", out)
    noticed = {line["lie"] for line in lines if line["refused"] or line["warnings"]}
    assert not noticed & set(lies.TRUE)
    assert noticed >= {
        "one camera rolled by 90 degrees", "translations 1000 times too long",
        "translations 1000 times too short", "direction of poses swapped", "rotations transposed",
        "OpenGL axes", "order of quaternions", "focal lengths 1.5 times too long",
        "images of half the size", "images swapped", "one image upside down",
    }  # fmt: skip
    text = lies.table(lines)
    assert text.count("\n") == 2 + len(lies.TRUE) + len(lies.LIES)
    assert "| none: pinhole | 1 | 0 |" in text
    assert "| translations 1000 times too long | 1 | 1 |" in text
    # What is there is not measured again.
    before = out.read_text()
    again = lies.measure([REPO / "examples/mvball"], REPO / "models/mvball", out)
    assert out.read_text() == before
    assert [json.dumps(line) for line in again] == before.splitlines()


def test_folders_without_samples_are_refused(tmp_path):
    (tmp_path / "rig.json").write_text("{}")
    with pytest.raises(UserError, match=r"rig.json.*; fix: --samples"):
        lies.read(tmp_path)
