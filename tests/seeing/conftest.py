"""The one real run for every test of this folder; it takes a minute or two, so it plays once."""

from __future__ import annotations

import subprocess

import pytest


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """Play the run once, and keep it alive (`tests.seeing.real_run.RealRun`)."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from scripts.netns.simlink import available
    from scripts.robot.run import REPO
    from tests.seeing.real_run import real_run

    can, why = available()
    if not can:
        pytest.skip(why)
    found = subprocess.run([REPO / "scripts/get-prometheus", "prometheus"], capture_output=True, text=True, check=False)
    if found.returncode != 0:
        pytest.skip(f"Prometheus is not installed: {found.stderr.strip()}")
    with real_run(tmp_path_factory.mktemp("seeing"), prometheus=found.stdout.strip()) as played:
        yield played
