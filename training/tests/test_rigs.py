"""What is measured of rigs that stand wrong."""

import json

import numpy as np
import pytest

from mvtop_train.errors import UserError
from mvtop_train.evaluation.shots import Shot
from mvtop_train.study import rigs


def shots():
    right = np.eye(4)
    right[0, 3] = 0.4
    k = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    return [Shot("left", k, np.eye(4), None), Shot("right", k, right, None)]


@pytest.mark.parametrize("name", rigs.RIGS)
def test_errors_are_those_of_the_name(name):
    told = rigs.RIGS[name](shots(), np.random.default_rng(3))
    degrees, mm = rigs.error(told, shots())
    if "by" in name:
        amount, unit = float(name.split()[2]), name.split()[3]
        expected = (0, amount) if unit == "mm" else (amount, 0)
        assert (degrees, mm) == pytest.approx(expected, abs=1e-6)
    # Where all cameras are wrong, seen from the first the last one is as well; a place beside it
    # without a turn is 0.4 m to the other side by its inverse, and so it is by the turned axes.
    elif name == "direction swapped":
        assert (degrees, mm) == pytest.approx((0, 800), abs=1e-6)


def test_groups_are_of_whole_scenes_with_named_cameras(tmp_path):
    for number, cameras in enumerate(
        (["left", "right"], ["left"], ["right", "left"], ["left", "right"])
    ):
        folder = tmp_path / f"test/{number:06d}"
        folder.mkdir(parents=True)
        about = {str(i): {"camera": camera} for i, camera in enumerate(cameras)}
        (folder / "scene_camera.json").write_text(json.dumps(about))
    [group] = rigs.groups(tmp_path, "test", 2)  # one image alone tells nothing; a rest is left over
    rgb = [tmp_path / f"test/{n:06d}/rgb" for n in (0, 2)]
    assert group == [
        f"left={rgb[0]}/000000.jpg", f"right={rgb[0]}/000001.jpg",
        f"right={rgb[1]}/000000.jpg", f"left={rgb[1]}/000001.jpg",
    ]  # fmt: skip
    (tmp_path / "test/000003/scene_camera.json").write_text('{"0": {}}')
    with pytest.raises(UserError, match="000003.*name of each image's camera"):
        rigs.groups(tmp_path, "test", 2)


def test_table_counts_what_was_said():
    named = "rig.json: `right` does not stand to the other cameras as the images show it; ..."
    lines = [
        {"lie": "true", "said": "", "before": [0, 0]},
        {"lie": "moved by 20 mm", "said": named, "before": [0, 20], "after": [0.1, 4]},
        {"lie": "moved by 20 mm", "said": "other", "before": [0, 20], "after": [0.3, 6]},
    ]
    rows = rigs.table(lines, "right").splitlines()
    assert rows[2] == "| true | 1 | 0 | 0 | 0 | 0.0°, 0 mm | – | – |"
    assert rows[3] == "| moved by 20 mm | 2 | 2 | 1 | 2 | 0.0°, 20 mm | 0.2°, 5 mm | 0.3°, 6 mm |"
