"""How arpd's own control traffic leaves the host: it never waits for the link."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import MutableMapping

_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"


def send_without_waiting(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let Fast DDS drop what the socket does not take, in this process, unless its options are chosen already.

    Fast DDS writes to a blocking socket. While a link stands still and keeps its carrier, first its queue fills and
    then the socket's buffer, and the next write to a far reader waits for as long as that lasts: in one of `arpd run`,
    the tick does, and the publishers on this host hear no gate just then. Measured on such a link, with 40 kB/s of
    probes, the ticks ended after 3 s and went on with the link; without waiting, a write took 0.2 ms and the gate
    arrived all the time, through shared memory. (Where UDP is all there is, one socket serves near and far readers: the
    daemon lives, and the gate arrives again with the link.) What is dropped is best effort, or is repeated.

    Not for those who carry data: that their writes wait is how they know that the link is full.
    """
    chosen = environment.get(_VARIABLE) or "DEFAULT"
    if "?" not in chosen:
        environment[_VARIABLE] = f"{chosen}?non_blocking=true"
