"""Participants of the other side that announce themselves on the link although the relay carries their topics."""

from __future__ import annotations

import logging
import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from arpd.host.discovery import discovery_socket, join_discovery, participant_in

if TYPE_CHECKING:
    from collections.abc import Collection

log = logging.getLogger(__name__)
_MOST = 1000
_FORGET_S = 60.0


class AnnouncedParticipants:
    """Hears the multicast discovery of the local domain, and remembers whose it is.

    It hears this host's nodes, too. A participant of the other side that announces itself here has crossed the link
    without the relay. An end confined to its host does not see it in its graph.
    """

    def __init__(self, domain_id: int) -> None:
        self._heard_s: dict[str, float] = {}
        self._joined: set[int] = set()
        self._socket: socket.socket | None = None
        try:
            self._socket = discovery_socket(domain_id)
            self._socket.settimeout(0.0)
        except OSError as error:
            log.warning("cannot listen for nodes that cross the link on their own: %s", error)

    def recent(self) -> Collection[str]:
        """Return the first 12 bytes of the GUIDs of those heard in the last minute, in hexadecimal digits."""
        if self._socket is None:
            return ()
        present = {index for index, _name in socket.if_nameindex()}
        for index in present ^ self._joined:  # a radio or a container that returns has a new number
            with suppress(OSError):  # down, or without an address
                join_discovery(self._socket, index, is_gone=index in self._joined)
                self._joined ^= {index}
        now_s = time.monotonic()
        with suppress(OSError):  # nothing more has come
            for _ in range(_MOST):
                if (participant := participant_in(self._socket.recv(64))) is not None:  # its header is enough
                    self._heard_s[participant.hex()] = now_s
        recent = {guid: heard_s for guid, heard_s in self._heard_s.items() if now_s - heard_s < _FORGET_S}
        self._heard_s = recent if len(recent) <= _MOST else {}
        return self._heard_s.keys()

    def close(self) -> None:
        """Listen no more."""
        if self._socket is not None:
            self._socket.close()
