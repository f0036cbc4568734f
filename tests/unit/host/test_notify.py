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
    """READY, STATUS, WATCHDOG, STOPPING and RELOADING are spelt by the protocol; a status smuggles in no message."""
    environ, heard = manager
    notifier = Notifier(environ)
    notifier.ready()
    notifier.status("reload refused: line 3\nREADY=1")
    notifier.watchdog()
    notifier.stopping()
    assert [heard() for _ in range(4)] == [
        "READY=1",
        "STATUS=reload refused: line 3 READY=1",
        "WATCHDOG=1",
        "STOPPING=1",
    ]
    before_us = time.monotonic_ns() // 1000
    notifier.reloading()
    first, _, at_us = heard().rpartition("=")
    assert first == "RELOADING=1\nMONOTONIC_USEC"
    assert before_us <= int(at_us) <= time.monotonic_ns() // 1000


def test_a_socket_that_is_gone_does_not_stop_the_daemon(tmp_path, caplog):
    """A notification that cannot be sent is logged and raises nothing."""
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}).ready()
    assert "READY=1" in caplog.text


def test_one_hung_part_stops_the_heartbeat(manager):
    """While another thread has not finished a round for five seconds, no ping is sent."""
    environ, heard = manager
    notifier = Notifier(environ)
    now_s = finished_s = 100.0
    heart = Watchdog(notifier, parts=[lambda: finished_s], clock=lambda: now_s)

    def pings():
        heart.beat()
        notifier.ready()  # marks the end of the pings
        return sum(message == "WATCHDOG=1" for message in iter(heard, "READY=1"))

    now_s += 4.9
    assert pings() == 1
    for _ in range(5):
        now_s += 2.0
        assert pings() == 0
    finished_s = now_s
    assert pings() == 1
