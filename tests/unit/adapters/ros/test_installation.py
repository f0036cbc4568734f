"""ROS as an interpreter finds it, tried in another process."""

from __future__ import annotations

import subprocess
import sys

import pytest

from arpd.adapters.ros.installation import installed_distros, read_ros
from arpd.report.health import Unknown
from arpd.report.health_host import PythonRos


def ended(output, code=0):
    return lambda python: subprocess.CompletedProcess([python], code, stdout=output, stderr="")


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
    found = read_ros("python", run=ended(output, code))
    assert isinstance(found, PythonRos)
    assert (found.rclpy, found.fault) == (rclpy, fault)


def test_a_process_that_died_says_why_in_its_last_line():
    """As rcl does where RMW_IMPLEMENTATION names a middleware that is not there."""
    died = subprocess.CompletedProcess(["python"], 102, stdout='{"rclpy": "r"}\n', stderr="first\nno rmw_other\n\n")
    found = read_ros("python", run=lambda _python: died)
    assert isinstance(found, PythonRos)
    assert (found.rclpy, found.fault) == ("r", "it ended with status 102: no rmw_other")


def test_an_rclpy_that_cannot_be_imported_is_there_all_the_same(tmp_path, monkeypatch):
    """So that it is repaired and not installed."""
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy/__init__.py").write_text("raise ImportError('no C extension')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    found = read_ros(sys.executable)
    assert isinstance(found, PythonRos)
    assert (found.rclpy, found.fault) == (str(tmp_path / "rclpy/__init__.py"), "ImportError: no C extension")


@pytest.mark.parametrize("fault", [FileNotFoundError("python"), subprocess.TimeoutExpired("python", 20)])
def test_an_interpreter_that_does_not_answer_is_not_known(fault):
    """It may be busy, or gone."""

    def fail(_python):
        raise fault

    assert isinstance(read_ros("python", run=fail), Unknown)


def test_this_interpreter_has_a_ros_that_works():
    """The real thing, with a message that numpy holds."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    found = read_ros(sys.executable)
    assert isinstance(found, PythonRos)
    assert (found.fault, found.rmw[:4]) == ("", "rmw_")
    assert found.rclpy.endswith("__init__.py")
    assert found.numpy_file.endswith("__init__.py")
    assert found.venv == ("" if sys.prefix == sys.base_prefix else sys.prefix)


def test_a_distribution_has_a_setup_file(tmp_path):
    """An empty folder is none."""
    (tmp_path / "jazzy").mkdir()
    (tmp_path / "jazzy/setup.bash").touch()
    (tmp_path / "humble").mkdir()
    assert installed_distros(tmp_path) == ["jazzy"]
    assert installed_distros(tmp_path / "nowhere") == []
