"""The one way in which tests wait."""

from __future__ import annotations

import time

PATIENCE_S = 60.0  # nothing takes this long on an idle machine; a busy one may
_POLL_S = 0.02


def eventually(what, condition):
    """Wait until ``condition()`` holds and return what it returned; fail with ``what`` after a minute."""
    until_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < until_s, f"did not happen in {PATIENCE_S:g} s: {what}"
        time.sleep(_POLL_S)
    return found
