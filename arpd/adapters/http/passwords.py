"""Basic authentication against bcrypt hashes, at a bounded cost.

bcrypt takes 50 to 300 ms of CPU on purpose. So a good password is remembered, one run is under way at a time, few wait
for it, and who guesses is made to wait.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import threading
from collections import OrderedDict
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

MAX_WAITING = 4  # threads in or before bcrypt; each holds a place of the server
MAX_CLIENTS = 256
BURST = 5.0  # wrong passwords a client has at once …
REFILL_HZ = 1.0  # … and then one a second
_BCRYPT_BYTES = 72  # bcrypt reads no more of a password; the library before 5.0 cuts it, the later one raises


class PasswordVerdict(StrEnum):
    """What became of a request's credentials."""

    OK = "ok"
    CACHED = "cached"
    MISSING = "missing"
    WRONG = "wrong"
    THROTTLED = "throttled"  # the client had too many wrong ones lately
    BUSY = "busy"  # too many wait for bcrypt


class Passwords:
    """Judges credentials.

    Parameters
    ----------
    clock : monotonic clock (s)
    secret : key of the digests that stand for remembered passwords; random bytes
    check : whether a password has a bcrypt hash
    """

    def __init__(
        self, *, clock: Callable[[], float], secret: bytes, check: Callable[[bytes, bytes], bool] | None = None
    ) -> None:
        self._clock = clock
        self._secret = secret
        self._check = check or bcrypt_matches
        self._lock = threading.Lock()
        self._bcrypt = threading.Lock()
        self._waiting = threading.BoundedSemaphore(MAX_WAITING)
        self._good: dict[bytes, bytes] = {}
        self._budgets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # client → (wrong ones left, when)

    def judge(self, users: Mapping[bytes, bytes], authorization: bytes, client: str) -> PasswordVerdict:
        """Say whether a request may pass.

        Parameters
        ----------
        users : name → bcrypt hash, at least one
        authorization : the request's header
        client : whom a wrong password counts against
        """
        credentials = parse_basic(authorization)
        if credentials is None:
            return PasswordVerdict.MISSING
        name, password = credentials
        known = users.get(name)
        # An unknown name costs what a known one does, so that time tells nothing.
        hashed = self._decoy(users, name) if known is None else known
        digest = self._digest(hashed, password)
        with self._lock:
            if known is not None and hmac.compare_digest(self._good.get(name, b""), digest):
                return PasswordVerdict.CACHED
            if not self._take(client):
                return PasswordVerdict.THROTTLED
        if not self._waiting.acquire(blocking=False):
            self._give_back(client)
            return PasswordVerdict.BUSY
        try:
            with self._bcrypt:
                is_right = self._check(password, hashed)
        finally:
            self._waiting.release()
        if not is_right or known is None:
            return PasswordVerdict.WRONG
        self._give_back(client)
        with self._lock:
            if len(self._good) > 2 * len(users):  # names that are users no more
                self._good.clear()
            self._good[name] = digest
        return PasswordVerdict.OK

    def _digest(self, hashed: bytes, password: bytes) -> bytes:
        return hmac.digest(self._secret, hashed + b"\0" + password, hashlib.sha256)

    def _decoy(self, users: Mapping[bytes, bytes], name: bytes) -> bytes:
        """Return the hash of some user, always the same one for a name."""
        hashes = sorted(users.values())
        return hashes[int.from_bytes(self._digest(b"decoy", name)[:8]) % len(hashes)]

    def _take(self, client: str) -> bool:
        """Take one attempt from the client's budget, if it has one; the longest silent client is forgotten."""
        now_s = self._clock()
        left, since_s = self._budgets.pop(client, (BURST, now_s))
        left = min(BURST, left + (now_s - since_s) * REFILL_HZ)
        is_allowed = left >= 1.0
        self._budgets[client] = (left - 1.0 if is_allowed else left, now_s)
        if len(self._budgets) > MAX_CLIENTS:
            self._budgets.popitem(last=False)
        return is_allowed

    def _give_back(self, client: str) -> None:
        with self._lock:
            left, since_s = self._budgets.get(client, (BURST, self._clock()))
            self._budgets[client] = (min(BURST, left + 1.0), since_s)


def parse_basic(header: bytes) -> tuple[bytes, bytes] | None:
    """Return name and password of an Authorization header, None if there are none. Pure, total: worth fuzzing."""
    scheme, _, rest = header.partition(b" ")
    if scheme.lower() != b"basic":
        return None
    try:
        name, colon, password = base64.b64decode(rest.strip(), validate=True).partition(b":")
    except (binascii.Error, ValueError):
        return None
    return (name, password) if colon else None


def bcrypt_matches(password: bytes, hashed: bytes) -> bool:
    """Say whether the password has the hash, one the web-config's check let pass; imports bcrypt when first asked."""
    import bcrypt  # noqa: PLC0415 - only a daemon with users needs it

    try:
        return bcrypt.checkpw(password[:_BCRYPT_BYTES], hashed)
    except ValueError:  # a hash whose letters encode no salt
        return False
