"""ROS as an interpreter finds it, tried in another process."""

from __future__ import annotations

import subprocess
import sys

import pytest

from arpd.ros.installation import read_ros, understood


@pytest.mark.parametrize(
    ("output", "code", "rclpy", "fault"),
    [
        ('{"numpy": "1.26.4"}\n{"numpy": "1.26.4", "rclpy": "r", "works": true}\n', 0, "r", ""),
        ('{"numpy": "2.0", "rclpy": "r"}\n', -11, "r", "it ended with status -11"),
        ('{"fault": "ImportError: no\\nmodule"}\n', 0, "", "ImportError: no module"),
        ("", 1, "", "it ended with status 1"),
        ("not JSON\n", 0, "", "it ended with status 0"),
        ("[1]\n", 0, "", "it ended with status 0"),
    ],
)
def test_the_last_line_counts_also_of_a_process_that_crashed(output, code, rclpy, fault):
    """So that a crash inside numpy still shows its version."""
    found = understood("python", subprocess.CompletedProcess([], code, stdout=output, stderr=""))
    assert (found.rclpy, found.fault) == (rclpy, fault)


def test_this_interpreter_has_a_ros_that_works():
    """The real thing, with a message that numpy holds."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    found = read_ros(sys.executable)
    assert (found.fault, found.rmw[:4]) == ("", "rmw_")
    assert found.rclpy.endswith("__init__.py")
    assert found.numpy_file.endswith("__init__.py")
    assert found.venv == ("" if sys.prefix == sys.base_prefix else sys.prefix)
