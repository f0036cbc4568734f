"""The HTTP server that waits for its port."""

from __future__ import annotations

import socket
import time
from contextlib import contextmanager

import pytest

from arpd.adapters.http.retrying_server import RetryingServer
from arpd.adapters.http.server import HttpAddressError


def fail():
    raise ValueError("a bug")


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
        server = RetryingServer(lambda: listening(port), again_s=0.02)
        with server.up():
            assert server.fault.startswith(
                f"no metrics: http: cannot listen on 127.0.0.1:{port}: Address already in use"
            )
            time.sleep(0.1)
            other.close()
            until_s = time.monotonic() + 10.0
            while server.fault and time.monotonic() < until_s:
                time.sleep(0.01)
            assert server.fault == ""
    assert [record.levelname for record in caplog.records] == ["ERROR", "INFO"]


def test_what_else_keeps_it_from_serving_at_the_start_is_raised():
    """A faulty web configuration is raised, because trying again would not help."""
    with pytest.raises(ValueError, match="a bug"), RetryingServer(fail).up():
        raise AssertionError("must not be entered")
