"""Transforms, the tree of frames, and cameras from calibrations."""

import numpy as np
import pytest
from geometry_msgs.msg import Pose, Quaternion, TransformStamped
from mvtop_ros.frames import Frames
from mvtop_ros.rigs import camera_of, rig_of
from mvtop_ros.transforms import of_pose, quaternion_of, rotation_of, to_pose, to_transform
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage


def turn(axis, degrees, translation=(0, 0, 0)):
    """About x, y or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    pose = np.eye(4)
    i, j = [("x", 1, 2), ("y", 2, 0), ("z", 0, 1)]["xyz".index(axis)][1:]
    pose[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    pose[:3, 3] = translation
    return pose


def message(parent, child, pose, seconds=0.0):
    one = TransformStamped(child_frame_id=child, transform=to_transform(pose))
    one.header.frame_id = parent
    one.header.stamp.sec, one.header.stamp.nanosec = divmod(round(seconds * 1e9), 10**9)
    return TFMessage(transforms=[one])


def test_quaternions_are_those_of_the_textbook():
    half = np.sqrt(0.5)
    np.testing.assert_allclose(quaternion_of(turn("z", 90)[:3, :3]), [0, 0, half, half])
    np.testing.assert_allclose(
        np.abs(quaternion_of(turn("y", 180)[:3, :3])), [0, 1, 0, 0], atol=1e-9
    )
    rng = np.random.default_rng(0)
    for q in rng.normal(size=(200, 4)):
        q /= np.linalg.norm(q) * (1 if q[3] > 0 else -1)
        np.testing.assert_allclose(quaternion_of(rotation_of(q)), q, atol=1e-9)


def test_poses_keep_their_unit():
    pose = turn("x", 30, (0.1, -0.2, 0.3))
    message = to_pose(pose, 1e-3)
    np.testing.assert_allclose(
        [message.position.x, message.position.y, message.position.z], [100, -200, 300]
    )
    np.testing.assert_allclose(of_pose(message, 1e-3), pose, atol=1e-9)


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (0, 0, 0, 5), (float("nan"), 0, 0, 1)])
def test_quaternions_that_are_none_are_refused(q):
    x, y, z, w = map(float, q)
    with pytest.raises(ValueError, match="expected a unit quaternion"):
        of_pose(Pose(orientation=Quaternion(x=x, y=y, z=z, w=w)))


def test_frames_are_linked_through_the_tree():
    frames = Frames(0.5)
    world_from_a, a_from_b, world_from_c = turn("z", 90, (1, 0, 0)), turn("x", 45), turn("y", 10)
    frames.add(message("world", "a", world_from_a), True)
    frames.add(message("/a", "/b", a_from_b), True)
    frames.add(message("world", "c", world_from_c), True)
    expected = np.linalg.inv(world_from_c) @ world_from_a @ a_from_b
    np.testing.assert_allclose(frames.lookup("c", "b", 7.0), expected, atol=1e-9)
    np.testing.assert_allclose(frames.lookup("b", "b", 7.0), np.eye(4), atol=1e-9)


def test_moving_frames_are_interpolated_at_the_time_of_the_images():
    frames = Frames(0.5)
    frames.add(message("world", "arm", turn("z", 0), 10.0), False)
    frames.add(message("world", "arm", turn("z", 60, (0.2, 0, 0)), 11.0), False)
    got = frames.lookup("world", "arm", 10.25)
    np.testing.assert_allclose(got, turn("z", 15, (0.05, 0, 0)), atol=1e-9)
    np.testing.assert_allclose(frames.lookup("world", "arm", 11.4)[0, 3], 0.2)
    with pytest.raises(LookupError, match="within 0.5 s of the images, the nearest is 1.000 s off"):
        frames.lookup("world", "arm", 12.0)


def test_frames_without_a_link_and_loops_are_named():
    frames = Frames(0.5)
    with pytest.raises(LookupError, match="link frame `cam` to `world`"):
        frames.lookup("world", "cam", 0.0)
    frames.add(message("a", "b", np.eye(4)), True)
    frames.add(message("b", "a", np.eye(4)), True)
    with pytest.raises(LookupError, match="loop"):
        frames.lookup("world", "a", 0.0)


def test_transforms_that_are_none_are_left_out():
    frames = Frames(0.5)
    bad = message("world", "cam", np.eye(4))
    bad.transforms[0].transform.rotation.w = 0.0
    (problem,) = frames.add(bad, True)
    assert "from cam to world" in problem
    with pytest.raises(LookupError):
        frames.lookup("world", "cam", 0.0)


def info(**changed):
    values = {
        "width": 640, "height": 480, "distortion_model": "plumb_bob",
        "d": [0.1, 0.0, 0.0, 0.0, 0.0], "k": [600.0, 0, 320, 0, 610, 240, 0, 0, 1],
        "p": [500.0, 0, 310, 0, 0, 500, 230, 0, 0, 0, 1, 0], "r": turn("z", 5)[:3, :3].ravel(),
    }  # fmt: skip
    made = CameraInfo()
    for name, value in {**values, **changed}.items():
        setattr(made, name, value)
    return made


def test_cameras_are_those_of_camera_info():
    pose = turn("y", 20, (0.1, 0.2, 0.3))
    camera = camera_of("left", info(), pose)
    assert (camera.id, camera.size, camera.model) == ("left", (640, 480), "pinhole")
    np.testing.assert_allclose(camera.K, [[600, 0, 320], [0, 610, 240], [0, 0, 1]])
    np.testing.assert_allclose(camera.distortion[:5], [0.1, 0, 0, 0, 0])
    np.testing.assert_allclose(camera.world_from_cam, pose, atol=1e-9)
    fisheye = info(distortion_model="equidistant", d=[0.01, 0.0, 0.0, 0.0])
    assert camera_of("left", fisheye, pose).model == "fisheye"
    assert len(rig_of([camera])) == 1


def test_rectified_cameras_are_turned_by_the_rectification():
    pose = turn("y", 20)
    camera = camera_of("left", info(), pose, rectified=True)
    np.testing.assert_allclose(camera.K, [[500, 0, 310], [0, 500, 230], [0, 0, 1]])
    assert len(camera.distortion) == 0
    np.testing.assert_allclose(camera.world_from_cam, pose @ turn("z", -5), atol=1e-9)


@pytest.mark.parametrize(
    ("changed", "rectified", "sentence"),
    [
        ({"k": [0.0] * 9}, False, "expected a calibrated camera"),
        ({"d": [0.1] * 3}, False, "expected 0 or 4 or 5 coefficients"),
        ({"distortion_model": "cylinder"}, False, "distortion_model"),
        ({"binning_x": 2}, False, "without binning"),
        ({"p": [500.0, 0, 310, -50, 0, 500, 230, 0, 0, 0, 1, 0]}, True, "stereo"),
        ({"width": 0}, False, "left"),
    ],
)
def test_calibrations_that_cannot_be_used_are_refused(changed, rectified, sentence):
    with pytest.raises(ValueError, match=sentence):
        camera_of("left", info(**changed), np.eye(4), rectified)
