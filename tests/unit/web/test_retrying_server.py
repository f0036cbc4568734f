"""The HTTP server that waits for its port."""

from __future__ import annotations

import socket
from contextlib import contextmanager

from arpd.web.retrying_server import RetryingServer
from arpd.web.server import HttpAddressError
from tests.waiting import eventually


@contextmanager
def listening(port):
    """Listen as the real server does; raise when the port is taken."""
    try:
        with socket.create_server(("127.0.0.1", port), reuse_port=False):
            yield f"http://127.0.0.1:{port}"
    except OSError as error:
        raise HttpAddressError(f"http: cannot listen on 127.0.0.1:{port}: {error.strerror}; take another") from error


def test_a_port_that_is_taken_is_tried_again(caplog):
    """The daemon goes on without metrics, logs that once, and serves as soon as the port is free."""
    caplog.set_level("INFO")
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        tried = []

        def serving():
            tried.append(port)
            return listening(port)

        server = RetryingServer(serving, again_s=0.02)
        with server.up():
            assert f"127.0.0.1:{port}" in server.fault
            eventually("it has tried again, in vain", lambda: len(tried) > 3)
            other.close()
            eventually("it serves", lambda: not server.fault)
    assert [record.levelname for record in caplog.records] == ["ERROR", "INFO"]
