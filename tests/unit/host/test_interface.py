"""The choice of the link interface, and its counters over time."""

import socket

import psutil
import pytest

from arpd.host.interface import (
    InterfaceReader,
    hardware_address,
    ipv4_addresses,
    likeliest_interface,
    list_interfaces,
    read_counters,
)
from arpd.model.interface import InterfaceState, LinkCounters

UP, DOWN = True, False
ROUTE = "Iface\tDestination\tGateway\neth0\t00000000\t0100000A\n"
CABLE, RADIO = "plain", "wireless"


@pytest.mark.parametrize(
    ("interfaces", "chosen"),
    [
        ({"eth0": (UP, CABLE), "wlan0": (DOWN, RADIO), "wlan1": (UP, RADIO)}, "wlan1"),
        ({"eth0": (UP, CABLE), "eth1": (UP, CABLE), "wlan0": (DOWN, RADIO)}, "eth0"),
        ({"usb0": (UP, CABLE)}, "usb0"),
        ({"usb1": (UP, CABLE), "usb2": (UP, CABLE)}, None),
    ],
)
def test_auto_takes_the_radio_then_the_default_route_then_the_only_one(tmp_path, interfaces, chosen):
    """What is down is no link, and between two cables without a route arpd does not guess."""
    for name, (_, kind) in interfaces.items():
        (tmp_path / name / kind).mkdir(parents=True)
    (tmp_path / "route").write_text(ROUTE)
    found = likeliest_interface(
        sys_net=tmp_path,
        route=tmp_path / "route",
        names=lambda: ["lo", *interfaces],
        is_running=lambda name: interfaces[name][0] is UP,
    )
    assert found == chosen


# -- the interface over time


class Kernel:
    """Interfaces by number: name and raw counters."""

    def __init__(self):
        self.interfaces = {}

    def put(self, index, name, *, state=InterfaceState.UP, rx=(0, 0), tx=(0, 0), dropped=0):
        self.interfaces[index] = LinkCounters(
            interface=name,
            rx_bytes=rx[0],
            rx_packets=rx[1],
            tx_bytes=tx[0],
            tx_packets=tx[1],
            tx_dropped=dropped,
            state=state,
        )

    def reader(self, name, choose=lambda: None):
        def named(wanted):
            return next(((i, c) for i, c in self.interfaces.items() if c.interface == wanted), (None, None))

        return InterfaceReader(
            name,
            read=self.interfaces.get,
            index_of=lambda wanted: named(wanted)[0],
            choose=choose,
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
    kernel.put(3, "wlan0", rx=before, dropped=7)
    reader.read()
    kernel.put(3, "wlan0", rx=after, dropped=2)
    counters = reader.read()
    assert (received(counters), counters.tx_dropped) == ((before[0], max(before[1], after[1])), 7)
    kernel.put(3, "wlan0", rx=(after[0] + 1_000, after[1] + 1), dropped=4)
    counters = reader.read()
    assert (counters.rx_bytes, counters.tx_dropped) == (before[0] + 1_000, 9)


def test_an_interface_that_is_not_there_at_first_is_taken_when_it_comes(kernel, caplog):
    """A reader may be older than its interface; the log names the missing interface once."""
    reader = kernel.reader("wlan0")
    assert [reader.read() for _ in range(3)] == [None, None, None]
    (said,) = caplog.records
    assert "wlan0" in said.message
    kernel.put(3, "wlan0", rx=(500, 5))
    assert received(reader.read()) == (500, 5)


def test_auto_takes_what_comes_and_stays_with_what_was_up(kernel, caplog):
    """A late radio replaces an interface that was never up; an interface that was up stays the link."""
    caplog.set_level("INFO")
    choice: list[str | None] = [None]
    reader = kernel.reader("auto", choose=lambda: choice[0])
    assert (reader.read(), reader.name, reader.index) == (None, "auto", None)
    kernel.put(2, "eth0", state=InterfaceState.NO_CARRIER, rx=(900, 9))
    choice[0] = "eth0"
    assert (reader.read().interface, reader.name) == ("eth0", "eth0")
    kernel.put(3, "wlan0", rx=(500, 5))
    choice[0] = "wlan0"
    assert (received(reader.read()), reader.name, reader.index) == ((500, 5), "wlan0", 3)
    choice[0] = "eth0"
    kernel.put(3, "wlan0", state=InterfaceState.NO_CARRIER, rx=(600, 6))
    assert (received(reader.read()), reader.name) == ((600, 6), "wlan0")
    assert len(caplog.records) == 5


def test_a_renamed_interface_is_followed(kernel, caplog):
    """A renamed interface counts on, and the log names the new name once."""
    reader = kernel.reader("wlan0")
    kernel.put(3, "wlan0", rx=(500, 5))
    reader.read()
    for size in (700, 900):
        kernel.put(3, "uplink", rx=(size, 7))
        counters = reader.read()
        assert (counters.interface, counters.rx_bytes, reader.index) == ("uplink", size, 3)
    (said,) = caplog.records
    assert "uplink" in said.message


@pytest.mark.parametrize("name", ["wlan0", "uplink"])
def test_an_interface_made_anew_goes_on_where_the_last_stood(kernel, name):
    """A radio that is plugged in again under its configured or last name continues the totals without a jump."""
    reader = kernel.reader("wlan0")
    kernel.put(3, "wlan0", rx=(10**9, 10**6))
    reader.read()
    kernel.put(3, "uplink", rx=(10**9, 10**6))
    reader.read()
    kernel.interfaces.clear()
    assert (reader.read(), reader.index) == (None, None)
    kernel.put(9, name, rx=(70_000, 70))
    assert received(reader.read()) == (10**9, 10**6)
    kernel.put(9, name, rx=(70_500, 75))
    counters = reader.read()
    assert (counters.interface, *received(counters)) == (name, 10**9 + 500, 10**6 + 5)


# -- the kernel


def test_a_kernel_that_does_not_answer_is_no_error(monkeypatch):
    """If no file can be opened, there is no interface, address or choice, and nothing raises."""

    def refuse(*_arguments, **_options):
        raise OSError(24, "Too many open files")

    for name in ("net_if_stats", "net_if_addrs", "net_io_counters"):
        monkeypatch.setattr(psutil, name, refuse)
    for name in ("socket", "if_nameindex", "if_indextoname"):
        monkeypatch.setattr(socket, name, refuse)
    assert (read_counters(1), ipv4_addresses(), likeliest_interface()) == (None, {}, None)
    assert (list_interfaces(), hardware_address("lo")) == (None, "")
    assert InterfaceReader("auto").read() is None
