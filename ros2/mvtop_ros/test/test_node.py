"""The lifecycle node over DDS: cameras are played by the test, the node is a process of its own."""

import json
import time

import numpy as np
import pytest
from conftest import error_of
from geometry_msgs.msg import TransformStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mvtop_interfaces.action import FindPoses as FindPosesAction
from mvtop_interfaces.srv import FindPoses
from mvtop_ros.transforms import of_pose, of_transform, to_transform
from rcl_interfaces.srv import DescribeParameters
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3DArray
from visualization_msgs.msg import MarkerArray

LASTING = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Played:
    """Cameras of an example that send their images again and again."""

    def __init__(self, client, example, compressed=False):
        self._client, self._example, self._compressed = client, example, compressed
        kind, end = (CompressedImage, "/compressed") if compressed else (Image, "")
        self.stopped, self.lying, self.moved = set(), set(), 0
        make = client.node.create_publisher
        ids = [camera.id for camera in example.rig.cameras]
        self._images = {name: make(kind, f"/{name}/image_raw{end}", 5) for name in ids}
        self._infos = {name: make(CameraInfo, f"/{name}/camera_info", 5) for name in ids}
        self._tf = make(TFMessage, "/tf_static", LASTING)
        self._timer = client.node.create_timer(0.2, self._send)

    def publish_tf(self):
        message = TFMessage()
        for camera in self._example.rig.cameras:
            one = TransformStamped(child_frame_id=f"{camera.id}_optical")
            one.header.frame_id = "cell"
            one.transform = to_transform(camera.world_from_cam)
            message.transforms.append(one)
        self._tf.publish(message)

    def close(self):
        self._client.node.destroy_timer(self._timer)

    def _send(self):
        stamp = self._client.node.get_clock().now().to_msg()
        for camera in self._example.rig.cameras:
            if camera.id in self.stopped:
                continue
            info = CameraInfo(width=camera.size[0], height=camera.size[1])
            info.distortion_model, info.k = "plumb_bob", camera.K.ravel()
            info.header.frame_id, info.header.stamp = f"{camera.id}_optical", stamp
            self._infos[camera.id].publish(info)
            message = self._message(camera.id)
            message.header.stamp = stamp
            self._images[camera.id].publish(message)

    def _message(self, name):
        if self._compressed:
            return CompressedImage(format="png", data=self._example.files[name].read_bytes())
        array = np.roll(self._example.images[name], self.moved, axis=1)
        height, width = array.shape[:2]
        claimed = height * 4 if name in self.lying else height
        return Image(
            height=claimed, width=width, encoding="rgb8", step=3 * width, data=array.tobytes()
        )


@pytest.fixture
def played(node, client, ball):
    """Cameras that have sent for a while, so that all are waited for."""
    made = Played(client, ball)
    client.until(lambda: client.node.count_subscribers("/cam1/image_raw"))
    client.turn(1.5)
    yield made
    made.close()


@pytest.fixture(scope="module")
def node(run, ball):
    return run(
        "node", rig=ball.folder / "rig.json", reliable=True, silent_after_s=2.0, timeout_s=5.0,
    )  # fmt: skip


@pytest.fixture
def service(node, client):
    return client.service(FindPoses, "/mvtop/find_poses")


def assert_right(message, ball):
    """The ball is within 5 degrees and 5 mm of the truth."""
    (one,) = message.detections
    first = one.results[0]
    degrees, metres = error_of(of_pose(first.pose.pose), ball.truth["mvball"])
    assert first.hypothesis.class_id == "mvball" and first.hypothesis.score > 0.5
    assert degrees < 5 and metres < 0.005


def heard(client, kind, topic, qos=10):
    """A list that messages are added to."""
    messages = []
    client.node.create_subscription(kind, topic, messages.append, qos)
    return messages


NEW = FindPoses.Request(wait_for_new=True)


def until_views(client, service, count):
    """Asks until an answer is of so many cameras: a slow machine loses some images of some."""
    end = time.monotonic() + 60
    while True:
        answer = client.call(service, NEW)
        assert answer.success, answer.message
        (found,) = json.loads(answer.report)["objects"]
        if len(found["cameras"]) == count:
            return answer
        assert time.monotonic() < end, f"expected {count} views in time"


def test_detections_frames_and_markers_are_published(service, client, played, ball):
    found = heard(client, Detection3DArray, "/mvtop/detections")
    marked = heard(client, MarkerArray, "/mvtop/markers")
    tf = heard(client, TFMessage, "/tf")
    static = heard(client, TFMessage, "/tf_static", LASTING)
    client.until(lambda: found and marked and tf and static)
    # One camera may have been heard before the other.
    client.until(
        lambda: found[-1].detections and found[-1].detections[0].results[0].hypothesis.score > 0.5
    )
    assert found[-1].header.frame_id == "world" and found[-1].header.stamp.sec > 0
    assert_right(found[-1], ball)
    transform = tf[-1].transforms[0]
    assert transform.child_frame_id in {one.id for all in found for one in all.detections}
    assert error_of(of_transform(transform.transform), ball.truth["mvball"])[1] < 0.005
    assert [one.child_frame_id for one in static[0].transforms] == ["cam0", "cam1"]


def test_service_answers_what_is_asked(service, client, played, ball):
    asked = FindPoses.Request(classes=["mvball"], min_confidence=0.5, request='{"frame": "cam1"}')
    until_views(client, service, 2)
    answer = client.call(service, asked)
    assert answer.success and answer.accepted and not answer.message
    assert answer.detections.detections[0].id.startswith("mvball_")
    assert_right(answer.detections, ball)
    report = json.loads(answer.report)
    assert report["frame"] == "cam1" and report["objects"][0]["verdict"] == "accept"


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"classes": ["nut"]}, "no class `nut`"),
        ({"request": "{"}, "request: expected JSON"),
        ({"request": '{"frame": "base"}'}, "T_base_world"),
        ({"min_confidence": 2.0}, "expected a probability from 0 to 1"),
    ],
)
def test_wrong_requests_are_answered_by_one_sentence(service, client, played, asked, sentence):
    answer = client.call(service, FindPoses.Request(**asked))
    assert not answer.success and sentence in answer.message
    assert "\n" not in answer.message


def test_two_requests_at_once_get_their_own_answers(service, client, played):
    until_views(client, service, 2)
    asked = [FindPoses.Request(request=f'{{"frame": "{frame}"}}') for frame in ("cam0", "cam1")]
    futures = [service.call_async(one) for one in asked]
    for future, frame in zip(futures, ("cam0", "cam1"), strict=True):
        answer = client.answer(future)
        assert answer.success, answer.message
        assert json.loads(answer.report)["frame"] == frame


def test_camera_that_stops_is_done_without_and_taken_up_again(service, client, played):
    until_views(client, service, 2)
    played.stopped.add("cam1")
    until_views(client, service, 1)
    played.stopped.clear()
    until_views(client, service, 2)


def test_message_that_lies_about_its_size_is_survived(service, client, played, ball):
    played.lying.add("cam0")
    until_views(client, service, 1)
    played.lying.clear()
    assert_right(until_views(client, service, 2).detections, ball)


def test_no_images_are_answered_by_which_cameras_are_silent(service, client, node):
    client.turn(5.0)
    answer = client.call(service, NEW)
    assert not answer.success
    assert "expected images of one moment within 5.0 s" in answer.message
    assert "cam0, cam1" in answer.message
    assert node.poll() is None


def test_action_says_how_far_it_is_and_can_be_cancelled(service, client, played):
    action = ActionClient(client.node, FindPosesAction, "/mvtop/find_poses_action")
    assert action.wait_for_server(timeout_sec=30)
    until_views(client, service, 2)
    stages = []
    goal = FindPosesAction.Goal(wait_for_new=True)
    sent = action.send_goal_async(goal, lambda message: stages.append(message.feedback.stage))
    result = client.answer(client.answer(sent).get_result_async()).result
    assert result.success and result.accepted
    assert [one.results[0].hypothesis.class_id for one in result.detections.detections] == [
        "mvball"
    ]
    assert stages[0] == "waiting" and stages[-1] == "predicting"
    played.stopped.update(["cam0", "cam1"])
    client.turn(5.0)
    handle = client.answer(action.send_goal_async(goal))
    client.answer(handle.cancel_goal_async())
    began = time.monotonic()
    result = client.answer(handle.get_result_async()).result
    assert not result.success and "cancellation" in result.message
    assert time.monotonic() - began < 4
    action.destroy()


@pytest.fixture
def go(node, client):
    """Changes the node's state."""
    change = client.service(ChangeState, "/mvtop/change_state")

    def transit(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return client.call(change, request).success

    return transit


def test_ids_are_an_object_s_own_until_cleanup(service, client, played, go):
    def id_of_one_view():
        (one,) = until_views(client, service, 1).detections.detections
        return one.id

    played.stopped.add("cam1")
    first = id_of_one_view()
    assert id_of_one_view() == first
    # Farther than half its diameter; an image of before may still be on its way.
    played.moved = 100
    client.turn(2.0)
    second = id_of_one_view()
    assert second != first
    assert go(Transition.TRANSITION_DEACTIVATE) and go(Transition.TRANSITION_ACTIVATE)
    assert id_of_one_view() == second
    assert go(Transition.TRANSITION_DEACTIVATE) and go(Transition.TRANSITION_CLEANUP)
    assert go(Transition.TRANSITION_CONFIGURE) and go(Transition.TRANSITION_ACTIVATE)
    service = client.service(FindPoses, "/mvtop/find_poses")
    assert id_of_one_view() == "mvball_1" != second


def test_inactive_node_says_so_and_can_be_activated_again(service, client, played, go):
    assert go(Transition.TRANSITION_DEACTIVATE)
    answer = client.call(service, NEW)
    assert not answer.success and "activate it" in answer.message
    assert go(Transition.TRANSITION_CLEANUP)
    assert go(Transition.TRANSITION_CONFIGURE) and go(Transition.TRANSITION_ACTIVATE)
    service = client.service(FindPoses, "/mvtop/find_poses")
    until_views(client, service, 2)


def test_parameters_are_described_with_their_bounds(node, client):
    describe = client.service(DescribeParameters, "/mvtop/describe_parameters")
    names = ["slop_s", "min_cameras", "transport"]
    slop, fewest, transport = client.call(
        describe, DescribeParameters.Request(names=names)
    ).descriptors
    slop, fewest = slop.floating_point_range[0], fewest.integer_range[0]
    assert (slop.from_value, slop.to_value) == (0, 10)
    assert (fewest.from_value, fewest.to_value) == (1, 64)
    assert transport.additional_constraints == "raw, compressed" and transport.description


def test_camera_info_and_tf_are_a_rig_too(run, client, ball):
    run(
        "node", name="by_tf", cameras="[cam0, cam1]", world_frame="cell", transport="compressed",
        min_cameras=2, continuous=False, publish_tf=False, reliable=True,
    )  # fmt: skip
    service = client.service(FindPoses, "/by_tf/find_poses")
    played = Played(client, ball, compressed=True)
    client.until(lambda: client.node.count_subscribers("/cam0/image_raw/compressed"), 60)
    client.turn(1.0)
    answer = client.call(service, NEW)
    assert not answer.success and "link frame `cam0_optical` to `cell`" in answer.message
    played.publish_tf()
    client.turn(1.0)
    answer = client.call(service, NEW)
    assert answer.success, answer.message
    assert answer.detections.header.frame_id == "cell"
    assert_right(answer.detections, ball)
    played.close()


def test_wrong_parameters_leave_the_node_unconfigured_with_a_sentence(run):
    process = run("node", name="wrong", cameras="[cam0]", transport="h264")
    for line in process.stdout:
        assert "Traceback" not in line
        if "transport: expected one of raw, compressed, got `h264`" in line:
            break
    else:
        pytest.fail("expected a sentence")
