"""Facts of the kernel, from fixture trees and from this computer."""

from __future__ import annotations

import pytest

from arpd.host import kernel
from arpd.host.interface import interface_to
from arpd.host.kernel import (
    counters,
    interface_of_link,
    is_own_address,
    link_interface,
    route_mtu,
)

SNMP = "Udp: InDatagrams RcvbufErrors\nUdp: 1000 7\nUdpLite: InDatagrams RcvbufErrors\nUdpLite: 9 9\n"


@pytest.mark.parametrize(
    ("snmp", "found"),
    [(SNMP, {"InDatagrams": 1000, "RcvbufErrors": 7}), ("", {}), ("Udp: InDatagrams\nUdp: many\n", {})],
)
def test_counters_of_a_protocol_are_read_or_not_known(tmp_path, snmp, found):
    """UdpLite's are not UDP's; neither a missing file nor an odd one raises."""
    (tmp_path / "net").mkdir()
    (tmp_path / "net/snmp").write_text(snmp)
    assert counters("Udp", proc=tmp_path) == found
    assert counters("Udp", proc=tmp_path / "nowhere") == {}


def test_the_route_to_this_computer_is_the_loopback(network):
    """Interface and packet size come from the kernel, and nothing is sent."""
    assert interface_to("127.0.0.1") == "lo"
    assert (route_mtu("127.0.0.1") or 0) >= 16_384
    assert is_own_address("localhost")
    assert is_own_address("127.0.1.1")
    assert not is_own_address("robot..local")
    assert not is_own_address("192.0.2.77")
    assert not is_own_address("no.such.host.invalid")
    assert interface_to("no.such.host.invalid") is None
    assert route_mtu("256.0.0.1") is None


def test_the_link_is_where_the_other_end_is(network, monkeypatch):
    """Or, where no route leads there, where this end's own address is; a name is not looked up."""
    monkeypatch.setattr(kernel, "likeliest_interface", lambda: "wlan0")
    ends = "127.0.0.1", "192.0.2.77", "localhost", None
    assert [interface_of_link(end) for end in ends] == ["lo", None, None, None]
    assert [link_interface("auto", end) for end in ends] == ["lo", *3 * ["wlan0"]]
    assert [interface_of_link(end, "127.0.0.1") for end in ends] == 4 * ["lo"]
