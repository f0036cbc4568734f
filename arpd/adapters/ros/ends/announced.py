"""Participants of the other side that announce themselves on the link although the relay carries their topics."""

from __future__ import annotations

import logging
import select
import socket
import struct
import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection

log = logging.getLogger(__name__)
_GROUP = "239.255.0.1"  # of participant discovery (OMG DDSI-RTPS 2.3, 9.6.1)
_PORT, _PORTS_OF_DOMAIN = 7400, 250
_GUID = slice(8, 20)  # of the sender, in the header of every RTPS message
_MOST = 1000
_FORGET_S = 60.0


class AnnouncedParticipants:
    """Hears the multicast discovery of the local domain, and remembers whose it is.

    It hears this host's nodes, too. A participant of the other side that announces itself here has crossed the link
    without the relay. An end confined to its host does not see it in its graph.

    Parameters
    ----------
    domain_id : the local domain
    """

    def __init__(self, domain_id: int) -> None:
        self._heard_s: dict[str, float] = {}
        self._is_ended = False
        self._socket: socket.socket | None = None
        try:
            self._socket = _listening(_PORT + _PORTS_OF_DOMAIN * domain_id)
        except OSError as error:
            log.warning("cannot listen for nodes that cross the link on their own: %s", error)
            return
        threading.Thread(target=self._run, args=(self._socket,), name="arpd-announced", daemon=True).start()

    def recent(self) -> Collection[str]:
        """Return the first 12 bytes of the GUIDs of those heard in the last minute, in hexadecimal digits."""
        now_s = time.monotonic()
        return {guid for guid, heard_s in self._heard_s.copy().items() if now_s - heard_s < _FORGET_S}

    def close(self) -> None:
        """End the thread."""
        self._is_ended = True

    def _run(self, heard: socket.socket) -> None:
        with heard:
            while not self._is_ended:
                if not select.select([heard], [], [], 1.0)[0]:
                    continue
                packet = heard.recv(64)  # its header is enough
                if packet[:4] == b"RTPS" and len(packet) >= _GUID.stop:
                    if len(self._heard_s) > _MOST:
                        self._heard_s.clear()
                    self._heard_s[packet[_GUID].hex()] = time.monotonic()


def _listening(port: int) -> socket.socket:
    """Return a socket that hears the multicast group on every interface that can join it."""
    heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    heard.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    heard.bind((_GROUP, port))
    for index, _name in socket.if_nameindex():
        member = struct.pack("4s4si", socket.inet_aton(_GROUP), bytes(4), index)
        try:
            heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError:
            continue  # down, or without an address
    return heard
