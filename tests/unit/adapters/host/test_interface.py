"""The choice of the link interface, and its counters over time."""

import fcntl
import socket
import struct
from types import SimpleNamespace

import psutil
import pytest

from arpd.adapters.host.interface import (
    InterfaceReader,
    MemoryReader,
    hardware_address,
    index_of,
    ipv4_addresses,
    likeliest_interface,
    list_interfaces,
    read_counters,
    read_speed,
)
from arpd.model.interface import InterfaceState, LinkCounters, state_of

UP, DOWN = True, False
UP_AND_RUNNING = 0x41
ROUTE = "Iface\tDestination\tGateway\neth0\t00000000\t0100000A\n"


@pytest.fixture
def host(tmp_path):
    """Return a function that chooses on a host of interfaces: name → (state, is wireless)."""

    def choose(**interfaces):
        for name, (_, wireless) in interfaces.items():
            (tmp_path / name / ("wireless" if wireless else "plain")).mkdir(parents=True)
        route = tmp_path / "route"
        route.write_text(ROUTE)
        return likeliest_interface(
            sys_net=tmp_path,
            route=route,
            names=lambda: ["lo", *interfaces],
            is_running=lambda name: interfaces[name][0] is UP,
        )

    return choose


def test_auto_prefers_a_wireless_interface_that_is_up(host):
    """The radio that is up is the link, even if the route leads elsewhere."""
    assert host(eth0=(UP, False), wlan0=(DOWN, True), wlan1=(UP, True)) == "wlan1"


def test_auto_takes_the_default_route_without_a_radio(host):
    """Without a radio that is up, the link has the default route."""
    assert host(eth0=(UP, False), eth1=(UP, False), wlan0=(DOWN, True)) == "eth0"


def test_auto_takes_the_only_one_there_is_and_does_not_guess(host):
    """Without a radio or a route, a lone interface is the link; with two there is no link."""
    assert host(usb0=(UP, False)) == "usb0"
    assert host(usb1=(UP, False), usb2=(UP, False)) is None


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


def test_a_change_of_state_is_logged_once(kernel, caplog):
    """The log names every state once, when it begins."""
    caplog.set_level("INFO")
    reader = kernel.reader("wlan0")
    for state in (InterfaceState.UP, InterfaceState.NO_CARRIER, InterfaceState.DOWN, None, InterfaceState.UP):
        kernel.interfaces.clear()
        if state is not None:
            kernel.put(3, "wlan0", state=state)
        for _ in range(3):
            assert state_of(reader.read()) is (state or InterfaceState.GONE)
    said = [record.getMessage() for record in caplog.records]
    words = ("has no carrier", "is switched off", "is gone", "is up again")
    assert len(said) == len(words)
    assert all(f"wlan0 {word}" in message for word, message in zip(words, said, strict=True))


def test_an_interface_that_is_not_there_at_first_is_taken_when_it_comes(kernel, caplog):
    """A reader may be older than its interface; the log names the missing interface once."""
    reader = kernel.reader("wlan0")
    assert [reader.read() for _ in range(3)] == [None, None, None]
    assert [record.message for record in caplog.records] == [
        "the link interface wlan0 is not there yet; arpd waits for it"
    ]
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
    assert [record.message for record in caplog.records] == [
        "link.interface is auto and no interface looks like the link yet; arpd uses the first that does",
        "link.interface is auto: arpd uses eth0",
        "the link interface eth0 has no carrier",
        "link.interface is auto: arpd uses wlan0",
        "the link interface wlan0 has no carrier",
    ]


def test_a_renamed_interface_is_followed(kernel, caplog):
    """A renamed interface counts on, and the log names the new name once."""
    reader = kernel.reader("wlan0")
    kernel.put(3, "wlan0", rx=(500, 5))
    reader.read()
    for size in (700, 900):
        kernel.put(3, "uplink", rx=(size, 7))
        counters = reader.read()
        assert (counters.interface, counters.rx_bytes, reader.index) == ("uplink", size, 3)
    assert [record.getMessage() for record in caplog.records] == [
        "the link interface wlan0 is now called uplink; arpd follows it"
    ]


def test_a_stranger_that_takes_the_name_is_not_the_link(kernel):
    """After a rename, the kernel's number identifies the link, not the name."""
    reader = kernel.reader("wlan0")
    kernel.put(3, "wlan0", rx=(500, 5))
    reader.read()
    kernel.put(3, "wlan1", rx=(600, 6))
    kernel.put(4, "wlan0", rx=(90_000, 900))
    assert received(reader.read()) == (600, 6)


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


def test_an_interface_replaced_between_two_readings_does_not_jump(kernel):
    """The past traffic of a new interface under the same name is not added."""
    reader = kernel.reader("wlan0")
    kernel.put(3, "wlan0", rx=(500, 5))
    reader.read()
    kernel.interfaces.clear()
    kernel.put(4, "wlan0", rx=(10**10, 10**7))
    assert received(reader.read()) == (500, 5)


# -- the kernel


def test_loopback_reads_up():
    """The kernel answers for loopback, and has no answer for a missing interface."""
    counters = InterfaceReader("lo").read()
    assert counters is not None
    assert (counters.interface, counters.state, counters.backlog_bytes) == ("lo", InterfaceState.UP, None)
    assert counters.rx_bytes == counters.tx_bytes > 0
    assert (read_counters(999_999), index_of("none9")) == (None, None)
    assert (hardware_address("lo"), hardware_address("none9")) == ("", "")


@pytest.fixture
def device_file(monkeypatch, tmp_path):
    """Return /proc/net/dev as this test's own file."""
    file = tmp_path / "net" / "dev"
    file.parent.mkdir()
    monkeypatch.setattr(psutil, "PROCFS_PATH", str(tmp_path))
    return file


def answer(flags):
    """Return a request for flags as the kernel fills it (netdevice(7))."""
    return bytes(16) + struct.pack("=H", flags) + bytes(22)


@pytest.mark.parametrize(
    ("flags", "state"),
    [
        (0x0, InterfaceState.DOWN),
        (0x1002, InterfaceState.DOWN),
        (0x1, InterfaceState.NO_CARRIER),
        (UP_AND_RUNNING, InterfaceState.UP),
        (UP_AND_RUNNING | 0x1002, InterfaceState.UP),
    ],
)
def test_flags_tell_why_nothing_is_carried(monkeypatch, flags, state):
    """An interface without carrier differs from one that is switched off, whatever the other flags are."""
    monkeypatch.setattr(fcntl, "ioctl", lambda *_: answer(flags))
    assert state_of(read_counters(socket.if_nametoindex("lo"))) is state


def devices(**fields):
    """Return a text as /proc/net/dev has it: eight numbers received, eight sent."""
    return "\n\n" + "".join(f"{name}: {' '.join(map(str, numbers))}\n" for name, numbers in fields.items())


def test_every_counter_is_the_interface_s_own(device_file):
    """Of two interfaces with more counters than arpd reads, each total is the right one, beyond 32 bits too."""
    device_file.write_text(devices(wlan0=[1] * 16, lo=[2**40, 2, 3, 4, 5, 6, 7, 8, 2**41, 10, 11, 12, 13, 14, 15, 16]))
    counters = read_counters(socket.if_nametoindex("lo"))
    assert counters == LinkCounters(
        interface="lo",
        rx_bytes=2**40,
        rx_packets=2,
        tx_bytes=2**41,
        tx_packets=10,
        tx_dropped=12,
        state=InterfaceState.UP,
    )


def test_an_interface_whose_name_changes_hands_does_not_jump(device_file, monkeypatch):
    """The link that takes the name of a busier interface, and gives its own away, counts on from its own numbers."""
    names = {1: "lo", 2: "eth7"}
    monkeypatch.setattr(socket, "if_indextoname", names.get)
    monkeypatch.setattr(fcntl, "ioctl", lambda *_: answer(UP_AND_RUNNING))
    reader = InterfaceReader("lo")
    device_file.write_text(devices(lo=[500] * 16, eth7=[90_000] * 16))
    reader.read()
    names[1], names[2] = "eth7", "lo"
    device_file.write_text(devices(lo=[90_000] * 16, eth7=[700] * 16))
    assert (received(reader.read()), reader.name) == ((700, 700), "eth7")


def test_a_rename_between_two_questions_does_not_lose_the_interface(device_file, monkeypatch):
    """If the name has changed when the counters are read, arpd asks again."""
    names = iter(["old", "lo"])
    monkeypatch.setattr(socket, "if_indextoname", lambda _: next(names))
    device_file.write_text(devices(lo=[5] * 16))
    assert received(read_counters(1)) == (5, 5)


def test_the_end_of_the_address_tells_two_hosts_apart(monkeypatch):
    """Only the digits of an Ethernet address are returned."""
    addresses = [
        SimpleNamespace(family=2, address="10.0.0.1"),
        SimpleNamespace(family=psutil.AF_LINK, address="B8:27:EB:12:3f:2A"),
    ]
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: {"wlan0": addresses})
    assert hardware_address("wlan0") == "b827eb123f2a"


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


def test_a_driver_that_cannot_be_asked_its_speed_hides_no_interface(monkeypatch, tmp_path):
    """Where drivers cannot be asked, as under qemu-user, only the speed is unknown."""

    def refuse():
        raise OSError(38, "[Errno 38] Function not implemented (originated from ioctl(SIOCETHTOOL))")

    monkeypatch.setattr(psutil, "net_if_stats", refuse)
    (tmp_path / "lo" / "device").mkdir(parents=True)
    (tmp_path / "lo" / "wireless").mkdir()
    names = list_interfaces()
    assert names is not None
    assert "lo" in names
    assert read_speed("lo", sys_net=tmp_path) is None
    radio = tmp_path / "wlan0" / "wireless"
    radio.mkdir(parents=True)
    monkeypatch.setattr("arpd.adapters.host.interface.socket.if_nameindex", lambda: [(1, "lo"), (2, "wlan0")])
    ask = fcntl.ioctl
    monkeypatch.setattr(fcntl, "ioctl", lambda to, what, request: ask(to, what, request.replace(b"wlan0", b"lo\0\0\0")))
    assert likeliest_interface(sys_net=tmp_path) == "wlan0"


def test_memory_that_cannot_be_read_is_what_it_was(caplog):
    """Memory is zero at first, and the last reading stays when the kernel does not answer."""
    answers = iter(
        [None, SimpleNamespace(total=100, available=40), None, None, SimpleNamespace(total=100, available=30)]
    )

    def read():
        if (answer := next(answers)) is None:
            raise OSError(24, "Too many open files")
        return answer

    memory = MemoryReader(read)
    assert [memory.read().available_bytes for _ in range(5)] == [0, 40, 40, 40, 30]
    assert len(caplog.records) == 2
