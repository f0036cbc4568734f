"""A network of its own for a file of tests: its ROS domains and ports are nobody else's."""

from __future__ import annotations

import ctypes
import fcntl
import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

_CLONE_NEWNET = 0x40000000
_libc = ctypes.CDLL(None, use_errno=True)


@contextmanager
def own_network():
    """Keep this thread, and all that it starts, in a network namespace of its own that has nothing but ``lo``.

    Where the kernel refuses one, which takes root, the network of the host is used by one process of pytest at a time.
    """
    before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    try:
        if _libc.unshare(_CLONE_NEWNET) != 0:
            with _only_here():
                yield
            return
        try:
            _set_lo_up()
            yield
        finally:
            _check(_libc.setns(before, _CLONE_NEWNET))
    finally:
        os.close(before)


@contextmanager
def _only_here():
    with (Path(tempfile.gettempdir()) / f"arpd-tests-network.{os.getuid()}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _set_lo_up():
    from pyroute2 import IPRoute

    with IPRoute() as route:
        route.link("set", index=route.link_lookup(ifname="lo")[0], state="up")


def _check(result):
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
