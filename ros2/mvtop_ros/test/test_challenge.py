"""The challenge's service over DDS, called as its tester calls it, by a process of its own."""

import numpy as np
import pytest
from conftest import error_of
from ibpc_interfaces.msg import Camera, Photoneo
from ibpc_interfaces.srv import GetPoseEstimates
from mvtop_ros.transforms import of_pose, to_pose
from sensor_msgs.msg import Image

IDS = {"cracker_box": 2, "soup_can": 4, "mustard_bottle": 5, "potted_meat_can": 9}


@pytest.fixture(scope="module")
def node(run, parts):
    return run("challenge", model_dir=parts.model)


@pytest.fixture
def service(node, client):
    return client.service(GetPoseEstimates, "/get_pose_estimates")


def image(array, encoding):
    height, width = array.shape[:2]
    step = array.nbytes // height
    return Image(height=height, width=width, encoding=encoding, step=step, data=array.tobytes())


def view(kind, camera, picture):
    """As the challenge's tester fills it: of the calibration k alone, world to camera in mm."""
    message = kind()
    message.info.header.frame_id = camera.id
    message.info.k = camera.K.ravel()
    message.pose = to_pose(np.linalg.inv(camera.world_from_cam), 1e-3)
    message.rgb = picture
    return message


def asked(parts, ids, picture_of):
    """One of the cameras is the photoneo."""
    *cameras, last = parts.rig.cameras
    request = GetPoseEstimates.Request(object_ids=ids)
    for camera in cameras:
        request.cameras.append(view(Camera, camera, picture_of(parts.images[camera.id])))
    request.photoneo = view(Photoneo, last, picture_of(parts.images[last.id]))
    return request


def in_color(array):
    return image(np.ascontiguousarray(array[..., ::-1]), "bgr8")


def first_channel(array):
    return image(np.ascontiguousarray(array[..., 0]), "8UC1")


def assert_right(estimates, parts, ids):
    """Poses of world frame in mm, within 5 degrees and 5 mm of the truth."""
    classes = {number: name for name, number in IDS.items()}
    assert sorted(one.obj_id for one in estimates) == sorted(ids)
    for one in estimates:
        degrees, metres = error_of(of_pose(one.pose, 1e-3), parts.truth[classes[one.obj_id]])
        assert degrees < 5 and metres < 0.005, (classes[one.obj_id], degrees, metres)
        assert 0.5 < one.score <= 1


def test_poses_of_all_parts_are_right(client, service, parts):
    ids = list(IDS.values())
    answer = client.call(service, asked(parts, ids, in_color), 120)
    assert_right(answer.pose_estimates, parts, ids)


def test_a_channel_alone_is_enough_where_shape_tells(client, service, parts):
    answer = client.call(service, asked(parts, [9], first_channel), 120)
    assert_right(answer.pose_estimates, parts, [9])


def test_only_what_is_asked_for_is_given(client, service, parts):
    answer = client.call(service, asked(parts, [5, 77], in_color), 120)
    assert_right(answer.pose_estimates, parts, [5])
    assert not client.call(service, asked(parts, [], in_color)).pose_estimates
    assert not client.call(service, asked(parts, [77], in_color)).pose_estimates


def test_camera_that_lies_about_its_size_is_left_out(client, service, parts):
    request = asked(parts, [2, 5, 9], in_color)
    request.cameras[0].rgb.height *= 1000
    answer = client.call(service, request, 120)
    assert_right(answer.pose_estimates, parts, [2, 5, 9])


@pytest.mark.parametrize("mistake", ["no images", "no calibration", "no pose", "no cameras"])
def test_requests_without_a_usable_camera_are_answered_by_nothing(client, service, parts, mistake):
    request = asked(parts, [5], in_color)
    for source in [*request.cameras, request.photoneo]:
        if mistake == "no images":
            source.rgb = Image()
        elif mistake == "no calibration":
            source.info.k = np.zeros(9)
        elif mistake == "no pose":
            source.pose.orientation.w = float("nan")
    if mistake == "no cameras":
        request.cameras, request.photoneo = [], Photoneo()
    assert not client.call(service, request).pose_estimates


def test_two_requests_at_once_are_both_answered(client, service, parts):
    wanted = [[5], [2]]
    futures = [service.call_async(asked(parts, ids, in_color)) for ids in wanted]
    for ids, future in zip(wanted, futures, strict=True):
        assert_right(client.answer(future, 120).pose_estimates, parts, ids)


def test_node_without_a_model_says_what_to_set(run):
    process = run("challenge")
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "model_dir: expected the folder of a model, got none; set it" in output
    assert "Traceback" not in output
