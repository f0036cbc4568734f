"""KEEP_LAST depths of the relay's own endpoints, which discovery does not tell: pure."""

from __future__ import annotations

MOST_BYTES = 16_000_000  # in one endpoint
# Nobody knows rate and size of a topic before its first reader, and another depth needs another endpoint. So these are
# upper bounds: a second of the fastest topic, and the sizes of types that can be large and of all others.
MOST_HELD = 1000
PLAIN_BYTES = 16_000
BULK_BYTES = 250_000  # a raw image of 320 × 240, or a cloud of 16 beams


def held_depth(asked: int, *, sample_bytes: int) -> int:
    """Return the depth that holds a second of a topic, so that a busy host loses nothing that has arrived there.

    Parameters
    ----------
    asked : depth that the configuration asks for, held in any case (samples)
    sample_bytes : size of a sample, which bounds the memory (bytes), > 0
    """
    return max(asked, min(MOST_HELD, MOST_BYTES // sample_bytes))
