"""A port of this machine that leads to a port of the simulated robot, in its namespace."""

from __future__ import annotations

import contextlib
import socket
import threading
from typing import TYPE_CHECKING

from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scripts.netns.link_end import Host

HTTP_PORT = 9464


@contextlib.contextmanager
def window(host: Host, port: int, *, listener: socket.socket | None = None) -> Iterator[str]:
    """Forward a port of 127.0.0.1 to the host's own 127.0.0.1:port; yield the URL on this side.

    Parameters
    ----------
    listener : a socket of another namespace; None = a free port of this one
    """
    listener = listener or socket.create_server(("127.0.0.1", 0))

    def connect() -> socket.socket:
        return socket.create_connection(("127.0.0.1", port), timeout=3.0)

    def serve() -> None:
        while True:
            try:
                near, _ = listener.accept()
            except OSError:
                return  # closed: the run is over
            try:
                far = inside(host.namespace, connect)
            except OSError:
                near.close()
                continue
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=_pump, args=(source, sink), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        # shutdown ends the accept; after close alone, the thread would stay in it.
        with contextlib.suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def _pump(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(data)
    with contextlib.suppress(OSError):
        sink.shutdown(socket.SHUT_WR)
