"""The environment of Fast DDS: control traffic that does not wait for the link, and discovery servers."""

import pytest

from arpd.model.settings import LinkDomain
from arpd.ros.runtime import FASTDDS_PROFILE, _discovery, prepare_environment, send_without_waiting


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


@pytest.mark.parametrize(
    ("before", "wanted"),
    [({}, None), ({"ROS_SUPER_CLIENT": "FALSE"}, "FALSE"), ({"ROS_SUPER_CLIENT": ""}, "TRUE")],
)
def test_a_discovery_server_tells_arpd_of_every_topic(before, wanted):
    """A plain client hears only of topics that it uses itself; arpd is a super client unless the user says no."""
    environment = dict(before)
    prepare_environment(FASTDDS_PROFILE, environment)
    assert environment.get("ROS_SUPER_CLIENT") == before.get("ROS_SUPER_CLIENT")
    environment = {**before, "ROS_DISCOVERY_SERVER": "127.0.0.1:11811"}
    prepare_environment(FASTDDS_PROFILE, environment)
    assert environment["ROS_SUPER_CLIENT"] == (wanted or "TRUE")


def test_the_link_s_participant_has_no_discovery_server_of_the_robot():
    """While the first node of the link is made no server is named, and afterwards all is as before."""
    before = {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    environment = dict(before)
    with _discovery(LinkDomain(domain_id=77, peer="10.0.0.2"), environment):
        assert "ROS_DISCOVERY_SERVER" not in environment
        assert environment["ROS_STATIC_PEERS"] == "127.0.0.1;10.0.0.2"
    assert environment == before
