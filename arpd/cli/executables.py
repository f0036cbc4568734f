"""The executables of a ROS 2 installation: `ros2 run arpd relay` is `arpd relay`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.cli.main import main as run_command

if TYPE_CHECKING:
    from collections.abc import Iterable


def main() -> int:
    """Run the command that the executable is named after, with the process's arguments."""
    command, *arguments = sys.argv
    return run_command([Path(command).name, *without_ros_arguments(arguments)])


def without_ros_arguments(arguments: Iterable[str]) -> list[str]:
    """Return the arguments without those between ``--ros-args`` and ``--`` or the end.

    A launch file's Node gives them to every process, and `ros2 run` to the process of a user who adds some. rclpy reads
    them from the process itself.
    """
    own: list[str] = []
    is_ours = True
    for argument in arguments:
        if argument == "--ros-args":
            is_ours = False
        elif is_ours:
            own.append(argument)
        else:
            is_ours = argument == "--"
    return own
