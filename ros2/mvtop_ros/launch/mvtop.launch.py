"""The node with the parameters of a file: `ros2 launch mvtop_ros mvtop.launch.py config:=FILE`."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

CONFIG = Path(__file__).resolve().parents[1] / "config" / "mvtop.yaml"


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value=str(CONFIG)),
            LifecycleNode(
                package="mvtop_ros",
                executable="mvtop",
                name="mvtop",
                namespace="",
                parameters=[LaunchConfiguration("config")],
                output="screen",
            ),
        ]
    )
