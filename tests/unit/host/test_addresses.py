"""Addresses that DDS in this process does not know."""

from __future__ import annotations

from arpd.host.addresses import Addresses


class Host:
    """Interfaces and their addresses, and a clock."""

    def __init__(self, **addresses):
        self.now_s = 100.0
        self.by_interface = addresses
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
