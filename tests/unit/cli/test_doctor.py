"""`arpd doctor`: what it asks, what it prints, and its exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from arpd import __version__
from arpd.adapters.systemd.services import ServiceState
from arpd.cli import checkup
from arpd.cli.checkup import UNITS, Asked, Senses, check_up
from arpd.cli.client import DaemonAddress
from arpd.cli.doctor import document, lines
from arpd.report.health import Health, Unknown
from arpd.report.health_host import NetworkLimits, PythonRos
from arpd.report.health_link import Announcer, HeardDiscovery, RadioState
from tests.unit.fake_daemon import calm, serving

LIMITS = NetworkLimits(
    buffer_bytes=212_992,
    received=1000,
    overflowed=0,
    reassembly_s=30,
    reassembly_bytes=4 * 2**20,
    reassembled=100,
    incomplete=0,
)
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
    radio=lambda _name: RadioState(saves_power=True, signal_dbm=-50, region=Unknown("nl80211 does not tell it")),
    units=dict,
)


def status(*, offset_s=0.001, lacks_profile=False):
    """Return the status of a daemon of this version, with one peer and one publisher."""
    answered = calm()
    answered |= {
        "version": __version__,
        "rmw": {"name": "rmw_fastrtps_cpp", "swaps": True, "refusal": ""},
        "peers": [
            {
                "peer": "ceddp",
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
    return {each.about: each.health for each in found.judgements}


def test_a_well_computer_is_one_line(asked):
    """With --verbose each check has a line."""
    with serving(json.dumps(status())) as url:
        found = check_up(asked(url), WELL)
    assert lines(found) == ["15 checks fine"]
    assert len(lines(found, is_verbose=True)) == 16
    assert document(found)["ok"] is True


def test_an_ill_computer_shows_what_to_do(asked):
    """What is wrong with its remedies, then what is not known, then a count; nothing of what is fine."""
    with serving(json.dumps(status(offset_s=-1.5, lacks_profile=True))) as url:
        found = check_up(asked(url), ILL)
    shown = lines(found)
    without_profile = next(line for line in shown if "export FASTRTPS" in line)
    assert without_profile.startswith("    export FASTRTPS_DEFAULT_PROFILES_FILE=/")
    shown.remove(without_profile)
    assert (
        "\n".join(line for line in shown if "without internet" not in line and "udev" not in line)
        == """\
wrong: clock: the clock of ceddp is 1.5 s behind the robot's (± 1 ms): tf2 finds poses of another time, or none; \
this computer's is not synchronised
    sudo apt install chrony   # here; then run `arpd doctor` on the CEDDP
wrong: power save: wlan0 saves power: the access point holds its packets until the next beacon, 100 ms and more
    sudo iw dev wlan0 set power_save off
wrong: mtu: wlan0 has an MTU of 1280 bytes; arpd's packets have up to 1420, so IP cuts each
    sudo ip link set dev wlan0 mtu 1500   # a tunnel takes less: 1420
wrong: profile: 1 node with AdaptivePublishers runs without arpd's Fast DDS profile: /camera; their swaps take longer, \
and lost packets cost whole samples
not known: region: nl80211 does not tell it
not known: units: systemd does not run here, or does not answer
4 things to do, 9 checks fine, 2 not known"""
    )


def test_the_json_has_every_check(asked):
    """Its keys are for scripts."""
    with serving(json.dumps(status(offset_s=9.0))) as url:
        told = document(check_up(asked(url), WELL))
    assert (told["ok"], told["end"], told["interface"]) == (False, "robot", "wlan0")
    assert {tuple(each) for each in told["checks"]} == {("check", "health", "text", "remedies")}
    (clock,) = (each for each in told["checks"] if each["check"] == "clock")
    assert (clock["health"], clock["remedies"][0]) == ("wrong", "sudo apt install chrony   # on the CEDDP")
    assert json.loads(json.dumps(told)) == told


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (lambda: json.dumps({"api_version": "v1", "ready": False}), 503),
        (lambda: "something else", 200),
        (lambda: json.dumps(calm() | {"peers": [{"peer": "x", "report_age_seconds": 1}]}), 200),
    ],
    ids=["not ready", "not arpd", "older"],
)
def test_a_daemon_that_does_not_tell_alarms_nobody(asked, answer, code):
    """The clock is not known, and the other checks go on."""
    with serving(answer(), code) as url:
        found = check_up(asked(url), WELL)
    assert healths(found)["clock"] is Health.UNKNOWN
    assert Health.WRONG not in {health for about, health in healths(found).items() if about not in {"versions", "rmw"}}


def test_without_a_daemon_its_checks_share_one_line(asked):
    """The reason is not repeated."""
    found = check_up(asked(), WELL)
    (line,) = (line for line in lines(found) if line.startswith("not known"))
    assert line.startswith("not known: clock, profile, versions: no daemon answers at http://127.0.0.1:1 ")
    assert not [each for each in found.judgements if each.health is Health.WRONG]


def test_the_far_end_asks_no_daemon_of_its_own(asked):
    """It would be another robot's, or none."""
    with serving(json.dumps(status(offset_s=5.0))) as url:
        found = check_up(asked(url, is_far=True), WELL)
    assert found.is_far
    assert healths(found)["clock"] is Health.UNKNOWN


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
    """A computer that runs only the peer is the CEDDP; its configuration is then checked as the far end's."""
    question = asked()
    question.config_path.write_text("link: {interface: of_the_robot0}\n")
    found = check_up(question, replace(WELL, units=lambda: units))
    assert found.is_far is is_far
    assert healths(found)["configuration"] is (Health.FINE if is_far else Health.WRONG)


@pytest.mark.parametrize(
    ("sub", "health"),
    [("start", Health.FINE), ("auto-restart", Health.WRONG), ("auto-restart-queued", Health.WRONG)],
)
def test_a_unit_that_fails_again_and_again_is_wrong(asked, sub, health):
    """With Restart=on-failure it is activating and never failed, as a unit that starts for the first time."""
    units = {"arpd": replace(ACTIVE, active="activating", sub=sub)}
    found = check_up(asked(), replace(WELL, units=lambda: units))
    (judged,) = (each for each in found.judgements if each.about == "units")
    assert judged.health is health
    assert ("journalctl -u arpd " in "".join(judged.remedies)) is (health is Health.WRONG)


def test_the_radio_beneath_a_tunnel_is_judged(asked):
    """WireGuard has no radio, but what carries it has."""
    radios = {"wlan3": RadioState(saves_power=True, signal_dbm=-50, region="DE")}
    senses = replace(WELL, radio=radios.get, radios_beneath=lambda _name: ["wlan3"])
    (judged,) = (each for each in check_up(asked(interface="wg0"), senses).judgements if each.about == "power save")
    assert (judged.health, judged.text[:5]) == (Health.WRONG, "wlan3")


def test_a_remote_url_means_the_far_end(asked, monkeypatch):
    """The route to the robot names the interface, and the robot tells the clock."""
    monkeypatch.setattr(DaemonAddress, "status", lambda _self: status(offset_s=0.5))
    found = check_up(asked("http://robot.local:9464"), WELL)
    assert (found.is_far, found.interface) == (True, "wlan7")
    assert healths(found)["clock"] is Health.WRONG


def test_the_daemons_port_comes_from_the_configuration(asked):
    """Unless the user names an address."""
    with serving(json.dumps(status())) as url:
        port = url.rpartition(":")[2]
        question = asked("http://127.0.0.1:9464")
        question.config_path.write_text(f"http: {{host: 0.0.0.0, port: {port}}}\n")
        found = check_up(replace(question, has_own_url=False), WELL)
    assert healths(found)["clock"] is Health.FINE


def test_a_faulty_or_missing_configuration_does_not_stop_the_rest(asked):
    """A fault is a finding; a file that is not there is none."""
    question = asked()
    question.config_path.write_text("links: {}\n")
    assert healths(check_up(question, WELL))["configuration"] is Health.WRONG
    question.config_path.unlink()
    assert healths(check_up(question, WELL))["configuration"] is Health.UNKNOWN


def test_with_two_ends_a_node_on_the_link_is_wrong(asked):
    """The configuration says whether the relay has two ends; ROS_DOMAIN_ID says where to listen."""
    node = Announcer(host="robot", process="camera", is_here=True, is_arpds=False)
    listened = []

    def listen(name, domain, duration_s):
        listened.append((name, domain, duration_s))
        return replace(QUIET, announcers=(node,))

    senses = replace(WELL, listen=listen, environment={"ROS_DOMAIN_ID": "7"})
    question = asked(listen_s=2.5)
    assert healths(check_up(question, senses))["discovery"] is Health.FINE
    question.config_path.write_text("relay: {link_domain: 102, robot: 10.77.0.1}\n")
    assert healths(check_up(question, senses))["discovery"] is Health.WRONG
    assert listened == [("wlan0", 7, 2.5)] * 2


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
    assert healths(check_up(asked(**options), senses))["discovery"] is Health.UNKNOWN


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


@pytest.fixture
def pythons(tmp_path):
    """Return a system's Python and, by name, others that lead to the same file or to another one."""
    (tmp_path / "usr/bin").mkdir(parents=True)
    (tmp_path / "venv/bin").mkdir(parents=True)
    real = tmp_path / "usr/bin/python3.12"
    real.touch()
    system = tmp_path / "usr/bin/python3"
    system.symlink_to(real)
    (tmp_path / "usr/bin/python3.11").touch()
    (tmp_path / "bin").symlink_to(tmp_path / "usr/bin")
    (tmp_path / "venv/bin/python").symlink_to(system)
    return system, {
        "venv": tmp_path / "venv/bin/python",
        "itself": system,
        "its file": real,
        "merged /usr": tmp_path / "bin/python3",
        "another": tmp_path / "usr/bin/python3.11",
    }


@pytest.mark.parametrize(
    ("own", "is_asked"),
    [("venv", True), ("another", True), ("itself", False), ("its file", False), ("merged /usr", False)],
)
def test_the_systems_python_is_asked_unless_arpd_runs_in_it(pythons, own, is_asked):
    """A virtual environment, as on every installed computer, leads to the same file and has other packages."""
    system, others = pythons
    asked = []

    def read(python):
        asked.append(python)
        return ROS

    found = checkup._system_ros(own=str(others[own]), system=system, distros=lambda: ["jazzy"], read=read)
    assert (found, asked) == (([ROS], [str(system)]) if is_asked else ([], []))


def test_the_systems_python_is_not_asked_without_ros_from_apt(pythons, tmp_path):
    """Nor where there is none."""
    system, others = pythons
    own = str(others["venv"])
    assert checkup._system_ros(own=own, system=system, distros=list, read=lambda _python: ROS) == []
    none = tmp_path / "none"
    assert checkup._system_ros(own=own, system=none, distros=lambda: ["jazzy"], read=lambda _python: ROS) == []


def test_every_unit_of_the_repository_is_asked_for():
    """A new unit needs a name here."""
    units = {path.stem for path in (Path(__file__).parents[3] / "systemd").glob("*.service")}
    assert units == set(UNITS)
