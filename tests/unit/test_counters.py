"""Which interface is the link."""

from types import SimpleNamespace

import pytest

from arpd.errors import LinkError
from arpd.host.counters import choose_interface

UP, DOWN = SimpleNamespace(isup=True), SimpleNamespace(isup=False)
ROUTE = "Iface\tDestination\tGateway\neth0\t00000000\t0100000A\n"


@pytest.fixture
def host(tmp_path):
    """Make a host of interfaces: name → (state, is wireless)."""

    def make(**interfaces):
        for name, (_, wireless) in interfaces.items():
            (tmp_path / name / ("wireless" if wireless else "plain")).mkdir(parents=True)
        route = tmp_path / "route"
        route.write_text(ROUTE)
        names = {"lo": UP, **{name: state for name, (state, _) in interfaces.items()}}
        return lambda wanted: choose_interface(wanted, sys_net=tmp_path, route=route, names=lambda: names)

    return make


def test_auto_prefers_a_wireless_interface_that_is_up(host):
    """Of two radios the one that is up is the link, whatever the route says."""
    choose = host(eth0=(UP, False), wlan0=(DOWN, True), wlan1=(UP, True))
    assert choose("auto") == "wlan1"


def test_auto_takes_the_default_route_without_a_radio(host):
    """Without a radio that is up, the default route tells."""
    assert host(eth0=(UP, False), eth1=(UP, False), wlan0=(DOWN, True))("auto") == "eth0"


def test_an_interface_that_is_not_there_is_named(host):
    """The error names what exists."""
    with pytest.raises(LinkError, match=r"wlan9.*does not exist.*eth0, lo"):
        host(eth0=(UP, False))("wlan9")
