"""The radio: nl80211's answers as the kernel encodes them, and every reason for an unknown rate."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from pyroute2.netlink.nl80211 import nl80211cmd

from arpd.host import interface, radio
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


@pytest.fixture
def sys_net(tmp_path, monkeypatch):
    monkeypatch.setattr(radio, "index_of", {"wlan0": 3, "eth0": 2}.get)
    for module in (interface, radio):
        monkeypatch.setattr(module, "SYS_NET", tmp_path)
    for folder in ("wlan0/phy80211", "wlan0/wireless", "eth0/device"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "wlan0/phy80211/index").write_text("1\n")
    return tmp_path


@pytest.fixture
def kernel(sys_net, monkeypatch):
    """Let nl80211 give these answers."""

    def give(*answers):
        monkeypatch.setattr(radio, "_ask", lambda _command, index: answers if index == 3 else [])

    return give


def told_region(code, number=None):
    named = [] if number is None else [attribute(ATTR_WIPHY, struct.pack("I", number))]
    return answer(*named, attribute(ATTR_REG_ALPHA2, code.encode() + b"\0"))


def test_a_radio_is_read(kernel):
    """A rate of 866.7 Mbit/s is told in bytes; the receive rate is ignored; a radio's own regulatory domain counts."""
    signal = attribute(STA_INFO_SIGNAL, b"\xc4")
    kernel(station(signal, rate(STA_INFO_TX_BITRATE, bitrate=8667), rate(STA_INFO_RX_BITRATE, bitrate=60)))
    assert radio.transmit_rate("wlan0") == pytest.approx(866.7e6 / 8)
    assert radio.signal("wlan0") == -60
    kernel(answer(attribute(ATTR_PS_STATE, struct.pack("I", 1))))
    assert radio.power_save("wlan0")
    kernel(told_region("00"), told_region("DE", number=1))
    assert radio.region("wlan0") == "DE"


@pytest.mark.parametrize(
    "info", [None, [], [attribute(STA_INFO_SIGNAL, b"\xc4")], [rate(STA_INFO_TX_BITRATE, bitrate=0)]]
)
def test_a_station_that_tells_no_rate_bounds_nothing(kernel, info):
    """Without an access point, or before the first frame, which some drivers tell as zero, there is no rate."""
    kernel(*([] if info is None else [station(*info)]))
    with pytest.raises(NotKnownError, match="no bit rate now"):
        radio.transmit_rate("wlan0")


@pytest.mark.parametrize(
    "fault", [PermissionError(1, "Operation not permitted"), ImportError("no pyroute2"), KeyError("a")]
)
@pytest.mark.usefixtures("sys_net")
def test_no_fault_of_the_radio_leaves_its_module(monkeypatch, fault):
    """The error says why nothing is known."""

    def refuse(_command, _index):
        raise fault

    monkeypatch.setattr(radio, "_ask", refuse)
    with pytest.raises(NotKnownError, match=type(fault).__name__):
        radio.power_save("wlan0")


@pytest.mark.parametrize(
    ("name", "is_up", "radios"),
    [("wg0", True, ["wlan0"]), ("wg0", False, []), ("eth0", True, []), ("wlan0", False, ["wlan0"])],
)
@pytest.mark.usefixtures("sys_net")
def test_the_radio_of_a_tunnel_is_one_that_is_up(monkeypatch, name, is_up, radios):
    """A radio beside a wired interface carries other traffic."""
    monkeypatch.setattr(interface, "list_interfaces", lambda: ["eth0", "wg0", "wlan0"])
    monkeypatch.setattr(interface, "read_counters", lambda _name: SimpleNamespace(is_up=is_up))
    assert radio.radios_of(name) == radios
