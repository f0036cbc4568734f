"""A separate world for each scenario: real rclpy over UDP on this host."""

from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.chaos.world import World, this_host_only


@pytest.fixture(scope="module")
def played(request, tmp_path_factory):
    """Run the module's ``SCENARIOS``, three at a time because they mostly wait; return their outcomes.

    A scenario serves many tests, because most of its time goes into starting processes and waiting for timeouts.
    """
    with this_host_only(), ThreadPoolExecutor(max_workers=3) as stages:

        def play(scenario, workdir):
            with World(workdir) as world:
                return scenario(world)

        outcomes = {
            scenario: stages.submit(play, scenario, tmp_path_factory.mktemp(scenario.__name__))
            for scenario in request.module.SCENARIOS
        }
        yield lambda scenario: outcomes[scenario].result()
