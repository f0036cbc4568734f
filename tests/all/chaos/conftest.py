"""Real rclpy over UDP, in a network of its own for each scenario."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.all.chaos.world import World, this_host_only
from tests.network import own_network


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Return a function that runs a scenario and returns its outcome.

    A scenario serves many tests, because most of its time goes into starting processes and waiting for timeouts.
    One that broke is not played again.
    """
    outcomes, broken = {}, {}

    def play(scenario):
        if scenario in broken:
            pytest.fail(f"{scenario.__name__} broke: {broken[scenario]}")
        if scenario not in outcomes:
            try:
                with own_network(), World(tmp_path_factory.mktemp(scenario.__name__)) as world:
                    outcomes[scenario] = scenario(world)
            except BaseException as error:
                broken[scenario] = error
                raise
        return outcomes[scenario]

    with this_host_only():
        yield play
