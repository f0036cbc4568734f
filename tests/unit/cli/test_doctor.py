"""`arpd doctor`: what it asks, what it prints, and its exit codes."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from arpd import __version__
from arpd.cli import checkup
from arpd.cli.checkup import Asked, Senses, check_up
from arpd.cli.client import DaemonAddress
from arpd.cli.doctor import lines
from arpd.host.services import ServiceState
from arpd.report.health import Health, HeardDiscovery, PythonRos, RadioState, Unknown
from tests.unit.fake_daemon import document, serving
from tests.unit.report.health_facts import LIMITS

ROS = PythonRos(python="/venv/python", rclpy="/opt/ros/jazzy/rclpy.py", numpy="1.26.4", rmw="rmw_fastrtps_cpp")
ACTIVE = ServiceState(is_installed=True, is_enabled=True, active="active")
DISABLED = ServiceState(is_installed=True, is_enabled=False, active="inactive")
QUIET = HeardDiscovery(domain_id=0, announcers=(), bytes_per_second=0.0)
WELL = Senses(
    limits=lambda: LIMITS,
    mtu=lambda _name: 1500,
    route_mtu=lambda _address: None,
    is_own_address=lambda address: address == "127.0.0.1",
    interface_to=lambda _address: "wlan7",
    likeliest_interface=lambda: "wlan0",
    is_clock_synchronised=lambda: True,
    radios_beneath=lambda _name: [],
    radio=lambda _name: RadioState(saves_power=False, signal_dbm=-50, region="DE"),
    listen=lambda _name, _domain, _duration_s: QUIET,
    units=lambda: {"arpd": ACTIVE},
    ros=lambda: [ROS],
    distros=lambda: ["jazzy"],
    environment={"ROS_DISTRO": "jazzy"},
)
ILL = replace(
    WELL,
    mtu=lambda _name: 1280,
    is_clock_synchronised=lambda: False,
    radios_beneath=lambda _name: ["wlan3"],  # of a tunnel, which has none
    radio={"wlan3": RadioState(saves_power=True, signal_dbm=-50, region=Unknown("nl80211 does not tell it"))}.get,
    units=lambda: {"arpd": replace(ACTIVE, active="activating", sub="auto-restart")},  # it fails again and again
)


def status(*, offset_s=0.001, lacks_profile=False):
    """Return the status of a daemon of this version, with one peer and one publisher."""
    answered = document()
    answered |= {
        "version": __version__,
        "rmw": {"name": "rmw_fastrtps_cpp", "swaps": True, "refusal": ""},
        "peers": [
            {
                "peer": "base",
                "report_age_seconds": 0.1,
                "clock_offset_seconds": offset_s,
                "clock_uncertainty_seconds": 0.001,
            }
        ],
    }
    answered["topics"][0]["lacks_profile"] = lacks_profile
    return answered


@pytest.fixture
def asked(tmp_path):
    """Return a question with a configuration of its own."""
    path = tmp_path / "arpd.yaml"
    path.write_text("link: {interface: auto}\n")

    def asked(url="http://127.0.0.1:1", **options):
        return Asked(daemon=DaemonAddress(url=url), has_own_url=True, config_path=path, **options)

    return asked


def healths(found):
    return {about: each.health for about, each in found.findings.items()}


def test_an_ill_computer_shows_what_to_do(asked):
    """What is wrong stands first, each with its remedies, then what is not known; what is fine is only counted."""
    with serving(json.dumps(status(offset_s=-1.5, lacks_profile=True))) as url:
        found = check_up(asked(url), ILL)
    by_health = {health: {about for about, each in healths(found).items() if each is health} for health in Health}
    assert by_health[Health.WRONG] == {"clock", "power save", "mtu", "units", "profile"}
    assert by_health[Health.UNKNOWN] == {"region"}
    shown = lines(found)
    headings = [line.partition(":")[0] for line in shown if not line.startswith("    ")]
    assert headings[:-1] == ["wrong"] * 5 + ["not known"]
    assert shown[-1] == "5 things to do, 10 checks fine, 1 not known"
    for number in ("1.5 s behind", "1280", "    sudo apt install chrony", "    sudo iw dev wlan3 set power_save off"):
        assert number in "\n".join(shown)
    assert len(lines(found, is_verbose=True)) == len(shown) + 10


@pytest.mark.parametrize(("answer", "code"), [('{"api_version": "v1", "ready": false}', 503), ("something else", 200)])
def test_a_daemon_that_does_not_tell_alarms_nobody(asked, answer, code):
    """The clock is not known, and the other checks go on."""
    with serving(answer, code) as url:
        found = check_up(asked(url), WELL)
    assert healths(found)["clock"] is Health.UNKNOWN
    assert Health.WRONG not in {health for about, health in healths(found).items() if about not in {"versions", "rmw"}}


@pytest.mark.parametrize(
    ("units", "is_far"),
    [
        ({"arpd-peer": ACTIVE}, True),
        ({"arpd-peer": ACTIVE, "arpd-relay-far": replace(ACTIVE, active="failed"), "arpd": DISABLED}, True),
        ({"arpd": ACTIVE, "arpd-peer": ACTIVE}, False),
        ({"arpd": replace(DISABLED, is_installed=False), "arpd-peer": ACTIVE}, True),
        ({"arpd-peer": DISABLED}, False),
        ({}, False),
    ],
)
def test_the_units_in_use_tell_the_end(asked, units, is_far):
    """A computer that runs only the peer is the base computer; its configuration is then checked as the far end's."""
    question = asked()
    question.config_path.write_text("link: {interface: of_the_robot0}\n")
    found = check_up(question, replace(WELL, units=lambda: units))
    assert found.is_far is is_far
    assert healths(found)["configuration"] is (Health.FINE if is_far else Health.WRONG)


@pytest.mark.parametrize(
    ("options", "senses"),
    [
        ({"listen_s": 0.0}, WELL),
        ({}, replace(WELL, likeliest_interface=lambda: None)),
        ({}, replace(WELL, environment={"ROS_DOMAIN_ID": "seven"})),
    ],
    ids=["told not to", "no interface", "no domain"],
)
def test_what_cannot_be_listened_to_is_not_known(asked, options, senses):
    """Nor does anything else fail for it."""
    found = healths(check_up(asked(**options), senses))
    assert (found["discovery"], found["transports"]) == (Health.UNKNOWN, Health.UNKNOWN)


def test_the_command_prints_and_exits(run, tmp_path, monkeypatch):
    """0 when nothing is to be done, 1 when something is, 2 for wrong usage."""
    monkeypatch.setattr(checkup, "Senses", lambda: WELL)
    config = tmp_path / "arpd.yaml"
    config.write_text("link: {interface: auto}\n")
    for offset_s, expected in ((0.0, 0), (2.0, 1)):
        with serving(json.dumps(status(offset_s=offset_s))) as url:
            code, out, err = run("doctor", "--url", url, "--config", config)
            assert (code, err) == (expected, "")
            assert ("wrong: clock" in out) is bool(expected)
            code, out, _ = run("doctor", "--url", url, "--config", config, "--json")
            assert (code, json.loads(out)["ok"]) == (expected, not expected)
    for words in (("--listen", "-1"), ("--listen", "soon"), ("--url", "robot", "--config", config)):
        assert run("doctor", *words)[0] == 2
    code, out, err = run("doctor", "--url", "http://[robot:9464", "--config", config)
    assert (code, out, err.count("\n")) == (2, "", 1)
