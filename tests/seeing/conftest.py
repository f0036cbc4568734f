"""The one real run for test_real_run.py; it takes a minute or two, so it plays once."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module")  # a robot that outlived its module would load the machine for all tests after it
def run(request, tmp_path_factory):
    """Play the run once, and keep it alive (`tests.seeing.real_run.RealRun`)."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from scripts.netns.simlink import available
    from tests.seeing.real_run import real_run

    can, why = available()
    if not can:
        pytest.skip(why)
    prometheus = request.getfixturevalue("prometheus")  # only now: it may have to be downloaded
    with real_run(tmp_path_factory.mktemp("seeing"), prometheus=prometheus) as played:
        yield played
