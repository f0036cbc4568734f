"""`arpd doctor`: what it asks, what it prints, and its exit codes."""

from __future__ import annotations

import json
from unittest.mock import Mock

import pytest

from arpd import __version__
from arpd.cli import checks, here, options
from arpd.host import addresses
from arpd.host.config import load
from arpd.host.discovery import HeardDiscovery
from arpd.host.services import ServiceState
from arpd.model.errors import NotKnownError
from tests.unit.fake_daemon import document, serving

SMALL = "link: {interface: auto}\n"
ACTIVE = ServiceState(is_installed=True, is_enabled=True, active="active")
DISABLED = ServiceState(is_installed=True, is_enabled=False, active="inactive")
FAILED = ServiceState(is_installed=True, is_enabled=True, active="failed")


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
    change(checks, ipv4_addresses=lambda: {"wlan0": frozenset({"10.0.0.1"})})
    change(checks.radio, radios_of=lambda _name: ["wlan0"], power_save=lambda _name: False)
    change(checks.radio, signal=lambda _name: -50, region=lambda _name: "DE")
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    return change


@pytest.fixture
def doctor(run, config):
    """Run ``arpd doctor``, of a daemon of this version with one peer and one publisher, or of none."""

    def doctor(*options, text=None, offset_s=None, lacks_profile=False, faults=()):
        answered = document()
        clock = {"offset_s": offset_s, "uncertainty_s": 0.001}
        answered |= {"version": __version__, "peers": [{"peer": "base", "report_age_s": 0.1, "clock": clock}]}
        answered["faults"] = list(faults)
        answered["topics"][0]["confirmed"]["lacks_profile"] = lacks_profile
        with serving(json.dumps(answered)) as url:
            address = "http://127.0.0.1:1" if offset_s is None else url
            return run("doctor", "--url", address, "--config", config(text), *options)

    return doctor


def healths(out):
    return {each["check"]: each["health"] for each in json.loads(out)["checks"]}


def test_what_is_well_is_only_counted(doctor):
    """The exit code is 0, with --json too."""
    code, out, err = doctor(offset_s=0.0)
    assert (code, out, err) == (0, "17 checks fine\n", "")
    code, out, _ = doctor("--json", offset_s=0.0)
    assert (code, json.loads(out)["ok"], set(healths(out).values())) == (0, True, {"fine"})


def test_an_ill_computer_shows_what_to_do(doctor, computer):
    """What is wrong stands first, each with its remedies, then what is not known; what is fine is only counted."""
    refuse = Mock(side_effect=NotKnownError("nl80211 does not tell it"))
    looping = ServiceState(is_installed=True, is_enabled=True, active="activating", is_restarted=True)
    computer(here, service_states=lambda *_: {"arpd": looping})
    computer(checks.kernel, read_mtu=lambda _name: 1280)
    computer(checks, ipv4_addresses=dict)
    computer(checks.radio, power_save=lambda _name: True, region=refuse)
    code, out, err = doctor(offset_s=-1.5, lacks_profile=True)
    assert (code, err) == (1, "")
    shown = out.splitlines()
    headings = [line.split(": ")[:2] for line in shown if not line.startswith("    ")]
    assert headings[:-1] == [
        *(["wrong", about] for about in ("clock", "power save", "address", "mtu", "profile", "units")),
        ["not known", "region"],
    ]
    assert shown[-1] == "6 things to do, 10 checks fine, 1 not known"
    for number in ("1.5 s behind", "1280", "    sudo apt install chrony", "    sudo iw dev wlan0 set power_save off"):
        assert number in out


def test_what_the_daemon_finds_wrong_comes_first(doctor):
    """What the daemon finds wrong stands first, on the base computer, too."""
    silent = {
        "condition": "peer_lost",
        "severity": "error",
        "headline": "",
        "text": "The peer is silent.",
        "wrong": True,
    }
    code, out, _ = doctor(offset_s=0.0, faults=[silent])
    assert (code, out.splitlines()[0]) == (1, "wrong: daemon: The peer is silent.")


def test_the_other_ends_address_is_not_this_computers(run, config, monkeypatch):
    """With it arpd ends at once, and `arpd check` says so, too."""
    monkeypatch.setattr(addresses, "ends_of_route", lambda name: ("10.0.0.1", name))
    path = config("relay: {link_domain: 77, base: 10.0.0.1}")
    out = run("doctor", "--json", "--config", path)[1]
    assert healths(out)["configuration"] == "wrong"
    assert "relay.base: 10.0.0.1 is an address of this computer" in out
    assert healths(run("doctor", "--json", "--far", "--config", path)[1])["configuration"] == "fine"


def test_the_file_of_each_robot_is_judged(run, computer, tmp_path):
    """A base computer of several robots has a file for each; a broken one is named, with the line that checks it."""
    units = {"arpd": DISABLED, "arpd-peer": DISABLED} | {f"arpd-peer@robot{n}": ACTIVE for n in (1, 2, 3)}
    units["arpd-relay-far@robot4"] = DISABLED
    installed = tmp_path / "arpd.yaml"
    computer(here, service_states=lambda *_: units, DEFAULT_CONFIG=installed)
    computer(options, DEFAULT_CONFIG=installed)
    for robot, text in {"robot1": SMALL, "robot2": "relay: {link_domain: 300}\n", "robot3": SMALL}.items():
        (tmp_path / robot).mkdir()
        (tmp_path / robot / "arpd.yaml").write_text(text)
    _, out, _ = run("doctor", "--json")
    (told,) = (each for each in json.loads(out)["checks"] if each["check"] == "configuration")
    assert told["text"].startswith(f"{tmp_path}/robot2/arpd.yaml:1:22: relay.link_domain: ")
    assert told["remedies"] == [f"arpd check --far {tmp_path}/robot2/arpd.yaml"]
    (tmp_path / "robot2/arpd.yaml").unlink()
    assert f"{tmp_path}/robot2/arpd.yaml:1:1: file: cannot be read" in run("doctor", "--json")[1]
    (tmp_path / "robot2/arpd.yaml").write_text(SMALL)
    assert "robot1/arpd.yaml" in (told := run("doctor", "--json")[1])
    assert "arpd.yaml are valid" in told


def test_a_robot_that_is_the_base_of_another_one_asks_its_own_daemon(run, computer, tmp_path):
    """Whatever the other one is called: its file says where another daemon listens."""
    installed = tmp_path / "arpd.yaml"
    computer(here, service_states=lambda *_: {"arpd": ACTIVE, "arpd-peer@alpha": ACTIVE}, DEFAULT_CONFIG=installed)
    computer(here, used_on_base=lambda _: {})
    computer(options, DEFAULT_CONFIG=installed)
    (tmp_path / "alpha").mkdir()
    for path, port in ((installed, 1), (tmp_path / "alpha/arpd.yaml", 2)):
        path.write_text(f"http: {{port: {port}}}\n")
    assert "no daemon answers at http://127.0.0.1:1 " in run("doctor", "--json")[1]


@pytest.mark.parametrize(("unit", "health"), [("arpd", "wrong"), ("arpd-peer", "unknown")])
def test_a_missing_file_is_wrong_where_a_unit_needs_it(run, computer, tmp_path, unit, health):
    """Only a peer without a name does without; a file that is named with --config is a typo, see below."""
    installed = tmp_path / "arpd.yaml"
    computer(here, service_states=lambda *_: {unit: FAILED}, DEFAULT_CONFIG=installed)
    computer(options, DEFAULT_CONFIG=installed)
    assert healths(run("doctor", "--json")[1])["configuration"] == health


def test_a_daemon_without_a_port_is_not_known(run, config):
    """The file may give it none, so nobody can ask it."""
    code, out, err = run("doctor", "--json", "--config", config("http: {port: 0}\n"))
    assert (code, err) == (0, "")
    assert {check for check, health in healths(out).items() if health == "unknown"} == {
        *("daemon", "clock", "profile", "versions")
    }


def test_a_daemon_with_tls_is_asked_by_https(run, config, tmp_path):
    """The web-config says so; where this user may not read it, the file is no fault."""
    path = config("http: {port: 1, web_config: web.yaml}\n")
    (tmp_path / "web.yaml").write_text("tls_server_config: {cert_file: robot.crt, key_file: robot.key}\n")
    assert "no daemon answers at https://127.0.0.1:1 " in run("doctor", "--json", "--config", path)[1]
    (tmp_path / "web.yaml").unlink()
    out = run("doctor", "--json", "--config", path)[1]
    assert "no daemon answers at http://127.0.0.1:1 " in out
    assert healths(out)["configuration"] == "fine"
    path = config("http: {port: 1, host: '::'}\n")
    assert "no daemon answers at http://[::1]:1 " in run("doctor", "--json", "--config", path)[1]


def test_a_file_that_is_named_is_there(run, tmp_path):
    """A name with a typo is an error, as everywhere, and no check that was not possible."""
    code, out, err = run("doctor", "--config", tmp_path / "typo.yaml")
    assert (code, out) == (78, "")
    assert err.startswith(f"{tmp_path}/typo.yaml:1:1: file: ")


def test_it_listens_in_the_domain_of_the_units(doctor, monkeypatch, tmp_path):
    """Their environment file has it, and a shell need not."""
    (tmp_path / "default").write_text('#ROS_DOMAIN_ID=4\nROS_DOMAIN_ID="5"\n')
    monkeypatch.setattr(load, "OF_UNITS", tmp_path / "default")
    assert "(domain 5)" in doctor("--json")[1]


@pytest.mark.parametrize("why", ["told not to", "no interface", "no domain"])
def test_what_cannot_be_listened_to_is_not_known(doctor, computer, monkeypatch, why):
    """Nor does anything else fail for it."""
    if why == "no domain":
        monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    elif why == "no interface":
        computer(here, likeliest_interface=lambda: None)
    found = healths(doctor("--json", *(["--listen", "0"] if why == "told not to" else []))[1])
    assert (found["discovery"], found["transports"]) == ("unknown", "unknown")
