"""Serves a node's callbacks until the process is told to end."""

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor


def spin(node, threads, begin=lambda: None):
    """Ends with the node destroyed and ROS shut down, also where something fails.

    threads  for callbacks
    begin    called first
    """
    executor = MultiThreadedExecutor(num_threads=threads)
    executor.add_node(node)
    try:
        begin()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
