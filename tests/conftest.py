"""Fixtures for more than one folder of tests, and what scripts/test asks of tests that are skipped."""

from __future__ import annotations

import os
import platform
import subprocess
import time
from pathlib import Path

import pytest

from tests import examples, waiting
from tests.golden.sample import make_snapshot
from tests.network import own_network

examples.register()

# scripts/test sets it for root where it could install everything: a test that is skipped there was not passed.
_MISSING_FAILS = os.environ.get("ARPD_TESTS_MISSING") == "fail"
_HAS_ROS_WHEELS = platform.machine() == "x86_64"
# `scripts/test --all` sets it to the time (s since 1970) at which its budget ends.
_UNTIL_S = float(os.environ.get("ARPD_TESTS_UNTIL", "inf"))
_BUDGET_IS_USED = "the budget of an hour is used up"


@pytest.fixture(scope="session")
def eventually():
    """Wait: ``eventually("what should happen", condition)``."""
    return waiting.eventually


@pytest.fixture(scope="module")
def network():
    """Give this file's tests a network of their own."""
    with own_network():
        yield


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


def pytest_runtest_setup():
    if time.time() > _UNTIL_S:
        pytest.skip(_BUDGET_IS_USED)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport():
    return _judge((yield))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_make_collect_report():
    return _judge((yield))


def _judge(report):
    """Turn a test that was skipped into one that failed, where nothing that it needs may be missing."""
    if not (_MISSING_FAILS and report.skipped and isinstance(report.longrepr, tuple)):
        return report
    reason = report.longrepr[2].removeprefix("Skipped: ")
    if reason != _BUDGET_IS_USED and (_HAS_ROS_WHEELS or "ROS 2 is not installed" not in reason):
        report.outcome, report.longrepr = "failed", f"not tested: {reason}; scripts/test installs what its tests need"
    return report
