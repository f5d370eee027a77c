"""From predictions to the messages that are published."""

import math
from collections import Counter

import numpy as np
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose
from visualization_msgs.msg import Marker, MarkerArray

from mvtop_ros.transforms import to_pose, to_transform

# Mean angle of a turn whose parts about three axes have standard deviation 1.
_MEAN_ANGLE = math.sqrt(8 / math.pi)


def covariance_of(sigma):
    """(36,), rows of the covariance of x, y, z in metres and of turns about them in radians."""
    turn = math.radians(sigma.rot_deg) / _MEAN_ANGLE
    return np.diag([sigma.t_m**2] * 3 + [turn**2] * 3).ravel()


def bounds_of(known):
    """Middle (3,) and size (3,) of the box around a class's points, object frame, metres."""
    low, high = known.points.min(axis=0), known.points.max(axis=0)
    return (low + high) / 2, high - low


def detections_of(prediction, header, classes):
    """A `Detection3DArray` in the world frame.

    - classes: the estimator's, by name
    """
    message = Detection3DArray(header=header)
    for found in prediction:
        one = Detection3D(header=header, id=id_of(found))
        sure = found.score if found.confidence is None else found.confidence
        for hypothesis in found.hypotheses:
            result = ObjectHypothesisWithPose()
            result.hypothesis.class_id = found.class_name
            # The hypotheses share the odds of the object.
            share = hypothesis.probability / found.hypotheses[0].probability
            result.hypothesis.score = float(sure * share)
            result.pose.pose = to_pose(hypothesis.world_from_obj)
            result.pose.covariance = covariance_of(hypothesis.sigma)
            one.results.append(result)
        middle, size = bounds_of(classes[found.class_name])
        one.bbox.center = to_pose(_moved(found.world_from_obj, middle))
        one.bbox.size.x, one.bbox.size.y, one.bbox.size.z = map(float, size)
        message.detections.append(one)
    return message


def id_of(found):
    """What names an object over time; empty where none is followed."""
    return "" if found.track_id is None else f"{found.class_name}_{found.track_id}"


def frame_names(prediction):
    """The frame of each object: its id, else its class and a number, most probable first."""
    counts, names = Counter(), [""] * len(prediction)
    for at in sorted(range(len(prediction)), key=lambda at: -(prediction[at].confidence or 0.0)):
        name = prediction[at].class_name
        names[at] = id_of(prediction[at]) or f"{name}_{counts[name]}"
        counts[name] += 1
    return names


def transforms_of(prediction, header):
    """A `TFMessage` from the world frame to each object's."""
    message = TFMessage()
    for found, name in zip(prediction, frame_names(prediction), strict=True):
        transform = to_transform(found.world_from_obj)
        message.transforms.append(
            TransformStamped(header=header, child_frame_id=name, transform=transform)
        )
    return message


def transforms_of_rig(rig, header):
    """A `TFMessage` from the world frame to each camera's, whose name is its id."""
    message = TFMessage()
    for camera in rig.cameras:
        transform = to_transform(camera.world_from_cam)
        message.transforms.append(
            TransformStamped(header=header, child_frame_id=camera.id, transform=transform)
        )
    return message


def markers_of(prediction, header, classes):
    """A `MarkerArray`: a box and a line of text for each object; earlier ones are deleted."""
    message = MarkerArray(markers=[Marker(header=header, action=Marker.DELETEALL)])
    for number, found in enumerate(prediction):
        middle, size = bounds_of(classes[found.class_name])
        sure = found.score if found.confidence is None else found.confidence
        box = Marker(header=header, ns="boxes", id=number, type=Marker.CUBE)
        box.pose = to_pose(_moved(found.world_from_obj, middle))
        box.scale.x, box.scale.y, box.scale.z = map(float, size)
        # From red to green.
        box.color.r, box.color.g, box.color.a = float(1 - sure), float(sure), 0.5
        text = Marker(header=header, ns="names", id=number, type=Marker.TEXT_VIEW_FACING)
        text.pose = to_pose(_moved(found.world_from_obj, middle))
        text.pose.position.z += float(np.linalg.norm(size)) / 2
        text.scale.z = float(size.max()) / 5
        text.color.r = text.color.g = text.color.b = text.color.a = 1.0
        text.text = f"{found.class_name} {100 * sure:.0f} %"
        message.markers += [box, text]
    return message


def _moved(world_from_obj, point):
    """The pose at a point of the object's frame."""
    pose = np.array(world_from_obj)
    pose[:3, 3] = pose[:3, :3] @ point + pose[:3, 3]
    return pose
