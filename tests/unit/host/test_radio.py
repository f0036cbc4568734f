"""The radio: nl80211's answers as the kernel encodes them, and every reason for an unknown rate."""

from __future__ import annotations

import struct
from errno import ENODEV

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from pyroute2.netlink.nl80211 import nl80211cmd

from arpd.host import radio
from arpd.host.radio import Radio, transmit_rate
from arpd.model.errors import NotKnownError

# linux/nl80211.h
ATTR_WIPHY, ATTR_IFINDEX, ATTR_MAC, ATTR_STA_INFO, ATTR_REG_ALPHA2, ATTR_PS_STATE = 1, 3, 6, 21, 33, 93
STA_INFO_SIGNAL, STA_INFO_TX_BITRATE, STA_INFO_RX_BITRATE = 7, 8, 14
RATE_BITRATE, RATE_BITRATE32 = 1, 5
CMD_NEW_STATION = 19
NESTED = 0x8000


def attribute(kind, value, *, nested=False):
    """Return one netlink attribute: length, type, value, padded to four bytes (netlink(7))."""
    if nested:
        kind, value = kind | NESTED, b"".join(value)
    return struct.pack("HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def rate(kind, *, bitrate):
    parts = [attribute(RATE_BITRATE, struct.pack("H", bitrate)), attribute(RATE_BITRATE32, struct.pack("I", bitrate))]
    return attribute(kind, parts, nested=True)


def answer(*attributes):
    """Decode an answer of the kernel."""
    body = struct.pack("BBH", CMD_NEW_STATION, 1, 0) + b"".join(attributes)
    message = nl80211cmd(struct.pack("IHHII", 16 + len(body), 27, 2, 1, 0) + body)
    message.decode()
    return message


def station(*info):
    """Decode an answer of the kernel about one station."""
    station = attribute(ATTR_IFINDEX, struct.pack("I", 3)), attribute(ATTR_MAC, bytes(range(6)))
    return answer(*station, *([attribute(ATTR_STA_INFO, info, nested=True)] if info else []))


def test_the_rate_is_told_in_bytes_per_second():
    """The transmit rate of 866.7 Mbit/s is converted; the receive rate beside it is ignored."""
    found = station(
        attribute(STA_INFO_SIGNAL, b"\xc4"),
        rate(STA_INFO_TX_BITRATE, bitrate=8667),
        rate(STA_INFO_RX_BITRATE, bitrate=60),
    )
    assert transmit_rate([found]) == pytest.approx(866.7e6 / 8)


@pytest.mark.parametrize(
    "stations",
    [
        [],
        [station()],
        [station(attribute(STA_INFO_SIGNAL, b"\xc4"))],
        [station(rate(STA_INFO_TX_BITRATE, bitrate=0))],
    ],
)
def test_a_station_that_tells_no_rate_bounds_nothing(stations):
    """Without an access point, or before the first frame, which some drivers tell as zero, there is no rate."""
    assert transmit_rate(stations) is None


@pytest.fixture
def sys_net(tmp_path, monkeypatch):
    monkeypatch.setattr("arpd.host.radio.index_of", {"wlan0": 3, "eth0": 2}.get)
    (tmp_path / "wlan0/phy80211").mkdir(parents=True)
    (tmp_path / "wlan0/phy80211/index").write_text("1\n")
    return tmp_path


@pytest.mark.parametrize(
    "fault",
    [
        PermissionError(1, "Operation not permitted"),
        OSError(ENODEV, "gone"),
        ImportError("no pyroute2"),
        KeyError("attr"),
    ],
)
def test_no_fault_of_the_radio_leaves_its_module(sys_net, caplog, fault):
    """Every fault gives None, and the log names it once while it stays the same."""
    caplog.set_level("INFO")

    def ask(_index):
        raise fault

    reader = Radio(ask=ask, sys_net=sys_net)
    assert [reader.read("wlan0", 3) for _ in range(3)] == [None] * 3
    assert len(caplog.records) == 1
    assert type(fault).__name__ in caplog.text


def told_power_save(state):
    return answer(attribute(ATTR_PS_STATE, struct.pack("I", state)))


def told_region(code, number=None):
    named = [] if number is None else [attribute(ATTR_WIPHY, struct.pack("I", number))]
    return answer(*named, attribute(ATTR_REG_ALPHA2, code.encode() + b"\0"))


def test_a_radio_is_read(sys_net):
    """Each question goes to the interface's number, and a radio's own regulatory domain counts."""
    asked = []

    def ask(*answers):
        def answer_to(index):
            asked.append(index)
            return answers

        return answer_to

    assert radio.power_save("wlan0", ask=ask(told_power_save(1)))
    assert radio.signal("wlan0", ask=ask(station(attribute(STA_INFO_SIGNAL, b"\xc4")))) == -60
    assert radio.region("wlan0", ask=ask(told_region("00"), told_region("DE", number=1)), sys_net=sys_net) == "DE"
    assert asked == [3, 3, 3]


@pytest.mark.usefixtures("sys_net")
def test_a_radio_that_refuses_is_not_known():
    """The error says why."""

    def refuse(_index):
        raise PermissionError(1, "Operation not permitted")

    with pytest.raises(NotKnownError, match="not permitted"):
        radio.power_save("wlan0", ask=refuse)
    with pytest.raises(NotKnownError, match="no signal now"):
        radio.signal("wlan0", ask=lambda _index: [])


@pytest.mark.parametrize(
    ("interface", "state", "radios"),
    [
        ("wg0", "up", ["wlan0"]),
        ("wg0", "down", []),
        ("wg0", None, []),
        ("eth0", "up", []),
        ("wlan0", "down", ["wlan0"]),
    ],
)
def test_the_radio_of_a_tunnel_is_one_that_is_up(sys_net, interface, state, radios):
    """A radio beside a wired interface carries other traffic."""
    (sys_net / "eth0/device").mkdir(parents=True)
    if state is not None:
        (sys_net / "wlan0/operstate").write_text(f"{state}\n")
    assert radio.radios_of(interface, sys_net=sys_net) == radios
