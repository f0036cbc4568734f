"""The choice of the link interface, and its counters over time."""

import socket
from types import SimpleNamespace
from unittest.mock import Mock

import psutil
import pytest

from arpd.host import interface
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.observation import MemoryState

UP, DOWN = True, False
ROUTE = "Iface\tDestination\tGateway\neth0\t00000000\t0100000A\n"
CABLE, RADIO = "plain", "wireless"


@pytest.mark.parametrize(
    ("interfaces", "chosen"),
    [
        ({"eth0": (UP, CABLE), "wlan0": (DOWN, RADIO), "wlan1": (UP, RADIO)}, "wlan1"),
        ({"eth0": (UP, CABLE), "wg0": (UP, CABLE), "wlan0": (DOWN, RADIO)}, "eth0"),
        ({"usb0": (UP, CABLE)}, "usb0"),
        ({"usb1": (UP, CABLE), "usb2": (UP, CABLE)}, None),
    ],
)
def test_auto_takes_the_radio_then_the_default_route_then_the_only_one(tmp_path, monkeypatch, interfaces, chosen):
    """What is down is no link, and between two cables without a route arpd does not guess."""
    for name, (_, kind) in interfaces.items():
        (tmp_path / name / kind).mkdir(parents=True)
    monkeypatch.setattr(interface, "SYS_NET", tmp_path)
    (tmp_path / "route").write_text(ROUTE)
    monkeypatch.setattr(interface, "_PROC_ROUTE", tmp_path / "route")
    monkeypatch.setattr(interface, "interface_to", lambda _address: "wg0")  # a VPN takes all traffic
    monkeypatch.setattr(interface, "list_interfaces", lambda: ["lo", *interfaces])
    states = {UP: InterfaceState.UP, DOWN: InterfaceState.NO_CARRIER}
    kernel = Kernel()
    for name, (is_up, _) in interfaces.items():
        kernel.put(name, state=states[is_up])
    monkeypatch.setattr(interface, "read_counters", kernel.interfaces.get)
    assert interface.likeliest_interface() == chosen


# -- the interface over time


class Kernel:
    """Raw counters of interfaces by name."""

    def __init__(self):
        self.interfaces = {}
        self.now_s = 0.0

    def put(self, name, *, state=InterfaceState.UP, rx=(0, 0), dropped=0):
        self.interfaces[name] = LinkCounters(
            interface=name, rx_bytes=rx[0], rx_packets=rx[1], tx_bytes=0, tx_packets=0, tx_dropped=dropped, state=state
        )

    def reader(self, name, choose=lambda: None, addresses=dict, route=lambda: None):
        return interface.InterfaceReader(
            name,
            read=self.interfaces.get,
            route=route,
            choose=choose,
            is_radio=lambda name: name.startswith("wl"),
            addresses=addresses,
            clock=lambda: self.now_s,
        )


@pytest.fixture
def kernel():
    return Kernel()


def received(counters):
    assert counters is not None
    return counters.rx_bytes, counters.rx_packets


@pytest.mark.parametrize(
    ("before", "after"),
    [((2**32 - 100, 7_000_000), (900, 7_000_001)), ((10**12, 10**9), (300, 3)), ((4_000, 40), (3_999, 40))],
)
def test_a_counter_that_falls_adds_nothing_and_then_counts_on(kernel, before, after):
    """After a wrap, a restart of the driver or a slip back the total stays, and grows again from there."""
    reader = kernel.reader("wlan0")
    kernel.put("wlan0", rx=before, dropped=7)
    reader.read()
    kernel.put("wlan0", rx=after, dropped=2)
    counters = reader.read()
    assert (received(counters), counters.tx_dropped) == ((before[0], max(before[1], after[1])), 7)
    kernel.put("wlan0", rx=(after[0] + 1_000, after[1] + 1), dropped=4)
    counters = reader.read()
    assert (counters.rx_bytes, counters.tx_dropped) == (before[0] + 1_000, 9)


def test_an_interface_that_is_not_there_at_first_is_taken_when_it_comes(kernel):
    """A reader may be older than its interface, and tells that it is gone."""
    reader = kernel.reader("wlan0")
    assert [reader.read() for _ in range(3)] == [None, None, None]
    assert reader.state is InterfaceState.GONE
    kernel.put("wlan0", rx=(500, 5))
    assert (received(reader.read()), reader.state) == ((500, 5), InterfaceState.UP)


def test_auto_takes_what_comes_and_stays_with_a_radio_that_was_up(kernel, caplog):
    """A late radio replaces a cable; a radio that was up stays the link, however long it is away."""
    caplog.set_level("INFO")
    choice: list[str | None] = [None]
    reader = kernel.reader("auto", choose=lambda: choice[0])
    assert (reader.read(), reader.name) == (None, "auto")
    kernel.put("eth0", state=InterfaceState.NO_CARRIER, rx=(900, 9))
    choice[0] = "eth0"
    assert (reader.read().interface, reader.name) == ("eth0", "eth0")
    kernel.put("wlan0", rx=(500, 5))
    choice[0] = "wlan0"
    assert (received(reader.read()), reader.name) == ((900, 9), "wlan0")  # a total that falls is no report of a peer
    choice[0] = "eth0"
    kernel.put("wlan0", state=InterfaceState.NO_CARRIER, rx=(600, 6))
    for _ in range(20):
        kernel.now_s += 1.0
        assert (received(reader.read()), reader.name) == ((1000, 10), "wlan0")
    assert len(caplog.records) == 2, "each choice"


def test_auto_takes_another_radio_in_the_place_of_one_that_is_gone(kernel):
    """A dongle that returns with another name and address, or is replaced, is the link; a cable is not."""
    choice = ["wlan0"]
    reader = kernel.reader("auto", choose=lambda: choice[0], addresses=lambda: {"wlan0": frozenset({"10.0.0.1"})})
    kernel.put("wlan0", rx=(900, 9))
    kernel.put("eth0")
    kernel.put("wlan1", rx=(5, 5))
    reader.read()
    choice[0] = "wlan1"
    kernel.now_s += 60.0
    assert (received(reader.read()), reader.name) == ((900, 9), "wlan0")
    del kernel.interfaces["wlan0"]
    names = []
    for choice[0] in ("eth0", "wlan1"):
        for _ in range(20):
            kernel.now_s += 1.0
            reader.read()
        names.append(reader.name)
    assert names == ["wlan0", "wlan1"]


def test_auto_leaves_a_cable_that_is_pulled_and_one_beside_a_radio(kernel):
    """A robot that boots at its cable measures its radio later; one without a radio, what carries its traffic."""
    choice = ["eth0"]
    reader = kernel.reader("auto", choose=lambda: choice[0])
    kernel.put("eth0", rx=(900, 9))
    kernel.put("eth1", rx=(70_000, 70))
    reader.read()
    choice[0] = "eth1"
    kernel.now_s += 60.0
    assert (received(reader.read()), reader.name) == ((900, 9), "eth0")  # it is up, and may carry the traffic
    kernel.put("eth0", state=InterfaceState.NO_CARRIER, rx=(900, 9))
    names = []
    for _ in range(15):
        kernel.now_s += 1.0
        counters = reader.read()
        names.append(reader.name)
    assert (names.count("eth0"), received(counters)) == (10, (900, 9))
    kernel.put("wlan0", rx=(5, 5))
    choice[0] = "wlan0"
    kernel.now_s += 1.0
    assert (received(reader.read()), reader.name) == ((900, 9), "wlan0")


def test_auto_follows_the_route_to_the_other_end(kernel):
    """One that comes late, or returns with a bridge that started again, leads to the link; a short detour does not."""
    route = ["eth0"]
    reader = kernel.reader("auto", route=lambda: route[0])
    kernel.put("eth0")
    kernel.put("eth1")
    names = []
    for leads_to, lasts_s in (("eth0", 5), ("eth1", 20), ("eth0", 5), ("eth1", 5), ("eth0", 20), ("eth1", 20)):
        route[0] = leads_to
        for _ in range(lasts_s):
            kernel.now_s += 1.0
            reader.read()
        names.append(reader.name)
    assert names == ["eth0", "eth1", "eth1", "eth1", "eth0", "eth1"]


@pytest.mark.parametrize(("configured", "followed"), [("auto", "wlan1"), ("wlan0", "wlan0")])
def test_auto_follows_the_address_of_an_interface_that_is_gone(kernel, configured, followed):
    """One that is renamed, or replaced by another that gets its address, is the link still; a cable is not."""
    addresses = {}
    reader = kernel.reader(configured, choose=lambda: "wlan0", addresses=lambda: addresses)
    kernel.put("wlan0", rx=(1000, 10))
    reader.read()
    addresses |= {"wlan0": frozenset({"10.0.0.1"}), "eth0": frozenset({"10.9.0.1"})}  # it comes by DHCP
    kernel.put("eth0")
    reader.read()
    kernel.interfaces["wlan1"] = kernel.interfaces.pop("wlan0")
    assert reader.read() is None
    addresses["wlan1"] = addresses.pop("wlan0")
    kernel.put("wlan1", rx=(1500, 15))
    after = reader.read()
    assert reader.name == followed
    assert after is None or received(after) == (1000, 10)
    kernel.put("wlan1", rx=(1600, 16))
    assert (reader.read() is None) == (configured == "wlan0")


def test_an_interface_that_loses_its_address_carries_nothing(kernel):
    """A lease that ran out: after three seconds it says so, until it has one again; a bridge may have taken it."""
    addresses = {"wlan0": frozenset({"10.0.0.1"})}
    reader = kernel.reader("wlan0", addresses=lambda: addresses)
    kernel.put("wlan0")

    def states(found):
        addresses.clear()
        addresses.update(found)
        for _second in range(4):
            kernel.now_s += 1.0
            yield reader.read().state

    assert {*states({"wlan0": frozenset({"10.0.0.2"})})} == {InterfaceState.UP}
    assert {*states({"br0": frozenset({"10.0.0.2"})})} == {InterfaceState.UP}
    up, no = InterfaceState.UP, InterfaceState.NO_ADDRESS
    assert [*states({"lo": frozenset({"127.0.0.1"})})] == [up, up, no, no]
    assert {*states({"wlan0": frozenset({"10.0.0.3"})})} == {up}
    assert {*kernel_without_addresses(kernel)} == {up}, "one that never had any may be a bridge's"


def kernel_without_addresses(kernel):
    reader = kernel.reader("wlan0")
    for _second in range(9):
        kernel.now_s += 1.0
        yield reader.read().state


def test_an_interface_made_anew_goes_on_where_the_last_stood(kernel):
    """A radio that is plugged in again continues the totals without a jump, even if its counters are higher."""
    reader = kernel.reader("wlan0")
    kernel.put("wlan0", rx=(5_000, 50))
    reader.read()
    kernel.interfaces.clear()
    assert reader.read() is None
    kernel.put("wlan0", rx=(70_000, 70))
    assert received(reader.read()) == (5_000, 50)
    kernel.put("wlan0", rx=(70_500, 75))
    assert received(reader.read()) == (5_500, 55)


# -- the kernel


def test_what_is_down_has_no_address_that_dds_takes(monkeypatch):
    """A static address stays on an interface without a carrier, and a process that starts then never uses it."""
    address = SimpleNamespace(family=socket.AF_INET, address="10.0.0.1")
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: {name: [address] for name in ("wlan0", "wlan1", "wlan2")})
    monkeypatch.setattr(
        psutil, "net_if_stats", lambda: {name: SimpleNamespace(isup=name == "wlan0") for name in ("wlan0", "wlan1")}
    )
    assert interface.running_addresses() == {"wlan0": frozenset({"10.0.0.1"})}


def test_an_address_with_a_label_is_that_of_its_interface(monkeypatch):
    """Ifupdown and keepalived label addresses, and the C library tells the label for the name."""
    told = {
        name: [SimpleNamespace(family=socket.AF_INET, address=f"10.0.0.{number}")]
        for number, name in enumerate(("eth0", "eth0:1", "eth1:vip"))
    }
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: told)
    assert interface.ipv4_addresses() == {"eth0": {"10.0.0.0", "10.0.0.1"}, "eth1": {"10.0.0.2"}}


def test_a_kernel_that_does_not_answer_is_no_error(tmp_path, monkeypatch):
    """If no file can be opened, there is no interface, address or choice, and nothing raises."""
    refuse = Mock(side_effect=OSError(24, "Too many open files"))
    for name in ("net_if_addrs", "net_if_stats", "virtual_memory"):
        monkeypatch.setattr(psutil, name, refuse)
    for name in ("socket", "if_nameindex", "if_nametoindex"):
        monkeypatch.setattr(socket, name, refuse)
    assert (interface.read_counters("lo"), interface.ipv4_addresses(), interface.running_addresses()) == (None, {}, {})
    assert (interface.likeliest_interface(), interface.list_interfaces()) == (None, None)
    assert interface.InterfaceReader("auto").read() is None
    before = MemoryState(total_bytes=8, available_bytes=3)
    assert interface.read_memory(before) == before
    monkeypatch.setattr(interface, "SYS_NET", tmp_path)
    assert not interface.is_radio(300 * "w")  # a path that the kernel refuses, as it does in a sandbox without /sys
