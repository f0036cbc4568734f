"""The Fast DDS option by which control traffic does not wait for the link."""

import pytest

from arpd.adapters.ros.runtime import send_without_waiting


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
