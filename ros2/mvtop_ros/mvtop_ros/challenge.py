"""The node of the bin-picking challenge: `/get_pose_estimates`, as github.com/opencv/bpc fixed it.

Camera poses come from world to camera, and all lengths are millimetres.
"""

import time
import warnings

import numpy as np
import rclpy
from ibpc_interfaces.msg import PoseEstimate
from ibpc_interfaces.srv import GetPoseEstimates
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

import mvtop
from mvtop_ros import images, parameters
from mvtop_ros.finder import BusyError, Finder
from mvtop_ros.rigs import rig_of
from mvtop_ros.spinning import spin
from mvtop_ros.transforms import of_pose, to_pose

METRES = 1e-3


def views_of(request, use_photoneo):
    """RGB images by camera, the rig, and a sentence for each camera that is left out."""
    pictures, cameras, problems = {}, [], []
    sources = list(request.cameras)
    if use_photoneo and request.photoneo.rgb.data:
        sources.append(request.photoneo)
    for number, source in enumerate(sources):
        name = source.info.header.frame_id or f"cam{number}"
        try:
            if name in pictures:
                raise ValueError("expected each name once, got it twice")
            picture = images.of_raw(source.rgb)
            cam_from_world = of_pose(source.pose, METRES)
            height, width = picture.shape[:2]
            K = np.array(source.info.k, np.float64).reshape(3, 3)
            camera = mvtop.Camera(
                K, (width, height), world_from_cam=np.linalg.inv(cam_from_world), id=name
            )
        except ValueError as problem:
            problems.append(f"camera `{name}`: {problem}")
            continue
        pictures[name] = picture
        cameras.append(camera)
    if not cameras:
        raise ValueError(problems[0] if problems else "cameras: expected one or more, got none")
    return pictures, rig_of(cameras), problems


def estimates_of(prediction, least):
    """The answer's list: objects in the world frame, of at least this confidence."""
    given = []
    for found in prediction:
        sure = found.score if found.confidence is None else found.confidence
        if sure < least:
            continue
        one = PoseEstimate(obj_id=found.class_id, score=float(sure))
        one.pose = to_pose(found.world_from_obj, METRES)
        given.append(one)
    return given


class ChallengeNode(Node):
    """Answers with the poses of the objects whose ids are asked for."""

    def __init__(self):
        super().__init__("bpc_pose_estimator")
        parameters.declare(self, parameters.CHALLENGE)
        self._values = values = parameters.read(self, parameters.CHALLENGE)
        if not values["model_dir"]:
            raise ValueError("model_dir: expected the folder of a model, got none; set it")
        estimator = mvtop.Estimator.load(values["model_dir"], threads=values["threads"])
        self._finder = Finder(estimator, values["waiting"])
        self._names = {known.id: known.name for known in estimator.classes}
        self._service = self.create_service(
            GetPoseEstimates, "/get_pose_estimates", self._serve,
            callback_group=ReentrantCallbackGroup(),
        )  # fmt: skip

    @property
    def threads(self):
        """How many callbacks may run at once."""
        return self._values["waiting"] + 2

    def _serve(self, request, response):
        began = time.monotonic()
        try:
            classes = [
                self._names[number] for number in request.object_ids if number in self._names
            ]
            unknown = sorted(set(request.object_ids) - set(self._names))
            if unknown:
                self.get_logger().warning(f"object_ids: the model does not know {unknown}")
            if not classes:
                return response
            pictures, rig, problems = views_of(request, self._values["use_photoneo"])
            for problem in problems:
                self.get_logger().warning(problem)
            prediction = self._finder.find(pictures, rig, mvtop.Request(classes=classes))
            for warning in prediction.warnings:
                self.get_logger().warning(warning.message)
            response.pose_estimates = estimates_of(prediction, self._values["min_confidence"])
            took = time.monotonic() - began
            self.get_logger().info(f"{len(response.pose_estimates)} poses in {took:.2f} s")
        except (ValueError, OSError, BusyError, mvtop.Error) as problem:
            self.get_logger().error(str(problem))
        except Exception as problem:  # noqa: BLE001 - the node must go on
            self.get_logger().error(f"prediction: {type(problem).__name__}: {problem}")
        return response


def main():
    """Runs the node until it is told to end."""
    warnings.simplefilter("ignore", mvtop.MvtopWarning)  # they are logged
    rclpy.init()
    try:
        node = ChallengeNode()
    except (ValueError, OSError, mvtop.Error) as problem:
        rclpy.logging.get_logger("bpc_pose_estimator").fatal(str(problem))
        rclpy.try_shutdown()
        raise SystemExit(1) from None
    spin(node, node.threads)


if __name__ == "__main__":
    main()
