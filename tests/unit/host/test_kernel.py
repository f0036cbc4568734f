"""Facts of the kernel, from fixture trees and from this computer."""

from __future__ import annotations

import pytest

from arpd.host.kernel import (
    interface_to,
    is_own_address,
    read_limits,
    route_mtu,
)
from arpd.report.health import NetworkLimits

SNMP = """\
Ip: Forwarding DefaultTTL ReasmTimeout ReasmReqds ReasmOKs ReasmFails
Ip: 1 64 3 100 20 4
Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors
Udp: 1000 1 7 2000 7
UdpLite: InDatagrams RcvbufErrors
UdpLite: 9 9
"""


def tree(tmp_path, *, snmp=SNMP, limits=True):
    (tmp_path / "net").mkdir()
    (tmp_path / "net/snmp").write_text(snmp)
    if limits:
        for name, value in (
            ("core/rmem_default", 212_992),
            ("ipv4/ipfrag_time", 30),
            ("ipv4/ipfrag_high_thresh", 4_194_304),
        ):
            path = tmp_path / "sys/net" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{value}\n")
    return tmp_path


def test_limits_and_losses_are_read(tmp_path):
    """Each number has its own line; UdpLite's are not UDP's."""
    assert read_limits(tree(tmp_path)) == NetworkLimits(
        buffer_bytes=212_992,
        received=1000,
        overflowed=7,
        reassembly_s=30,
        reassembly_bytes=4_194_304,
        reassembled=20,
        incomplete=4,
    )


@pytest.mark.parametrize("snmp", ["", "Udp: InDatagrams\n", "Udp: InDatagrams\nUdp: many\n", "Udp: A B\nUdp: 1\n"])
def test_what_the_kernel_does_not_tell_is_not_known(tmp_path, snmp):
    """Neither a missing file nor an odd one raises."""
    assert read_limits(tree(tmp_path, snmp=snmp, limits=False)) == NetworkLimits()
    assert read_limits(tmp_path / "nowhere") == NetworkLimits()


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
