"""Basic authentication with bcrypt hashes, at a bounded cost.

bcrypt takes 50 to 300 ms of CPU on purpose. So arpd remembers a good password, runs bcrypt once at a time, lets few
requests wait for it, and slows down clients that guess.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import hmac
from enum import StrEnum
from typing import TYPE_CHECKING

from arpd.ros.rate_limits import RateLimit

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

MAX_WAITING = 4  # requests in or before bcrypt; each counts against the connection limit
MOST_WRONG, _PERIOD_S = 5, 5.0  # passwords that a client may send in this time
_BCRYPT_BYTES = 72  # bcrypt reads no more; the library cuts the rest off before 5.0 and raises since


class PasswordVerdict(StrEnum):
    """Verdict on the credentials of a request."""

    OK = "ok"
    CACHED = "cached"
    MISSING = "missing"
    WRONG = "wrong"
    THROTTLED = "throttled"  # the client sent too many wrong ones
    BUSY = "busy"  # too many requests wait for bcrypt


class Passwords:
    """Judges credentials in the event loop; only bcrypt runs beside it, in a thread.

    Parameters
    ----------
    clock : monotonic clock (s)
    secret : random key of the digests of remembered passwords
    check : returns whether a password has a bcrypt hash
    """

    def __init__(
        self, *, clock: Callable[[], float], secret: bytes, check: Callable[[bytes, bytes], bool] | None = None
    ) -> None:
        self._clock = clock
        self._secret = secret
        self._check = check or bcrypt_matches
        self._bcrypt = asyncio.Lock()
        self._waiting = 0
        self._good: dict[bytes, bytes] = {}
        self._guesses = RateLimit(MOST_WRONG, period_s=_PERIOD_S)

    async def judge(self, users: Mapping[bytes, bytes], authorization: bytes, client: str) -> PasswordVerdict:
        """Return the verdict on a request.

        Parameters
        ----------
        users : name → bcrypt hash, at least one
        authorization : the request's header
        client : name that a wrong password counts against
        """
        if (credentials := _parse_basic(authorization)) is None:
            return PasswordVerdict.MISSING
        name, password = credentials
        known = users.get(name)
        # An unknown name costs as much time as a known one, so that time does not tell them apart.
        hashed = self._decoy(users, name) if known is None else known
        digest = self._digest(hashed, password)
        if known is not None and hmac.compare_digest(self._good.get(name, b""), digest):
            return PasswordVerdict.CACHED
        if not self._guesses.take(client, self._clock()):
            return PasswordVerdict.THROTTLED
        if self._waiting == MAX_WAITING:
            self._guesses.charge(client, -1)
            return PasswordVerdict.BUSY
        self._waiting += 1
        try:
            async with self._bcrypt:
                is_right = await asyncio.to_thread(self._check, password, hashed)
        finally:
            self._waiting -= 1
        if not is_right or known is None:
            return PasswordVerdict.WRONG
        self._guesses.charge(client, -1)
        if len(self._good) > 2 * len(users):  # some names are no longer users
            self._good.clear()
        self._good[name] = digest
        return PasswordVerdict.OK

    def _digest(self, hashed: bytes, password: bytes) -> bytes:
        return hmac.digest(self._secret, hashed + b"\0" + password, hashlib.sha256)

    def _decoy(self, users: Mapping[bytes, bytes], name: bytes) -> bytes:
        """Return the hash of some user, the same one each time for a name."""
        hashes = sorted(users.values())
        return hashes[int.from_bytes(self._digest(b"decoy", name)[:8]) % len(hashes)]


def _parse_basic(header: bytes) -> tuple[bytes, bytes] | None:
    scheme, _, rest = header.partition(b" ")
    if scheme.lower() != b"basic":
        return None
    try:
        name, colon, password = base64.b64decode(rest.strip(), validate=True).partition(b":")
    except (binascii.Error, ValueError):
        return None
    return (name, password) if colon else None


def bcrypt_matches(password: bytes, hashed: bytes) -> bool:
    """Return whether the password has the hash."""
    import bcrypt  # noqa: PLC0415 - only a daemon with users needs it

    try:
        return bcrypt.checkpw(password[:_BCRYPT_BYTES], hashed)
    except ValueError:  # the hash has the right form but no valid salt
        return False
