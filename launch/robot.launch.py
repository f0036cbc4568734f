"""Start arpd on the robot computer: the daemon, and the relay for nodes whose code is not yours.

ros2 launch arpd robot.launch.py config:=my.yaml
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

LEVELS = ["debug", "info", "warning", "error"]
# As in the units, unless it is set: who shares memory with a node that is killed may hang for good (docs/operating.md).
UDP = {"FASTDDS_BUILTIN_TRANSPORTS": EnvironmentVariable("FASTDDS_BUILTIN_TRANSPORTS", default_value="UDPv4")}


def generate_launch_description() -> LaunchDescription:
    """Return the daemon and the relay; both choose their Fast DDS profile themselves."""
    options = ["--config", LaunchConfiguration("config"), "--log-level", LaunchConfiguration("log_level")]
    # A clean stop gives all publishers their own QoS back, which can take 18 s.
    patience_s = LaunchConfiguration("sigterm_timeout", default="20")
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value="/etc/arpd/arpd.yaml", description="configuration of arpd"),
            DeclareLaunchArgument("log_level", default_value="info", choices=LEVELS, description="how much arpd logs"),
            Node(
                package="arpd",
                executable="run",
                arguments=options,
                output="screen",
                additional_env=UDP,
                sigterm_timeout=patience_s,
            ),
            Node(package="arpd", executable="relay", arguments=options, output="screen", additional_env=UDP),
        ]
    )
