"""Fixtures for more than one folder of tests, and what scripts/test asks of tests that are skipped."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from pathlib import Path

import pytest

from tests.golden.sample import make_snapshot
from tests.messages.generate import make_importable, obstacle

# scripts/test sets it where it could install everything: there no test is skipped for want of a package.
_MISSING_FAILS = os.environ.get("ARPD_TESTS_MISSING") == "fail"
# A reason to skip names a missing package by these words.
_MISSING = re.compile(r"\b(not installed|not found|install|could not import)\b")
_HAS_ROS_WHEELS = platform.machine() == "x86_64"


@pytest.fixture
def sample_snapshot():
    return make_snapshot()


@pytest.fixture(scope="session")
def promtool():
    """Return the path of Prometheus's promtool."""
    return _of_prometheus("promtool")


@pytest.fixture(scope="session")
def prometheus():
    """Return the path of Prometheus's server."""
    return _of_prometheus("prometheus")


def _of_prometheus(program):
    script = Path(__file__).parents[1] / "scripts/get-prometheus"
    found = subprocess.run([script, program], capture_output=True, text=True, check=False)
    if found.returncode != 0:
        pytest.skip(f"{program} is not installed: {found.stderr.strip()}")
    return found.stdout.strip()


@pytest.fixture(scope="session")
def tf_message():
    """Return the class tf2_msgs/msg/TFMessage.

    Another process imports it with `tests.messages.generate.environment`.
    """
    if why := obstacle("tf2_msgs"):
        pytest.skip(why)
    make_importable("tf2_msgs")
    from tf2_msgs.msg import TFMessage

    return TFMessage


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport():
    return _judge((yield))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_make_collect_report():
    return _judge((yield))


def _judge(report):
    """Turn a test that was skipped for want of a package into one that failed."""
    if not (_MISSING_FAILS and report.skipped and isinstance(report.longrepr, tuple)):
        return report
    reason = report.longrepr[2]
    if _MISSING.search(reason) and (_HAS_ROS_WHEELS or "ROS 2 is not installed" not in reason):
        report.outcome, report.longrepr = "failed", f"{reason.removeprefix('Skipped: ')}; scripts/test installs it"
    return report
