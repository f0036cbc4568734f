"""The address on the link, and addresses that DDS in this process does not know."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from arpd.host import addresses
from arpd.host.addresses import Addresses, own_address
from arpd.model.errors import ConfigError
from arpd.model.settings import LinkDomain


class Host:
    """Interfaces and their addresses, and a clock."""

    def __init__(self, **by_interface):
        self.now_s = 100.0
        self.by_interface = by_interface
        self.link, self.own = "wlan0", None
        self.addresses = self.began()

    def began(self):
        return Addresses(lambda: self.link, own=lambda: self.own, addresses=self.known, clock=lambda: self.now_s)

    def known(self):
        return {name: frozenset([address]) for name, address in self.by_interface.items()}

    def are_outdated(self, after_s):
        until_s = self.now_s + after_s
        while self.now_s < until_s:
            self.now_s += 0.1
            if self.addresses.are_outdated():
                return True
        return False


def test_an_address_that_comes_to_the_link_calls_for_a_new_process():
    """A late or changed address of the link needs a new process, after a few seconds in which more may come."""
    late = Host(lo="127.0.0.1")
    assert not late.are_outdated(60.0)
    late.by_interface["wlan0"] = "10.0.0.5"
    assert not late.are_outdated(2.5)
    assert late.are_outdated(3.0)
    renumbered = Host(wlan0="10.0.0.5")
    renumbered.by_interface["wlan0"] = "10.0.0.77"
    assert renumbered.are_outdated(6.0)


def test_addresses_that_are_known_or_not_of_the_link_call_for_nothing():
    """The link's address may go and return, others may pass or come elsewhere, and the link may be chosen late."""
    host = Host(wlan0="10.0.0.5", eth0="192.168.1.2")
    assert not host.are_outdated(1.0)
    del host.by_interface["wlan0"]
    assert not host.are_outdated(30.0)
    host.by_interface |= {"wlan0": "10.0.0.5", "docker0": "172.17.0.1"}
    assert not host.are_outdated(30.0)
    host.by_interface["wlan0"] = "169.254.3.4"
    assert not host.are_outdated(2.0)
    host.by_interface["wlan0"] = "10.0.0.5"
    assert not host.are_outdated(30.0)
    host.link = "eth0"
    assert not host.are_outdated(30.0)


def test_an_address_that_is_away_while_ros_starts_calls_for_a_new_process():
    """A link that flaps at the start was there before ROS read its addresses, and may not have been when it did."""
    host = Host(lo="127.0.0.1", wlan0="10.0.0.5")
    del host.by_interface["wlan0"]
    assert not host.are_outdated(5.0)
    host.by_interface["wlan0"] = "10.0.0.5"
    assert host.are_outdated(6.0)


def test_a_link_that_moves_to_another_network_calls_for_a_new_process():
    """The other end knows one address; to be away from it for a moment, or without any route, calls for nothing."""
    host = Host(wlan0="10.0.0.5", eth0="192.168.1.2")
    host.own = "192.168.1.2"
    host.addresses = host.began()
    host.link = "eth0"
    for own in ("192.168.1.2", None, "10.0.0.5"):
        host.own = own
        assert not host.are_outdated(9.0)
    host.own = "192.168.1.2"
    assert not host.are_outdated(30.0)
    host.own = "10.0.0.5"
    assert host.are_outdated(12.0)


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
    monkeypatch.setattr(addresses, "ends_of_route", lambda name: routes.get(names.get(name, name)))
    assert own_address(None, LinkDomain(domain_id=77, peer=peer, own=own), is_far=False)() == found


def test_a_process_without_a_link_domain_has_no_address_to_tell():
    """It tells all of its addresses, as any node."""
    assert own_address(None, None, is_far=False)() is None


@pytest.mark.parametrize(
    ("own", "peer", "is_refused"),
    [
        ("192.0.2.1", "10.0.0.5", True),
        ("", "10.0.0.5", True),
        ("10.0.0.5", "10.0.0.5", False),
        ("10.0.0.5", "192.0.2.1", False),
        ("", "127.0.0.1", False),
        ("debian", "10.0.0.5", False),
        ("debian", "127.0.0.1", False),
        ("10.0.0.5", "debian", True),
        ("192.0.2.1", "debian", True),
        ("10.0.0.5", "nowhere", False),
    ],
)
def test_an_end_on_the_computer_of_the_other_one_is_refused(tmp_path, monkeypatch, own, peer, is_refused):
    """The message tells what belongs there; where both ends are on one computer, each is at its place."""
    (file := tmp_path / "arpd.yaml").write_text(f"relay:\n  link_domain: 77\n  robot: {peer}\n  base: {peer}\n")
    routes = {"192.0.2.1": ("10.0.0.5", "192.0.2.1"), **{each: (each, each) for each in ("10.0.0.5", "127.0.0.1")}}
    routes["debian"] = ("127.0.0.1", "127.0.1.1")  # its own name
    monkeypatch.setattr(addresses, "ends_of_route", routes.get)
    places = (False, "yaml:4:9: relay.base: .*arpd-relay-far"), (True, "yaml:3:10: relay.robot: .*arpd-relay belong")
    for is_far, said in places:
        with pytest.raises(ConfigError, match=said) if is_refused else nullcontext():
            own_address(file, LinkDomain(domain_id=77, peer=peer, own=own), is_far=is_far)
