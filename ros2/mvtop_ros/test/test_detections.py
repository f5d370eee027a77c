"""What is published of a prediction, and what a request says."""

import numpy as np
import pytest
from conftest import error_of
from mvtop_interfaces.srv import FindPoses
from mvtop_ros import detections, parameters
from mvtop_ros.requests import is_accepted, request_of
from mvtop_ros.transforms import of_pose, of_transform
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

import mvtop


@pytest.fixture(scope="module")
def estimator():
    return mvtop.Estimator.load("mvball")


@pytest.fixture(scope="module")
def prediction(estimator, ball):
    return estimator.predict(ball.images, ball.rig)


@pytest.fixture(scope="module")
def classes(estimator):
    return {known.name: known for known in estimator.classes}


HEADER = Header(frame_id="world")


def test_detections_have_poses_scores_and_covariances(prediction, classes, ball):
    (one,) = detections.detections_of(prediction, HEADER, classes).detections
    (found,) = prediction
    assert len(one.results) == len(found.hypotheses) and one.id == ""
    first = one.results[0]
    assert first.hypothesis.class_id == "mvball"
    assert first.hypothesis.score == pytest.approx(found.confidence)
    assert sum(result.hypothesis.score for result in one.results) <= 1.0001
    degrees, metres = error_of(of_pose(first.pose.pose), ball.truth["mvball"])
    assert degrees < 5 and metres < 0.005
    covariance = np.array(first.pose.covariance).reshape(6, 6)
    assert np.array_equal(covariance, np.diag(np.diag(covariance)))
    np.testing.assert_allclose(np.diag(covariance)[:3], found.hypotheses[0].sigma.t_m ** 2)


def test_covariance_of_turns_gives_the_expected_angle():
    rng = np.random.default_rng(0)
    variance = detections.covariance_of(mvtop.Sigma(rot_deg=2.0, t_m=0.001))[21]
    angles = np.linalg.norm(rng.normal(scale=np.sqrt(variance), size=(100_000, 3)), axis=1)
    assert np.degrees(angles).mean() == pytest.approx(2.0, rel=0.01)


def test_boxes_hold_the_points_of_the_class(prediction, classes):
    (one,) = detections.detections_of(prediction, HEADER, classes).detections
    (found,) = prediction
    points = classes["mvball"].points @ found.world_from_obj[:3, :3].T + found.world_from_obj[:3, 3]
    box = of_pose(one.bbox.center)
    inside = np.abs((points - box[:3, 3]) @ box[:3, :3])
    size = np.array([one.bbox.size.x, one.bbox.size.y, one.bbox.size.z])
    assert (inside <= size / 2 + 1e-9).all()
    np.testing.assert_allclose(inside.max(axis=0), size / 2, atol=1e-9)


def test_frames_and_markers_follow_the_objects(prediction, classes):
    (transform,) = detections.transforms_of(prediction, HEADER).transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "mvball_0")
    np.testing.assert_allclose(
        of_transform(transform.transform), prediction[0].world_from_obj, atol=1e-9
    )
    first, *others = detections.markers_of(prediction, HEADER, classes).markers
    assert first.action == Marker.DELETEALL
    assert [marker.type for marker in others] == [Marker.CUBE, Marker.TEXT_VIEW_FACING]
    assert others[1].text.startswith("mvball 9")
    nothing = detections.markers_of(prediction[:0], HEADER, classes).markers
    assert [marker.action for marker in nothing] == [Marker.DELETEALL]


def test_followed_objects_are_named_by_their_number(estimator, classes, ball):
    tracks = mvtop.Tracks()
    for _ in range(2):
        prediction = estimator.predict(ball.images, ball.rig, tracks=tracks)
        (one,) = detections.detections_of(prediction, HEADER, classes).detections
        (transform,) = detections.transforms_of(prediction, HEADER).transforms
        assert one.id == transform.child_frame_id == "mvball_1"


def test_cameras_of_a_rig_file_are_frames(ball):
    transforms = detections.transforms_of_rig(ball.rig, HEADER).transforms
    assert [one.child_frame_id for one in transforms] == ["cam0", "cam1"]
    for one, camera in zip(transforms, ball.rig.cameras, strict=True):
        np.testing.assert_allclose(of_transform(one.transform), camera.world_from_cam, atol=1e-9)


def test_fields_of_a_request_replace_its_json():
    asked = FindPoses.Request(request='{"most": 3, "frame": "world"}', classes=["nut"], most=1)
    assert request_of(asked) == mvtop.Request(classes=["nut"], most=1, frame="world")
    assert request_of(FindPoses.Request()) == mvtop.Request()
    with pytest.raises(ValueError, match="request: expected JSON"):
        request_of(FindPoses.Request(request="nut"))


def test_accepted_is_what_has_that_confidence(estimator, prediction, ball):
    assert is_accepted(prediction, mvtop.Request())
    for least, accepted in ((0.5, True), (1.0, False)):
        request = mvtop.Request(min_confidence=least)
        found = estimator.predict(ball.images, ball.rig, request=request)
        assert is_accepted(found, request) == accepted
    assert not is_accepted(prediction[:0], mvtop.Request())


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"transport": "h264"}, "transport: expected one of raw, compressed"),
        ({"image_topic": "/image"}, "image_topic: expected a topic with"),
        ({"cameras": []}, "cameras: expected names of cameras or a rig file"),
        ({"cameras": ["a", "a"]}, "cameras: expected each name once"),
    ],
)
def test_parameters_that_cannot_be_meant_are_refused(changed, sentence):
    values = {name: one.default for name, one in parameters.NODE.items()} | {"cameras": ["a"]}
    parameters.check(values)
    with pytest.raises(ValueError, match=sentence):
        parameters.check(values | changed)
