"""The lifecycle node: images of several cameras in, poses of parts out."""

import threading
import time
import warnings

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.time import Time
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

import mvtop
from mvtop_ros import parameters
from mvtop_ros.answers import PROBLEMS, Answers
from mvtop_ros.cameras import Cameras
from mvtop_ros.finder import BusyError, Finder
from mvtop_ros.frames import Frames
from mvtop_ros.newest import Newest
from mvtop_ros.publishers import LASTING, Publishers
from mvtop_ros.spinning import spin

# The same sentence is not logged more often, seconds.
_LOG_EVERY_S = 5.0
_MOST_SENTENCES = 1000


class PoseNode(LifecycleNode):
    """Finds parts in exposures of its cameras, continuously and when it is asked."""

    def __init__(self):
        super().__init__("mvtop")
        parameters.declare(self, parameters.NODE)
        self._said = {}
        self._newest = Newest()
        self._frames = self._answers = self._topics = None
        self._cameras = self._worker = self._tracks = None
        self._images = MutuallyExclusiveCallbackGroup()

    # Transitions.

    def on_configure(self, _state):
        try:
            self._values = values = parameters.read(self, parameters.NODE)
            parameters.check(values)
            estimator = mvtop.Estimator.load(values["model"] or None, threads=values["threads"])
            self._rig = mvtop.Rig.load(values["rig"]) if values["rig"] else None
            self._finder = Finder(estimator, values["waiting"])
            self.classes = {known.name: known for known in estimator.classes}
            self._wanted = mvtop.Request(classes=values["classes"] or None)
            reach = values["max_motion_m"] or None
            self._tracks = mvtop.Tracks(max_motion_m=reach) if values["track"] else None
            parameters.check_classes(values, self.classes)
        except PROBLEMS as problem:
            self.get_logger().error(str(problem))
            return TransitionCallbackReturn.FAILURE
        self._frames = Frames(values["tf_tolerance_s"])
        self._listeners = []
        if self._rig is None:
            self._listen("/tf", False, 100)
            self._listen("/tf_static", True, LASTING)
        self._topics = Publishers(self, values, self.classes)
        if self._rig is not None and values["publish_rig"]:
            self._topics.publish_rig(self._rig)
        self._answers = Answers(self, self._newest, values["timeout_s"])
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        self._newest.put(None)
        try:
            self._cameras = Cameras(
                self, self._values, self._rig, self._frames, self._newest.put, self._images
            )
        except PROBLEMS as problem:
            self.get_logger().error(str(problem))
            return TransitionCallbackReturn.FAILURE
        if self._values["continuous"]:
            self._worker = threading.Thread(target=self._work, args=(self._cameras,), daemon=True)
            self._worker.start()
        return super().on_activate(state)

    def on_deactivate(self, state):
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, _state):
        self._stop()
        if self._answers is not None:
            self._answers.close()
            self._topics.close()
            for listener in self._listeners:
                self.destroy_subscription(listener)
            self._answers = self._topics = self._finder = self._tracks = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state):
        return self.on_cleanup(state)

    def _stop(self):
        cameras, self._cameras = self._cameras, None
        if cameras is not None:
            cameras.close()
        if self._worker is not None:
            self._worker.join()
            self._worker = None

    def _listen(self, topic, is_static, qos):
        def take(message):
            for problem in self._frames.add(message, is_static):
                self.warn_sometimes(problem)

        listener = self.create_subscription(
            TFMessage, topic, take, qos, callback_group=self._images
        )
        self._listeners.append(listener)

    # What answers and publishes.

    def find(self, exposure, request):
        """The prediction of an exposure."""
        cameras, finder, tracks = self.refuse_inactive(), self._finder, self._tracks
        images, rig = cameras.images_and_rig(exposure)
        prediction = finder.find(images, rig, request, tracks)
        for warning in prediction.warnings:
            self.warn_sometimes(warning.message)
        return prediction

    def refuse_inactive(self):
        """The cameras of the active node."""
        cameras = self._cameras
        if cameras is None:
            raise LookupError("expected an active node, got an inactive one; activate it")
        return cameras

    def silent(self):
        """The cameras that have sent nothing for a while."""
        return self.refuse_inactive().silent()

    def header_of(self, exposure):
        """Of messages about an exposure, in the world frame."""
        stamp = Time(nanoseconds=round(exposure.stamp_s * 1e9)).to_msg()
        return Header(stamp=stamp, frame_id=self._values["world_frame"])

    def warn_sometimes(self, sentence):
        """Logs a sentence, but not again and again."""
        now = time.monotonic()
        if now - self._said.get(sentence, -_LOG_EVERY_S) < _LOG_EVERY_S:
            return
        if len(self._said) > _MOST_SENTENCES:
            self._said.clear()
        self._said[sentence] = now
        self.get_logger().warning(sentence)

    def _work(self, cameras):
        """Works on the newest exposure, again and again; those that come meanwhile are skipped."""
        done = 0
        while self._cameras is cameras:
            for name in cameras.missing():
                self.warn_sometimes(f"camera `{name}`: expected images, got none for a while")
            exposure = self._newest.after(done, 0.2)
            if exposure is None:
                continue
            done = exposure.number
            try:
                prediction = self.find(exposure, self._wanted)
                self._topics.publish(prediction, self.header_of(exposure))
            except BusyError:
                continue  # requests go first
            except PROBLEMS as problem:
                self.warn_sometimes(str(problem))
            except Exception as problem:  # the node must go on
                self.get_logger().error(f"prediction: {type(problem).__name__}: {problem}")


def main():
    """Runs the node until it is told to end."""
    warnings.simplefilter("ignore", mvtop.MvtopWarning)  # they are logged
    rclpy.init()
    node = PoseNode()

    def begin():
        if node.get_parameter("autostart").value:
            if node.trigger_configure() == TransitionCallbackReturn.SUCCESS:
                node.trigger_activate()

    # As many as may wait, and some for images.
    spin(node, node.get_parameter("waiting").value + 6, begin)


if __name__ == "__main__":
    main()
