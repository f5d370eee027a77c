"""Images and calibrations of the cameras, as they come."""

import time

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from mvtop_ros import images
from mvtop_ros.rigs import camera_of, rig_of
from mvtop_ros.synchroniser import Synchroniser


class Cameras:
    """Subscribes to the cameras, and hands over each exposure."""

    def __init__(self, node, values, rig, frames, on_exposure, group):
        """
        - values: of the node's parameters
        - rig: of a rig file, or None
        - on_exposure: called with each `Exposure`
        """
        self._node, self._rig, self._frames = node, rig, frames
        self._values, self._on_exposure = values, on_exposure
        self.names = values["cameras"] or [camera.id for camera in rig.cameras]
        self._check_names()
        self._is_raw = values["transport"] == "raw"
        ask_again, or_not = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
        self._qos = QoSProfile(depth=5, reliability=ask_again if values["reliable"] else or_not)
        self._infos = {}
        self._synchroniser = Synchroniser(
            self.names,
            slop_s=values["slop_s"],
            min_cameras=min(values["min_cameras"], len(self.names)),
            silent_after_s=values["silent_after_s"],
        )
        self._timer = node.create_timer(
            values["silent_after_s"] / 4, self._poll, callback_group=group
        )
        kind = Image if self._is_raw else CompressedImage
        self._subscriptions = []
        for name in self.names:
            topic = values["image_topic"].format(camera=name)
            topic += "" if self._is_raw else "/compressed"
            self._subscribe(kind, topic, self._take_image, name, group)
            if rig is None:
                topic = values["info_topic"].format(camera=name)
                self._subscribe(CameraInfo, topic, self._take_info, name, group)

    def _subscribe(self, kind, topic, take, name, group):
        self._subscriptions.append(
            self._node.create_subscription(
                kind,
                topic,
                lambda message: take(name, message),
                self._qos,
                callback_group=group,
            )
        )

    def close(self):
        """Ends the subscriptions."""
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def silent(self):
        """The cameras that have sent nothing for a while."""
        return self._synchroniser.silent(time.monotonic())

    def missing(self):
        """The cameras that send nothing while others do."""
        return self._synchroniser.missing(time.monotonic())

    def images_and_rig(self, exposure):
        """RGB images by camera and their rig; images that cannot be used are left out.

        Raises `ValueError` or `LookupError`, a sentence, where none can be, or too few.
        """
        usable, cameras, problems = {}, [], []
        for name, message in exposure.messages.items():
            try:
                camera = self._camera(name, exposure.stamp_s)
                decode = images.of_raw if self._is_raw else images.of_compressed
                usable[name] = decode(message, camera.size)
                cameras.append(camera)
            except (ValueError, LookupError) as problem:
                problems.append(f"camera `{name}`: {problem}")
        for problem in problems:
            self._node.warn_sometimes(problem)
        if len(usable) < min(self._values["min_cameras"], len(self.names)):
            raise ValueError(problems[0])
        return usable, self._rig if self._rig is not None else rig_of(cameras)

    def _take_image(self, name, message):
        if self._is_raw:
            try:
                images.check_raw(message)
            except ValueError as problem:
                self._node.warn_sometimes(f"camera `{name}`: {problem}")
                return
        stamp = message.header.stamp
        stamp_s = stamp.sec + 1e-9 * stamp.nanosec
        if stamp_s == 0:
            stamp_s = self._node.get_clock().now().nanoseconds * 1e-9
        exposure = self._synchroniser.add(name, stamp_s, time.monotonic(), message)
        if exposure is not None:
            self._on_exposure(exposure)

    def _poll(self):
        exposure = self._synchroniser.poll(time.monotonic())
        if exposure is not None:
            self._on_exposure(exposure)

    def _take_info(self, name, message):
        self._infos[name] = message

    def _camera(self, name, stamp_s):
        if self._rig is not None:
            return next(camera for camera in self._rig.cameras if camera.id == name)
        info = self._infos.get(name)
        if info is None:
            topic = self._values["info_topic"].format(camera=name)
            raise LookupError(f"expected its calibration on `{topic}`, got none yet; publish it")
        world_from_cam = self._frames.lookup(
            self._values["world_frame"], info.header.frame_id, stamp_s
        )
        return camera_of(name, info, world_from_cam, self._values["rectified"])

    def _check_names(self):
        if self._rig is None:
            return
        known = [camera.id for camera in self._rig.cameras]
        for name in self.names:
            if name not in known:
                raise ValueError(
                    f"cameras: expected cameras of the rig file ({', '.join(known)}), got `{name}`"
                )
