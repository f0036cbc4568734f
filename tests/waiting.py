"""Waits in tests."""

from __future__ import annotations

import time


def eventually(condition, timeout_s=30.0, *, what="the condition"):
    """Wait until the condition holds; fail after the timeout (s)."""
    until_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until_s, f"did not happen in {timeout_s:g} s: {what}"
        time.sleep(0.1)
