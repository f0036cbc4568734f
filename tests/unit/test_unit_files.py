"""The unit files, as systemd reads them, and the launcher."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNITS = sorted(path.name for path in SYSTEMD.glob("*.service"))
LAUNCHER = SYSTEMD / "arpd-launch"
OF_ROBOTS = "arpd-peer.service", "arpd-relay-far.service"  # which several robots have each
INSTALLED = "/usr/lib/arpd"


def settings(unit):
    lines = (SYSTEMD / unit).read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_finds_nothing_to_complain_about(tmp_path):
    """systemd-analyze verify accepts all units, and those of the base computer for one of several robots."""
    shutil.copy(LAUNCHER, tmp_path)
    (tmp_path / "arpd-peer@.service.d").mkdir()
    files = {unit: unit for unit in UNITS} | {unit.replace(".", "@."): unit for unit in OF_ROBOTS}
    for name, file in {**files, "arpd-peer@.service.d/10.conf": "arpd-peer-of-robot.conf"}.items():
        (tmp_path / name).write_text((SYSTEMD / file).read_text().replace(f"{INSTALLED}/", f"{tmp_path}/"))
    units = [tmp_path / name.replace("@.", "@robot1.") for name in files]
    assert sum("@" in unit.name for unit in units) == 2
    checked = subprocess.run(["systemd-analyze", "verify", *units], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, "")


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_has_what_its_start_its_restart_and_dds_need(unit):
    """Notify from its main process, a restart but after exit 78 or 2, a turn before others, no sandbox against DDS."""
    has = settings(unit)
    assert (has["Type"], has["NotifyAccess"]) == ("notify", "main")
    assert has["ExecStart"].startswith(f"{INSTALLED}/arpd-launch ")
    assert (has["RestartPreventExitStatus"], has["StartLimitIntervalSec"]) == ("78 2", "0")
    assert set(has["RestrictAddressFamilies"].split()) == {"AF_UNIX", "AF_INET", "AF_INET6", "AF_NETLINK"}
    assert has["Nice"] == "-5"  # a node with busy threads must not make samples old
    assert has["RemoveIPC"] == "no"  # else the shared memory of other nodes would go, too
    assert not {"PrivateIPC", "PrivateNetwork", "DynamicUser", "ProcSubset"} & set(has)
    # It starts without disk space and without NTP.
    assert not {"LogsDirectory", "StateDirectory", "CacheDirectory", "PrivateTmp", "PrivateDevices"} & set(has)
    assert "time-sync.target" not in has["After"].split()


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_a_unit_is_hardened(unit):
    """systemd-analyze security rates the exposure of every unit 2.0 or less."""
    judged = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--no-pager", "--threshold=20", SYSTEMD / unit],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout


def test_each_unit_has_folders_and_an_enclave_of_its_own():
    """No unit removes another's log folder when it stops, and none has another's rights."""
    for unit in UNITS:
        text = (SYSTEMD / unit).read_text().replace("%N", unit.removesuffix(".service"))
        name = re.findall(r"^RuntimeDirectory=(.+)$", text, re.MULTILINE)
        assert name == [unit.removesuffix(".service")]
        assert f"Environment=ROS_LOG_DIR=%t/{name[0]} ROS_HOME=%t/{name[0]}" in text
    enclaves = [name for unit in UNITS for name in re.findall(r"ENCLAVE_OVERRIDE=(\S+)", (SYSTEMD / unit).read_text())]
    assert sorted(enclaves) == ["/arpd/peer", "/arpd/relay", "/arpd/relay_far", "/arpd/run"]


def test_a_peer_needs_a_file_only_of_a_robot_that_it_names():
    """A base computer without a configuration runs a peer; one of several robots reads its robot's."""
    (named,) = re.findall("^ExecStart=(.+)$", (SYSTEMD / "arpd-peer-of-robot.conf").read_text(), re.MULTILINE)
    plain = settings("arpd-peer.service")["ExecStart"]
    assert "--config" not in plain
    assert named.replace("--config /etc/arpd/%i/arpd.yaml ", "") == plain


def test_notify_reload_sends_the_signal_once():
    """The drop-in leaves the signal to systemd and keeps the check, so that a bad file fails the reload."""
    lines = (SYSTEMD / "notify-reload.conf").read_text().splitlines()
    reloads = [line for line in (SYSTEMD / "arpd.service").read_text().splitlines() if line.startswith("ExecReload=")]
    signal, check = reloads
    assert "-HUP $MAINPID" in signal
    assert [line for line in lines if "=" in line and line[0] != "#"] == ["Type=notify-reload", "ExecReload=", check]


def test_the_environment_file_is_all_comments_with_settings_that_parse():
    """The environment file has only comments, and every commented setting is an assignment."""
    lines = (SYSTEMD / "arpd.default").read_text().splitlines()
    assert all(line.startswith("#") for line in lines if line)
    offered = [line[1:] for line in lines if re.match(r"#[A-Z]", line)]
    assert {"ARPD_ROS_SETUP", "ARPD_BIN", "ARPD_PEER_ARGS", "ROS_DOMAIN_ID"} <= {
        line.partition("=")[0] for line in offered
    }
    assert all(re.fullmatch(r'[A-Z_]+=("[^"]*"|\S*)', line) for line in offered)


# -- the launcher


@pytest.fixture
def launch(tmp_path):
    """Return a function that runs the launcher with an arpd that prints its arguments."""
    arpd = tmp_path / "arpd"
    arpd.write_text('#!/bin/sh\necho "pid=$$"\necho "layers=$LAYERS"\nfor a; do echo "arg=$a"; done\nexit 69\n')
    arpd.chmod(0o755)

    def run(*arguments, **environ):
        clean = {name: text for name, text in os.environ.items() if not name.startswith("ARPD_")}
        process = subprocess.Popen(
            [LAUNCHER, *arguments],
            env={**clean, "ARPD_BIN": str(arpd), **environ},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        output, errors = process.communicate()
        return process, output.splitlines(), errors

    return run


def setup_file(path, layer):
    # As ROS's files may, it reads an unset variable and positional parameters, and returns a failure.
    path.write_text(f'export LAYERS="$LAYERS${{NEVER_SET}}{layer}$1"\nfalse\n')
    return str(path)


def test_the_launcher_becomes_arpd(tmp_path, launch):
    """The launcher sources the setup files in order and becomes arpd, with its process id and exit code."""
    under, over = setup_file(tmp_path / "under.bash", "a"), setup_file(tmp_path / "over.bash", "b")
    process, output, _ = launch("run", "--config", "a b*.yaml", ARPD_ROS_SETUP=f"{under} {over}")
    assert output == [f"pid={process.pid}", "layers=ab", "arg=run", "arg=--config", "arg=a b*.yaml"]
    assert process.returncode == 69


def test_a_request_to_reload_during_the_start_does_not_end_it(tmp_path, launch):
    """The configuration is read later; SIGHUP would end the process until Python handles it."""
    arpd = tmp_path / "starting"
    arpd.write_text("#!/bin/sh\nkill -HUP $$\necho alive\n")
    arpd.chmod(0o755)
    process, output, _ = launch("run", ARPD_ROS_SETUP="", ARPD_BIN=str(arpd))
    assert (process.returncode, output) == (0, ["alive"])


@pytest.mark.parametrize(("name", "way_out"), [("ARPD_ROS_SETUP", "/etc/default/arpd"), ("ARPD_BIN", "arpd-ros")])
def test_a_missing_setup_file_or_arpd_is_a_configuration_error(tmp_path, launch, name, way_out):
    """The launcher ends with 78, and says the way out."""
    process, output, errors = launch("run", **{"ARPD_ROS_SETUP": "", name: str(tmp_path / "gone")})
    assert (process.returncode, output) == (78, [])
    assert way_out in errors
