"""What the node publishes of each exposure."""

from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3DArray
from visualization_msgs.msg import MarkerArray

from mvtop_ros import detections

# What is published once, for those who come later, too.
LASTING = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Publishers:
    """Detections, markers and frames."""

    def __init__(self, node, values, classes):
        """
        - values: of the node's parameters
        - classes: the estimator's, by name
        """
        self._node, self._values, self._classes = node, values, classes
        self._detections = node.create_lifecycle_publisher(Detection3DArray, "~/detections", 10)
        self._markers = node.create_lifecycle_publisher(MarkerArray, "~/markers", 10)
        self._tf = node.create_publisher(TFMessage, "/tf", 100)
        self._tf_static = node.create_publisher(TFMessage, "/tf_static", LASTING)

    def publish_rig(self, rig):
        """The frame of each camera."""
        header = Header(frame_id=self._values["world_frame"])
        self._tf_static.publish(detections.transforms_of_rig(rig, header))

    def publish(self, prediction, header):
        """The objects that are certain enough."""
        least = self._values["min_confidence"]
        if least > 0:
            indices = range(len(prediction))
            prediction = prediction[
                [i for i in indices if (prediction[i].confidence or 0) >= least]
            ]
        self._detections.publish(detections.detections_of(prediction, header, self._classes))
        if self._values["publish_tf"] and len(prediction):
            self._tf.publish(detections.transforms_of(prediction, header))
        if self._values["publish_markers"]:
            self._markers.publish(detections.markers_of(prediction, header, self._classes))

    def close(self):
        """Ends all of them."""
        for publisher in (self._detections, self._markers, self._tf, self._tf_static):
            self._node.destroy_publisher(publisher)
