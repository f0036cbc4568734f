"""The Fast DDS option by which control traffic does not wait for the link."""

import pytest

from arpd.model.settings import LinkDomain
from arpd.ros.runtime import _discovery, send_without_waiting


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, "DEFAULT?non_blocking=true"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": ""}, "DEFAULT?non_blocking=true"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}, "UDPv4?non_blocking=true"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA?max_msg_size=1MB"}, "LARGE_DATA?max_msg_size=1MB"),
    ],
)
def test_the_transports_chosen_stay_and_only_an_option_is_added(before, after):
    """The user's transports stay, and so do the user's options if there are any."""
    send_without_waiting(before)
    assert before == {"FASTDDS_BUILTIN_TRANSPORTS": after}


def test_the_link_s_participant_has_no_discovery_server_of_the_robot():
    """While the first node of the link is made no server is named, and afterwards all is as before."""
    before = {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    environment = dict(before)
    with _discovery(LinkDomain(domain_id=77, peer="10.0.0.2"), environment):
        assert "ROS_DISCOVERY_SERVER" not in environment
        assert environment["ROS_STATIC_PEERS"] == "127.0.0.1;10.0.0.2"
    assert environment == before
