"""Facts of the kernel, from fixture trees and from this computer."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from arpd.host import kernel
from arpd.host.interface import interface_to
from arpd.host.kernel import (
    check_place,
    counters,
    interface_of_link,
    is_own_address,
    link_interface,
    own_address,
    route_mtu,
)
from arpd.model.errors import ConfigError
from arpd.model.settings import LinkDomain

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


@pytest.mark.parametrize(
    ("own", "peer", "found"),
    [
        ("10.0.0.5", "10.0.0.2", "10.0.0.5"),
        ("robot", "", "10.0.0.5"),
        ("", "base", "192.168.1.2"),
        ("203.0.113.7", "base", "192.168.1.2"),
        ("nowhere", "10.0.0.2", "10.0.0.5"),
        ("debian", "base", "192.168.1.2"),
        ("10.0.0.5", "127.0.0.1", "10.0.0.5"),
        ("", "10.0.0.5", None),
        ("debian", "127.0.0.1", None),
        ("", "", None),
    ],
)
def test_an_end_s_own_address_is_the_configured_one_or_that_of_the_route_to_the_other(monkeypatch, own, peer, found):
    """A router's address, Debian's 127.0.1.1 for its own name, and loopback are none."""
    routes = {
        "10.0.0.5": ("10.0.0.5", "10.0.0.5"),
        "10.0.0.2": ("10.0.0.5", "10.0.0.2"),
        "192.168.1.9": ("192.168.1.2", "192.168.1.9"),
        "203.0.113.7": ("192.168.1.2", "203.0.113.7"),
        "127.0.0.1": ("127.0.0.1", "127.0.0.1"),
        "127.0.1.1": ("127.0.0.1", "127.0.1.1"),
    }
    names = {"robot": "10.0.0.5", "base": "192.168.1.9", "debian": "127.0.1.1"}
    monkeypatch.setattr(kernel, "_ends_of_route", lambda name: routes.get(names.get(name, name)))
    assert own_address(LinkDomain(domain_id=77, peer=peer, own=own))() == found


def test_a_process_without_a_link_domain_has_no_address_to_tell():
    """It tells all of its addresses, as any node."""
    assert own_address(None)() is None


@pytest.mark.parametrize(
    ("own", "peer", "is_refused"),
    [
        ("192.0.2.1", "10.0.0.5", True),
        ("", "10.0.0.5", True),
        ("10.0.0.5", "10.0.0.5", False),
        ("10.0.0.5", "192.0.2.1", False),
        ("", "127.0.0.1", False),
        ("debian", "10.0.0.5", False),
        ("10.0.0.5", "nowhere", False),
    ],
)
def test_an_end_on_the_computer_of_the_other_one_is_refused(tmp_path, monkeypatch, own, peer, is_refused):
    """The message tells what belongs there; where both ends are on one computer, each is at its place."""
    (file := tmp_path / "arpd.yaml").write_text(f"relay:\n  link_domain: 77\n  robot: {peer}\n  base: {peer}\n")
    routes = {"192.0.2.1": ("10.0.0.5", "192.0.2.1"), **{each: (each, each) for each in ("10.0.0.5", "127.0.0.1")}}
    routes["debian"] = ("127.0.0.1", "127.0.1.1")  # its own name
    monkeypatch.setattr(kernel, "_ends_of_route", routes.get)
    places = (False, "yaml:4:9: relay.base: .*arpd-relay-far"), (True, "yaml:3:10: relay.robot: .*arpd-relay belong")
    for is_far, said in places:
        with pytest.raises(ConfigError, match=said) if is_refused else nullcontext():
            check_place(file, LinkDomain(domain_id=77, peer=peer, own=own), is_far=is_far)
