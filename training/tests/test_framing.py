"""Light and framing: what is done to images, that calibrations stay true, what poses become."""

import json
from pathlib import Path

import numpy as np
import pytest

from mvtop_train.errors import UserError
from mvtop_train.evaluation.shots import Shot, Shots
from mvtop_train.study import framing

REPO = Path(__file__).parents[2]
SAMPLE = REPO / "examples/mvball"


@pytest.fixture(scope="module")
def shots():
    return framing.read(SAMPLE)


def disturbed(name: str, shots: Shots) -> Shots:
    return framing.CASES[name](shots, np.random.default_rng(1))


def pixel(shot: Shot, world: np.ndarray) -> np.ndarray:
    """Where a camera sees a point in the world, px."""
    in_cam = np.linalg.inv(shot.world_from_cam) @ np.append(world, 1)
    return (shot.k @ in_cam[:3])[:2] / in_cam[2]


@pytest.mark.parametrize("name", ["grey border to 1280x720", "all cameras upside down"])
def test_what_a_pixel_shows_stays_where_the_calibration_has_it(name, shots):
    changed = disturbed(name, shots)
    for before, after in zip(shots, changed, strict=True):
        for u, v in [(100, 50), (400, 300), (630, 470)]:
            ray = np.linalg.inv(before.k) @ [u, v, 1]
            world = (before.world_from_cam @ np.append(0.8 * ray, 1))[:3]
            np.testing.assert_allclose(pixel(before, world), [u, v], atol=1e-9)
            there = pixel(after, world)
            column, row = np.round(there).astype(int)
            np.testing.assert_allclose(there, [column, row], atol=1e-9)
            np.testing.assert_array_equal(after.image[row, column], before.image[v, u])


def test_light_and_noise_are_what_their_names_say(shots):
    before = shots[0].image.astype(float)
    half = disturbed("half as bright", shots)[0].image
    assert np.abs(half - before / 2).max() <= 0.5
    brighter = disturbed("1.5 times as bright", shots)[0].image
    assert np.abs(brighter - np.minimum(1.5 * before, 255)).max() <= 0.5
    noisy = disturbed("noise of 10 of 255", shots)[0].image
    middle = (before > 60) & (before < 195)
    assert (noisy - before)[middle].std() == pytest.approx(10, rel=0.02)
    one = disturbed("one camera upside down", shots)
    assert one[0] is shots[0] and not np.array_equal(one[1].image, shots[1].image)


def test_the_example_is_found_in_every_light_and_frame(tmp_path):
    out = tmp_path / "framing.jsonl"
    lines = framing.measure([SAMPLE], REPO / "models/mvball", out)
    assert len(lines) == len(framing.CASES) * len(framing.WAYS)
    for line in lines:
        assert line["found"] and line["boxes"] == 2, line
        assert line["rot_deg"] < 10 and line["t_m"] < 5e-3, line
    assert framing.table(lines).count("\n") == 2 + len(lines)
    # What is there is not measured again.
    before = out.read_text()
    again = framing.measure([SAMPLE], REPO / "models/mvball", out)
    assert out.read_text() == before
    assert [json.dumps(line) for line in again] == before.splitlines()


def test_folders_without_samples_are_refused(tmp_path):
    (tmp_path / "rig.json").write_text("{}")
    with pytest.raises(UserError, match=r"rig.json.*; fix: --samples"):
        framing.read(tmp_path)
