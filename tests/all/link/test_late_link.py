"""A real link that appears after the start of `arpd run`."""

from __future__ import annotations

from scripts.netns.simlink import INTERFACE
from tests.all.link.hosts import NEEDS_LINK, ip
from tests.waiting import eventually

pytestmark = NEEDS_LINK
AS_ITS_UNIT = ("sh", "-c", 'until "$@"; do sleep 0.2; done', "sh", "arpd")  # starts again after each failure


def rename(host, name, other):
    ip(host, "link", "set", name, "down")
    ip(host, "link", "set", name, "name", other)
    ip(host, "link", "set", other, "up")  # else the peer's end has no carrier


def test_a_link_that_comes_after_the_daemon_is_taken(hosts):
    """The daemon starts without the link, logs that, restarts once the link has an address, and hears the peer."""
    (hosts.folder / "arpd.yaml").write_text(f"link: {{interface: {INTERFACE}}}\n")
    ip(hosts.robot, "address", "flush", "dev", INTERFACE)
    rename(hosts.robot, INTERFACE, "away")
    hosts.start("base", "peer", *AS_ITS_UNIT, "peer", "--interface", INTERFACE)
    hosts.start("robot", "run", *AS_ITS_UNIT, "run", "--config", "arpd.yaml")
    eventually("the daemon is ready", lambda: hosts.metric("arpd_ready") == 1)
    assert f"{INTERFACE} is not there yet" in hosts.text("run")
    rename(hosts.robot, "away", INTERFACE)
    assert hosts.metric("arpd_peer_reports_total") == 0
    ip(hosts.robot, "address", "add", f"{hosts.robot.address}/30", "dev", INTERFACE)
    eventually("the peer is heard", lambda: (hosts.metric("arpd_peer_reports_total") or 0) > 10)
    assert f"arpd: {INTERFACE} has a new address, which ROS" in hosts.text("run")
