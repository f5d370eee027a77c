"""Rigs against images, with the shipped model and its example."""

import numpy as np
import pytest
from conftest import ROOT

import mvtop

EXAMPLE = ROOT / "examples/mvball"


@pytest.fixture(scope="module")
def ball():
    return mvtop.Estimator.load(ROOT / "models/mvball")


@pytest.fixture(scope="module")
def true_rig():
    return mvtop.Rig.load(EXAMPLE / "rig.json")


@pytest.fixture(scope="module")
def images():
    return [EXAMPLE / "cam0.png", EXAMPLE / "cam1.png"]


def test_true_rig_is_not_contradicted(ball, true_rig, images):
    check = ball.check_rig([images], true_rig)
    assert check.problem is None and check.off == []
    assert (check.objects, check.agreeing) == (1, 1)
    assert repr(check) == "RigCheck(no camera was found to be off)"
    (pair,) = check.pairs
    assert pair == ("cam0", "cam1") and 0.0 < check.pairs[pair] < 1.0
    (camera,) = check.corrections()
    assert camera.camera == "cam1" and not camera.is_off
    # Within what it is known to, and a rigid transform.
    assert camera.deviation < 3.0
    rotation = camera.cam_from_shown[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.norm(camera.cam_from_shown[:3, 3]) < 4.5 * camera.shift_sd_m
    # Told from the other camera, it is that one that is compared.
    assert [other.camera for other in check.corrections("cam1")] == ["cam0"]
    with pytest.raises(ValueError, match="base: no camera `wrist`"):
        check.corrections("wrist")
    # Cameras that are not off are left alone.
    with pytest.raises(ValueError, match="do not contradict the rig"):
        check.refined()


def test_rig_in_the_other_direction_is_refused(ball, true_rig, images):
    swapped = mvtop.Rig(
        [
            mvtop.Camera(
                camera.K,
                camera.size,
                distortion=camera.distortion,
                world_from_cam=np.linalg.inv(camera.world_from_cam),
                id=camera.id,
            )
            for camera in true_rig.cameras
        ]
    )
    with pytest.raises(ValueError, match="fit the images if read in the other direction"):
        ball.check_rig([images], swapped)


def test_what_does_not_fit_is_refused(ball, true_rig, images):
    alone = mvtop.Rig(true_rig.cameras[:1])
    with pytest.raises(ValueError, match="two cameras or more"):
        ball.check_rig([images[:1]], alone)
    with pytest.raises(ValueError, match="images: expected 2"):
        ball.check_rig([images, images[:1]], true_rig)
    with pytest.raises(ValueError, match="shift_sd_m: expected a number above 0"):
        ball.check_rig([images], true_rig, shift_sd_m=0.0)
    with pytest.raises(ValueError, match="rig: expected a mvtop.Rig"):
        ball.check_rig([images], str(EXAMPLE / "rig.json"))
    with pytest.raises(ValueError, match="expected objects that two cameras see"):
        black = np.zeros((480, 640, 3), np.uint8)
        ball.check_rig([[black, black]], true_rig)
