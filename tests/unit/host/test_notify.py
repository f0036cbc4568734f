"""The notify protocol against a real datagram socket."""

from __future__ import annotations

import socket
import time
import uuid

import pytest

from arpd.host.notify import Notifier, Watchdog


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """Return the environment that systemd gives, and a function that returns its next message."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@arpd-test-{uuid.uuid4()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(name.replace("@", "\0", 1) if request.param == "abstract" else name)
        channel.settimeout(60.0)
        yield {"NOTIFY_SOCKET": name}, lambda: channel.recv(4096).decode()


def test_each_message_is_one_datagram(manager):
    """READY, STATUS, WATCHDOG and STOPPING reach systemd's socket as the protocol spells them."""
    environ, heard = manager
    notifier = Notifier(environ)
    notifier.ready()
    notifier.status("plan 3: 11 of 12")
    notifier.watchdog()
    notifier.stopping()
    assert [heard() for _ in range(4)] == ["READY=1", "STATUS=plan 3: 11 of 12", "WATCHDOG=1", "STOPPING=1"]


def test_a_reload_carries_the_monotonic_clock(manager):
    """RELOADING carries the monotonic time of the call in microseconds."""
    environ, heard = manager
    before_us = time.monotonic_ns() // 1000
    Notifier(environ).reloading()
    first, second = heard().split("\n")
    key, value = second.split("=")
    assert (first, key) == ("RELOADING=1", "MONOTONIC_USEC")
    assert before_us <= int(value) <= time.monotonic_ns() // 1000


def test_a_status_cannot_smuggle_in_another_message(manager):
    """A newline in the status text becomes a space."""
    environ, heard = manager
    Notifier(environ).status("reload refused: line 3\nREADY=1")
    assert heard() == "STATUS=reload refused: line 3 READY=1"


def test_a_socket_that_is_gone_does_not_stop_the_daemon(tmp_path, caplog):
    """A notification that cannot be sent is logged and raises nothing."""
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}).ready()
    assert "READY=1" in caplog.text


class Clock:
    """A clock and the end of a second thread's last round, both set by the test."""

    def __init__(self):
        self.now_s = 100.0
        self.finished_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def heart(manager):
    """Return a watchdog with one part, its clock, and a function that counts pings since its last call."""
    environ, heard = manager
    notifier = Notifier(environ)
    clock = Clock()

    def pings():
        notifier.ready()  # marks the end of the pings
        return sum(message == "WATCHDOG=1" for message in iter(heard, "READY=1"))

    return Watchdog(notifier, parts=[lambda: clock.finished_s], clock=clock), clock, pings


def test_one_hung_part_stops_the_heartbeat(heart):
    """While another thread has not finished a round for five seconds, no ping is sent."""
    heartbeat, clock, pings = heart
    clock.now_s += 4.9
    heartbeat.beat()
    assert pings() == 1
    for _ in range(5):
        clock.now_s += 2.0
        heartbeat.beat()
    assert pings() == 0
    clock.finished_s = clock.now_s
    heartbeat.beat()
    assert pings() == 1
