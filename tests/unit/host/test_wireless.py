"""Power save, signal and regulatory domain: nl80211's answers as the kernel encodes them."""

from __future__ import annotations

import struct

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from pyroute2.netlink.nl80211 import nl80211cmd

from arpd.host import wireless
from arpd.model.errors import NotKnownError
from tests.unit.host.test_radio import ATTR_STA_INFO, STA_INFO_SIGNAL, attribute

# linux/nl80211.h
ATTR_WIPHY, ATTR_REG_ALPHA2, ATTR_PS_STATE = 1, 33, 93
CMD_ANY = 62


def answer(*attributes):
    """Decode an answer of the kernel."""
    body = struct.pack("BBH", CMD_ANY, 1, 0) + b"".join(attributes)
    message = nl80211cmd(struct.pack("IHHII", 16 + len(body), 27, 2, 1, 0) + body)
    message.decode()
    return message


def power_save(state):
    return answer(attribute(ATTR_PS_STATE, struct.pack("I", state)))


def station(*info):
    return answer(attribute(ATTR_STA_INFO, info, nested=True))


def signal(kind, dbm):
    return attribute(kind, struct.pack("b", dbm))


def region(code, radio=None):
    named = [] if radio is None else [attribute(ATTR_WIPHY, struct.pack("I", radio))]
    return answer(*named, attribute(ATTR_REG_ALPHA2, code.encode() + b"\0"))


@pytest.fixture
def sys_net(tmp_path, monkeypatch):
    monkeypatch.setattr("arpd.host.wireless.index_of", {"wlan0": 3, "eth0": 2}.get)
    (tmp_path / "wlan0/phy80211").mkdir(parents=True)
    (tmp_path / "wlan0/phy80211/index").write_text("1\n")
    return tmp_path


def test_a_radio_is_read(sys_net):
    """Each question goes to the interface's number, and a radio's own regulatory domain counts."""
    asked = []

    def ask(*answers):
        def answer_to(index):
            asked.append(index)
            return answers

        return answer_to

    assert wireless.power_save("wlan0", ask=ask(power_save(1)))
    assert wireless.signal("wlan0", ask=ask(station(signal(STA_INFO_SIGNAL, -60)))) == -60
    assert wireless.region("wlan0", ask=ask(region("00"), region("DE", radio=1)), sys_net=sys_net) == "DE"
    assert asked == [3, 3, 3]


@pytest.mark.usefixtures("sys_net")
def test_a_radio_that_refuses_is_not_known():
    """The error says why."""

    def refuse(_index):
        raise PermissionError(1, "Operation not permitted")

    with pytest.raises(NotKnownError, match="not permitted"):
        wireless.power_save("wlan0", ask=refuse)
    with pytest.raises(NotKnownError, match="no signal now"):
        wireless.signal("wlan0", ask=lambda _index: [])


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
    assert wireless.radios_of(interface, sys_net=sys_net) == radios
