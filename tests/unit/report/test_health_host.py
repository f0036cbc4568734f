"""Checks of `arpd doctor` on the computer: when something should be done, and when not enough is known."""

from __future__ import annotations

from dataclasses import replace

import pytest

from arpd.report.health import Health, PythonRos, Unit, Unknown
from arpd.report.health_host import fragments, numpy, profile, receive_buffers, ros, units, versions
from tests.unit.report.health_facts import LIMITS, facts, found

WORKS = PythonRos(python="/venv/bin/python", rclpy="/opt/ros/jazzy/lib/rclpy/__init__.py", numpy="1.26.4", rmw="rmw")
SYSTEM = {"python": "/usr/bin/python3"}
OWN_NUMPY = {"venv": "/venv", "numpy_file": "/venv/lib/python3.12/site-packages/numpy/__init__.py"}
AT_HOME = "/home/ubuntu/.local/lib/python3.12/site-packages/numpy/__init__.py"
FOR_ALL = "/usr/local/lib/python3.12/dist-packages/numpy/__init__.py"
UNINSTALL = "-m pip uninstall --break-system-packages numpy"


@pytest.mark.parametrize(
    ("changes", "health"),
    [
        ({}, Health.FINE),
        ({"overflowed": 9}, Health.FINE),
        ({"overflowed": 99}, Health.FINE),
        ({"overflowed": 5000}, Health.WRONG),
        ({"overflowed": 5000, "buffer_bytes": 8 * 2**20}, Health.FINE),
        ({"buffer_bytes": None}, Health.UNKNOWN),
        ({"overflowed": None}, Health.UNKNOWN),
    ],
)
def test_a_small_buffer_is_wrong_where_datagrams_were_lost_for_want_of_it(changes, health):
    """A default size that loses nothing harms nobody, and one that was raised is fine, although the counters stay."""
    judged = receive_buffers(facts(limits=replace(LIMITS, **changes)))
    assert judged.health is health
    assert "rmem_max" not in "".join(judged.remedies)  # tuning guides raise it far above what is enough
    assert bool(judged.remedies) is (health is Health.WRONG)


@pytest.mark.parametrize(
    ("changes", "health"),
    [
        ({}, Health.FINE),
        ({"incomplete": 500}, Health.WRONG),
        ({"incomplete": 500, "reassembly_s": 3, "reassembly_bytes": 128 * 2**20}, Health.FINE),
        ({"incomplete": None}, Health.UNKNOWN),
    ],
)
def test_reassembly_is_wrong_where_many_datagrams_never_became_whole(changes, health):
    """Short patience and much memory make lost fragments harmless to the others."""
    judged = fragments(facts(limits=replace(LIMITS, **changes)))
    assert judged.health is health
    assert bool(judged.remedies) is (health is Health.WRONG)


@pytest.mark.parametrize(
    ("python", "distro", "installed", "health", "remedy"),
    [
        (WORKS, "jazzy", ["jazzy"], Health.FINE, ""),
        (WORKS, "humble", ["humble", "jazzy"], Health.WRONG, "source /opt/ros/jazzy/setup.bash"),
        (WORKS, "humble", ["humble"], Health.WRONG, "sudo apt install ros-jazzy-ros-base"),
        (PythonRos(python="p", fault="ImportError"), "", ["jazzy"], Health.UNKNOWN, ""),
        (PythonRos(python="p", fault="ImportError"), "", [], Health.WRONG, "sudo apt install ros-jazzy-ros-base"),
        (Unknown("no answer"), "jazzy", ["jazzy"], Health.UNKNOWN, ""),
    ],
)
def test_ros_must_work_and_be_jazzy(python, distro, installed, health, remedy):
    """A shell in which ROS is not sourced tells nothing of the daemon's."""
    judged = found(ros, pythons=[python], distro=distro, distros=installed)
    assert judged.health is health
    assert "".join(judged.remedies).startswith(remedy)
    assert bool(judged.remedies) is (health is Health.WRONG)
    assert "jazzy" in installed or "source /opt" not in "".join(judged.remedies)


@pytest.mark.parametrize(
    ("changes", "health", "remedy"),
    [
        ({}, Health.FINE, ""),
        ({"numpy": "2.4.6"} | OWN_NUMPY, Health.WRONG, "/venv/bin/python -m pip install 'numpy<2'"),
        ({"numpy": "2.1", "numpy_file": AT_HOME} | SYSTEM, Health.WRONG, f"/usr/bin/python3 {UNINSTALL}"),
        ({"numpy": "2.1", "numpy_file": FOR_ALL} | SYSTEM, Health.WRONG, f"sudo /usr/bin/python3 {UNINSTALL}"),
        ({"numpy": "2.4.6", "rclpy": "/venv/lib/rclpy/__init__.py"}, Health.FINE, ""),
        ({"numpy": ""}, Health.UNKNOWN, ""),
    ],
)
def test_numpy_2_does_not_fit_the_packages_of_apt(changes, health, remedy):
    """Wheels of ROS from PyPI take either."""
    judged = numpy(facts(pythons=[replace(WORKS, **changes)]))
    assert judged.health is health
    assert "".join(judged.remedies) == remedy


def test_versions_must_be_the_same():
    """On the robot a restart mends it, across the link an installation."""
    assert versions(facts()).health is Health.FINE
    assert "restart" in versions(facts(version="1.1")).remedies[0]
    assert "./arpd-ros_*.deb" in versions(facts(version="1.1", is_far=True)).remedies[0]
    assert found(versions, daemon_version=Unknown("no daemon")).health is Health.UNKNOWN


@pytest.mark.parametrize(
    ("installed", "health"),
    [
        ([], Health.FINE),
        ([Unit(name="arpd", active="active", is_enabled=True)], Health.FINE),
        ([Unit(name="arpd", active="failed", is_enabled=True)], Health.WRONG),
        ([Unit(name="arpd", active="inactive", is_enabled=True)], Health.WRONG),
        ([Unit(name="arpd", active="inactive", is_enabled=False)], Health.FINE),
        ([Unit(name="arpd", active="activating", is_enabled=True)], Health.FINE),
        ([Unit(name="arpd", active="activating", is_enabled=True, is_looping=True)], Health.WRONG),
        (Unknown("systemd does not run here"), Health.UNKNOWN),
    ],
)
def test_units_that_failed_or_do_not_run_are_wrong(installed, health):
    """A unit that nobody enabled may rest."""
    assert found(units, units=installed).health is health


def test_nodes_without_the_profile_are_named():
    """With the line to set."""
    judged = profile(facts(lacking=["/lidar", "/camera"], profile_line="export X=y"))
    assert judged.health is Health.WRONG
    assert "/camera and /lidar" in judged.text
    assert judged.remedies[0].startswith("export X=y")
    assert profile(facts()).health is Health.FINE
    assert found(profile, lacking=Unknown("no daemon")).health is Health.UNKNOWN
