"""Start arpd at the other end of the link: the peer, and the far end of a relay with two ends.

ros2 launch arpd base.launch.py config:=my.yaml

The configuration is the robot's. Without a relay with two ends `ros2 run arpd peer` is enough, and needs none.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

LEVELS = ["debug", "info", "warning", "error"]
# As in the units, unless it is set: who shares memory with a node that is killed may hang for good (docs/operating.md).
UDP = {"FASTDDS_BUILTIN_TRANSPORTS": EnvironmentVariable("FASTDDS_BUILTIN_TRANSPORTS", default_value="UDPv4")}


def generate_launch_description() -> LaunchDescription:
    """Return the peer and the relay's far end; both choose their Fast DDS profile themselves."""
    options = ["--config", LaunchConfiguration("config"), "--log-level", LaunchConfiguration("log_level")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value="/etc/arpd/arpd.yaml", description="configuration of arpd"),
            DeclareLaunchArgument("log_level", default_value="info", choices=LEVELS, description="how much arpd logs"),
            Node(package="arpd", executable="peer", arguments=options, output="screen", additional_env=UDP),
            Node(
                package="arpd", executable="relay", arguments=["--far", *options], output="screen", additional_env=UDP
            ),
        ]
    )
