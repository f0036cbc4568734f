"""One HTTP connection that is kept between questions; each whole answer has one deadline."""

from __future__ import annotations

import asyncio
import base64
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from tornado.http1connection import HTTP1Connection, HTTP1ConnectionParameters
from tornado.httputil import HTTPHeaders, HTTPMessageDelegate, RequestStartLine, ResponseStartLine
from tornado.iostream import StreamClosedError
from tornado.tcpclient import TCPClient

if TYPE_CHECKING:
    import ssl

    from tornado.iostream import IOStream


class Answer(HTTPMessageDelegate):
    """What came back."""

    def __init__(self) -> None:
        self.code, self.headers, self.body = 0, HTTPHeaders(), b""
        self.is_whole = False

    def headers_received(self, start_line: ResponseStartLine | RequestStartLine, headers: HTTPHeaders) -> None:
        """Take the head."""
        if isinstance(start_line, ResponseStartLine):
            self.code, self.headers = start_line.code, headers

    def data_received(self, chunk: bytes) -> None:
        """Take a part of the body."""
        self.body += chunk

    def finish(self) -> None:
        """Know that nothing is missing."""
        self.is_whole = True


class KeptConnection:
    """Asks one server, without a proxy, and follows nothing.

    It asks for gzip: a fifth of the bytes, which may cross the link that arpd protects.

    Parameters
    ----------
    url : base URL, whose path goes before each question's
    tls : how to verify a server of https://
    user, password : basic authentication; without a user there is none
    deadline_s : for a whole answer, however slowly it comes, with connecting (s)
    most_bytes : largest answer

    Raises
    ------
    ValueError
        If it is no URL.
    """

    def __init__(
        self, url: str, *, tls: ssl.SSLContext | None, user: str, password: str, deadline_s: float, most_bytes: int
    ) -> None:
        self.url, parts = url, urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or (443 if tls else 80)
        self._path, self._tls = parts.path.rstrip("/"), tls
        self._deadline_s, self._most_bytes = deadline_s, most_bytes
        self._headers = {"Host": parts.netloc.rpartition("@")[2], "User-Agent": "arpd", "Accept-Encoding": "gzip"}
        if user:
            login = base64.b64encode(f"{user}:{password}".encode()).decode()
            self._headers["Authorization"] = f"Basic {login}"
        self._runner = asyncio.Runner()
        self._stream: IOStream | None = None

    def close(self) -> None:
        """Close the connection."""
        self._hang_up()
        self._runner.close()

    def get(self, path: str) -> Answer:
        """Return a whole answer.

        Raises
        ------
        OSError
            If there is none; TimeoutError where it does not come in time.
        """
        try:
            return self._runner.run(asyncio.wait_for(self._get(path), self._deadline_s))
        except TimeoutError:
            self._hang_up()  # the rest of this answer may still come
            raise TimeoutError("timed out") from None
        except StreamClosedError as error:
            cause = error.real_error  # what is too long for an answer is none of the system's
            raise cause if isinstance(cause, OSError) else ConnectionResetError("it closed the connection") from None

    async def _get(self, path: str) -> Answer:
        if self._stream is not None and not self._stream.closed():
            with suppress(StreamClosedError):  # it may have closed an idle connection: one more try
                if (answer := await self._ask(self._stream, path)).is_whole:
                    return answer
        self._hang_up()
        self._stream = await TCPClient().connect(
            self._host, self._port, ssl_options=self._tls, max_buffer_size=self._most_bytes
        )
        if (answer := await self._ask(self._stream, path)).is_whole:
            return answer
        raise ConnectionResetError("its answer broke off")

    async def _ask(self, stream: IOStream, path: str) -> Answer:
        parameters = HTTP1ConnectionParameters(max_body_size=self._most_bytes, decompress=True)
        connection, answer = HTTP1Connection(stream, is_client=True, params=parameters), Answer()
        question = RequestStartLine("GET", self._path + path, "HTTP/1.1")
        await connection.write_headers(question, HTTPHeaders(self._headers))
        connection.finish()
        await connection.read_response(answer)
        return answer

    def _hang_up(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
