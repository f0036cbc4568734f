"""Worlds of their own for the scenarios: real rclpy over UDP on this host."""

from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from chaos.world import World

from arpd.ros.runtime import prepare_environment


@pytest.fixture(scope="module")
def played(request, tmp_path_factory):
    """Play the module's ``SCENARIOS``, three at a time because they mostly wait; return what each came to.

    A scenario serves many tests: starting processes and waiting for timeouts is what costs time, not looking.
    """
    with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(max_workers=3) as stages:
        patch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        prepare_environment()

        def play(scenario, workdir):
            with World(workdir) as world:
                return scenario(world)

        outcomes = {
            scenario: stages.submit(play, scenario, tmp_path_factory.mktemp(scenario.__name__))
            for scenario in request.module.SCENARIOS
        }
        yield lambda scenario: outcomes[scenario].result()
