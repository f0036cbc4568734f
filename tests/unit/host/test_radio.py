"""The radio: nl80211's answers as pyroute2 decodes them, and every reason for an unknown rate."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from pyroute2.netlink.nl80211 import nl80211cmd

from arpd.host import interface, radio
from arpd.model.errors import NotKnownError


def answer(*attributes):
    """Return an answer of the kernel, encoded and decoded."""
    message, decoded = nl80211cmd(), nl80211cmd()
    message["attrs"] = [(f"NL80211_ATTR_{name}", value) for name, value in attributes]
    message.encode()
    decoded.data = message.data
    decoded.decode()
    return decoded


def station(**info):
    """Return an answer about one station; a number of a rate is its bit rate (100 kbit/s)."""
    rate = "NL80211_RATE_INFO_BITRATE"
    nested = {
        name: {"attrs": [(rate, value), (f"{rate}32", value)]} if name.endswith("RATE") else value
        for name, value in info.items()
    }
    return answer(("STA_INFO", {"attrs": [(f"NL80211_STA_INFO_{name}", value) for name, value in nested.items()]}))


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


def test_a_radio_is_read(kernel):
    """A rate of 866.7 Mbit/s is told in bytes; the receive rate is ignored; a radio's own regulatory domain counts."""
    kernel(station(SIGNAL=-60, TX_BITRATE=8667, RX_BITRATE=60))
    assert radio.transmit_rate("wlan0") == pytest.approx(866.7e6 / 8)
    assert radio.signal("wlan0") == -60
    kernel(answer(("PS_STATE", struct.pack("I", 1))))
    assert radio.power_save("wlan0")
    kernel(answer(("REG_ALPHA2", "00")), answer(("WIPHY", 1), ("REG_ALPHA2", "DE")))
    assert radio.region("wlan0") == "DE"


@pytest.mark.parametrize("stations", [[], [{}], [{"SIGNAL": -60}], [{"TX_BITRATE": 0}]])
def test_a_station_that_tells_no_rate_bounds_nothing(kernel, stations):
    """Without an access point, or before the first frame, which some drivers tell as zero, there is no rate."""
    kernel(*(station(**info) for info in stations))
    with pytest.raises(NotKnownError, match="no bit rate now"):
        radio.transmit_rate("wlan0")


@pytest.mark.parametrize(
    "fault", [PermissionError(1, "Operation not permitted"), ImportError("no pyroute2"), KeyError("a")]
)
@pytest.mark.usefixtures("sys_net")
def test_no_fault_of_the_radio_leaves_its_module(monkeypatch, fault):
    """The error says why nothing is known."""
    monkeypatch.setattr(radio, "_ask", Mock(side_effect=fault))
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
