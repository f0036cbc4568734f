"""A real link that appears after the start of `arpd run`."""

from __future__ import annotations

import os

from scripts.netns.simlink import INTERFACE, SimLink
from scripts.robot.proxy import window
from tests.all.link.hosts import NEEDS_LINK, ip, python
from tests.scrape import metrics
from tests.waiting import eventually

pytestmark = NEEDS_LINK
PORT = 9464


def rename(host, name, other):
    ip(host, "link", "set", name, "down")
    ip(host, "link", "set", name, "name", other)
    ip(host, "link", "set", other, "up")  # else the peer's end has no carrier


def arpd(link, host, log, *argv):
    """Start arpd, and again after each failure, as its unit does."""
    again = ["FASTDDS_BUILTIN_TRANSPORTS=UDPv4", "sh", "-c", 'until "$@"; do sleep 0.2; done', "sh"]
    return python(link, host, "-m", "arpd.cli", *argv, environment=again, stderr=log)


def test_a_link_that_comes_after_the_daemon_is_taken(tmp_path):
    """The daemon starts without the link, logs that, restarts once the link has an address, and hears the peer."""
    (tmp_path / "arpd.yaml").write_text(f"link: {{interface: {INTERFACE}}}\nhttp: {{port: {PORT}}}\n")
    with (
        SimLink(f"late-{os.getpid()}") as link,
        (tmp_path / "log").open("w") as log,
        window(link.robot, PORT) as url,
    ):

        def metric(name):
            return metrics(url).get(name)

        ip(link.robot, "address", "flush", "dev", INTERFACE)
        rename(link.robot, INTERFACE, "away")
        arpd(link, "base", log, "peer", "--interface", INTERFACE)
        arpd(link, "robot", log, "run", "--config", str(tmp_path / "arpd.yaml"))
        eventually("the daemon is ready", lambda: metric("arpd_ready") == 1)
        assert f"{INTERFACE} is not there yet" in (tmp_path / "log").read_text()
        rename(link.robot, "away", INTERFACE)
        assert metric("arpd_peer_reports_total") == 0
        ip(link.robot, "address", "add", f"{link.robot.address}/30", "dev", INTERFACE)
        eventually("the peer is heard", lambda: (metric("arpd_peer_reports_total") or 0) > 10)
        assert f"arpd: {INTERFACE} has a new address, which ROS" in (tmp_path / "log").read_text()
