"""Logging under systemd."""

import logging

from arpd.logs import _JournalFormatter


def test_every_line_carries_its_priority():
    """Under systemd a warning is a warning in the journal too, on each of its lines."""
    record = logging.LogRecord("arpd", logging.WARNING, "x.py", 1, "first\nsecond", None, None)
    assert _JournalFormatter("%(message)s").format(record) == "<4>first\n<4>second"
