"""`arpd doctor`: what it asks, what it prints, and its exit codes."""

from __future__ import annotations

import json

import pytest

from arpd import __version__
from arpd.cli import checks, here
from arpd.cli.doctor import check_up, lines
from arpd.cli.here import Here
from arpd.cli.main import _parser
from arpd.cli.output import WITHOUT_END
from arpd.host.discovery import HeardDiscovery
from arpd.host.services import ServiceState
from arpd.model.errors import NotKnownError
from tests.unit.fake_daemon import document, serving

ACTIVE = ServiceState(is_installed=True, is_enabled=True, active="active")
DISABLED = ServiceState(is_installed=True, is_enabled=False, active="inactive")
FAILED = ServiceState(is_installed=True, is_enabled=True, active="failed")
ABSENT = ServiceState(is_installed=False, is_enabled=False, active="inactive")


@pytest.fixture(autouse=True)
def computer(monkeypatch):
    """Let this computer be well; returns a function that changes readers of it."""

    def change(place, **readers):
        for name, reader in readers.items():
            monkeypatch.setattr(place, name, reader)

    change(
        here,
        interface_to=lambda _address: "wlan7",
        likeliest_interface=lambda: "wlan0",
        listen=lambda _name, domain, **_: HeardDiscovery(domain_id=domain, announcers=(), bytes_per_second=0.0),
        service_states=lambda *_: {"arpd": ACTIVE},
    )
    change(checks.kernel, read_mtu=lambda _name: 1500, route_mtu=lambda _address: None)
    change(checks.radio, radios_of=lambda _name: ["wlan0"], power_save=lambda _name: False)
    change(checks.radio, signal=lambda _name: -50, region=lambda _name: "DE")
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    return change


def status(*, offset_s=0.001, lacks_profile=False):
    """Return the status of a daemon of this version, with one peer and one publisher."""
    answered = document()
    answered |= {
        "version": __version__,
        "peers": [{"peer": "base", "report_age_s": 0.1, "clock": {"offset_s": offset_s, "uncertainty_s": 0.001}}],
    }
    answered["topics"][0]["confirmed"]["lacks_profile"] = lacks_profile
    return answered


@pytest.fixture
def asked(tmp_path):
    """Return a computer with a configuration of its own."""
    path = tmp_path / "arpd.yaml"
    path.write_text("link: {interface: auto}\n")

    def asked(url="http://127.0.0.1:1", *options):
        return Here(_parser().parse_args(["doctor", "--url", url, "--config", str(path), *options]))

    return asked


def healths(found):
    return {about: each.health for about, each in found.items()}


WRONG = {"clock", "power save", "mtu", "units", "profile"}


def test_an_ill_computer_shows_what_to_do(asked, computer):
    """What is wrong stands first, each with its remedies, then what is not known; what is fine is only counted."""

    def refuse(_name):
        raise NotKnownError("nl80211 does not tell it")

    looping = ServiceState(is_installed=True, is_enabled=True, active="activating", sub="auto-restart")
    computer(here, service_states=lambda *_: {"arpd": looping})
    computer(checks.kernel, read_mtu=lambda _name: 1280)
    computer(checks.radio, power_save=lambda _name: True, region=refuse)
    with serving(json.dumps(status(offset_s=-1.5, lacks_profile=True))) as url:
        found = check_up(asked(url))
    assert {about for about, each in healths(found).items() if each == "wrong"} == WRONG
    assert {about for about, each in healths(found).items() if each == "unknown"} == {"region"}
    shown = lines(found, width=WITHOUT_END)
    headings = [line.partition(":")[0] for line in shown if not line.startswith("    ")]
    assert headings[:-1] == ["wrong"] * 5 + ["not known"]
    assert shown[-1] == "5 things to do, 8 checks fine, 1 not known"
    for number in ("1.5 s behind", "1280", "    sudo apt install chrony", "    sudo iw dev wlan0 set power_save off"):
        assert number in "\n".join(shown)
    assert len(lines(found, width=WITHOUT_END, is_verbose=True)) == len(shown) + 8


@pytest.mark.parametrize(
    ("units", "is_far"),
    [
        ({"arpd-peer": ACTIVE}, True),
        ({"arpd-peer": ACTIVE, "arpd-relay-far": FAILED, "arpd": DISABLED}, True),
        ({"arpd": ACTIVE, "arpd-peer": ACTIVE}, False),
        ({"arpd": ABSENT, "arpd-peer": ACTIVE}, True),
        ({"arpd-peer": DISABLED}, False),
        ({}, False),
    ],
)
def test_the_units_in_use_tell_the_end(asked, computer, tmp_path, units, is_far):
    """A computer that runs only the peer is the base computer; its configuration is then checked as the far end's."""
    computer(here, service_states=lambda *_: units)
    (tmp_path / "arpd.yaml").write_text("link: {interface: of_the_robot0}\n")
    found = asked()
    assert found.is_far is is_far
    assert healths(check_up(found))["configuration"] == ("fine" if is_far else "wrong")


@pytest.mark.parametrize("why", ["told not to", "no interface", "no domain"])
def test_what_cannot_be_listened_to_is_not_known(asked, computer, monkeypatch, why):
    """Nor does anything else fail for it."""
    if why == "no domain":
        monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    elif why == "no interface":
        computer(here, likeliest_interface=lambda: None)
    found = healths(check_up(asked("http://127.0.0.1:1", *(["--listen", "0"] if why == "told not to" else []))))
    assert (found["discovery"], found["transports"]) == ("unknown", "unknown")


def test_the_command_prints_and_exits(run, tmp_path):
    """0 when nothing is to be done, 1 when something is, 2 for wrong usage."""
    config = tmp_path / "arpd.yaml"
    config.write_text("link: {interface: auto}\n")
    for offset_s, expected in ((0.0, 0), (2.0, 1)):
        with serving(json.dumps(status(offset_s=offset_s))) as url:
            code, out, err = run("doctor", "--url", url, "--config", config)
            assert (code, err) == (expected, "")
            assert ("wrong: clock" in out) is bool(expected)
            code, out, _ = run("doctor", "--url", url, "--config", config, "--json")
            assert (code, json.loads(out)["ok"]) == (expected, not expected)
    for words in (("--listen", "-1"), ("--listen", "soon"), ("--url", "http://[robot:9464")):
        assert run("doctor", *words)[0] == 2
