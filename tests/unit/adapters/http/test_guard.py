"""The HTTP server's guards: requests, connection limit, deadlines and passwords, each by itself."""

from __future__ import annotations

import base64
import socket
import threading
from http import HTTPStatus
from typing import cast

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from arpd.adapters.http.connection_limit import (
    MAX_PER_CLIENT,
    MAX_PLACES,
    MAX_THREADS,
    Connection,
    ConnectionLimit,
    client_of,
    contested,
)
from arpd.adapters.http.exchange import Stream
from arpd.adapters.http.passwords import (
    BURST,
    MAX_CLIENTS,
    MAX_WAITING,
    Passwords,
    PasswordVerdict,
    bcrypt_matches,
    parse_basic,
)
from arpd.adapters.http.request import MAX_HEAD_BYTES, METHODS, Request, RequestRefusedError, read_request
from tests.unit.web_world import HASH, PASSWORD, Clock

GOOD = b"GET /metrics?x=1 HTTP/1.1\r\nHost: robot\r\nAccept: text/plain\r\nAuthorization: Basic eDp5\r\n\r\n"


def receiving(*chunks):
    rest = iter(chunks)
    return lambda most: next(rest, b"")


def refused(raw):
    with pytest.raises(RequestRefusedError) as error:
        read_request(receiving(raw))
    return error.value.status


# -- requests


@pytest.mark.parametrize("size", [1, 7, 4096])
def test_a_request_is_read_however_it_is_cut(size):
    """Path, formats and credentials arrive whole, byte by byte or at once."""
    got = read_request(receiving(*(GOOD[i : i + size] for i in range(0, len(GOOD), size))))
    assert got == Request(path="/metrics", wants_body=True, accept="text/plain", authorization=b"Basic eDp5")
    assert "eDp5" not in repr(got)


@pytest.mark.parametrize(
    ("raw", "status"),
    [
        (b"GET /\r\n\r\n", 400),
        (b"GET / HTTP/1.1\r\n\r\n", 400),
        (b"\x16\x03\x01\x02\x00\x01\x00", 400),
        (b"GET / HTTP/1.0\r\nContent-Length: -1\r\n\r\n", 400),
        (b"GET / HTTP/1.0\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n", 400),
        (b"GET / HTTP/1.0\r\n broken\r\n\r\n", 400),
        (b"GET / HTTP/2.0\r\n\r\n", 505),
        (b"POST / HTTP/1.0\r\n\r\n", 405),
        (b"GET / HTTP/1.0\r\nContent-Length: 5\r\n\r\nhello", 413),
        (b"GET / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n", 413),
        (b"GET / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: gzip\r\n\r\n", 501),
        (b"GET /" + b"a" * 3000 + b" HTTP/1.0\r\n\r\n", 414),
        (b"GET / HTTP/1.0\r\n" + b"A: b\r\n" * 65 + b"\r\n", 431),
    ],
)
def test_what_is_no_request_is_refused_by_its_code(raw, status):
    """A request that is malformed, too large, has a body or another method gets its own code."""
    assert refused(raw) == status


def test_a_head_without_an_end_is_refused_before_it_fills_memory():
    """The server reads no more bytes than a head may have."""
    taken = 0

    def receive(most):
        nonlocal taken
        taken += most
        return b"GET / HTTP/1.0\r\n"[:most] if taken == most else b"A: b\r\n" * (most // 6)

    with pytest.raises(RequestRefusedError) as error:
        read_request(receive)
    assert error.value.status is HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
    assert taken <= MAX_HEAD_BYTES + 2 * 4096


@settings(max_examples=150, deadline=None)
@given(raw=st.binary(max_size=300), cut=st.integers(0, len(GOOD)), at=st.integers(1, 400))
@example(raw=b"", cut=0, at=1)
def test_any_bytes_are_a_request_or_refused(raw, cut, at):
    """Any bytes in any pieces are a request with a known method and an ASCII path, or refused."""
    stream = GOOD[:cut] + raw + GOOD[cut:]
    try:
        got = read_request(receiving(stream[:at], stream[at:]))
    except (RequestRefusedError, ConnectionError):
        return
    assert got.path.isascii()
    assert stream.lstrip(b"\r\n").split(b" ")[0] in METHODS


# -- connection limit


def test_a_client_at_its_share_gives_up_its_own_oldest():
    """One client cannot fill the limit, and evicts its own connections only."""
    clients = ["b", *["a"] * MAX_PER_CLIENT]
    assert contested(clients, "a") == list(range(1, MAX_PER_CLIENT + 1))
    assert contested(clients, "c") == []


def test_when_all_places_are_taken_the_client_with_most_gives_up_its_oldest():
    """A newcomer evicts a connection of the client that floods."""
    clients = ["scraper", *["a"] * (MAX_PLACES - 5), *["b"] * 4]
    assert contested(clients, "new")[0] == 1
    assert contested(clients, "scraper")[0] == 1
    assert contested(clients, "new")[-1] == 0


@settings(max_examples=100, deadline=None)
@given(moves=st.lists(st.tuples(st.sampled_from("abcdef"), st.booleans(), st.integers(0, 30)), max_size=80))
def test_places_threads_and_shares_are_bounded_and_a_new_client_gets_in(moves):
    """The bounds hold at every move, and a client without a connection gets in while any connection can be evicted."""
    limit = ConnectionLimit(patience_s=0.0)
    inside: list[Connection] = []
    threads: list[Connection] = []
    for client, works, leaver in moves:
        entered, evicted = limit.enter(cast("socket.socket", _NoSocket()), client)
        if entered is None:
            is_free = len(inside) < MAX_PLACES and sum(c.client == client for c in inside) < MAX_PER_CLIENT
            assert len(threads) >= MAX_THREADS or not is_free
            assert len(threads) >= MAX_THREADS or not any(c.is_waiting and c.client == client for c in inside)
            assert any(c.client == client for c in inside) or not any(c.is_waiting for c in inside)
        else:
            entered.is_waiting = not works
            inside.append(entered)
            threads.append(entered)
        if evicted is not None:
            assert evicted.is_waiting
            inside.remove(evicted)
        if leaver < len(threads):
            gone = threads.pop(leaver)
            limit.leave(gone)
            if gone in inside:
                inside.remove(gone)
        assert len(inside) <= MAX_PLACES
        assert len(threads) <= MAX_THREADS
        assert max(sum(c.client == name for c in inside) for name in "abcdef") <= MAX_PER_CLIENT


class _NoSocket:
    """Stands for a socket; its eviction does nothing."""


@pytest.fixture(autouse=True)
def _shutdown_of_no_socket(monkeypatch):
    real = socket.socket.shutdown
    monkeypatch.setattr(
        socket.socket, "shutdown", lambda s, how: None if isinstance(s, _NoSocket) else real(s, how), raising=True
    )


@pytest.mark.parametrize(
    ("address", "client"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("::ffff:192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("odd", "odd"),
    ],
)
def test_whoever_has_many_addresses_counts_once(address, client):
    """An IPv6 host may take any address of its /64."""
    assert client_of(address) == client


# -- deadlines


def test_a_trickle_does_not_hold_a_connection():
    """The deadline covers all bytes together."""
    here, there = socket.socketpair()
    now_s = 0.0
    stream = Stream(here, clock=lambda: now_s)
    stream.allow(5.0)
    with here, there:
        for second in range(5):
            now_s = float(second)
            there.send(b"x")
            assert stream.receive(1) == b"x"
        now_s = 5.0
        there.send(b"x")
        with pytest.raises(TimeoutError):
            stream.receive(1)
        with pytest.raises(TimeoutError):
            stream.send(b"x")


# -- passwords


class Bcrypt:
    """Counts runs; the hash of a password is its reverse."""

    def __init__(self):
        self.runs = []

    def __call__(self, password, hashed):
        self.runs.append((password, hashed))
        return password == hashed[::-1]


@pytest.fixture
def passwords():
    return Passwords(clock=Clock(), secret=b"s" * 32, check=Bcrypt())


def basic(name, password):
    return b"Basic " + base64.b64encode(f"{name}:{password}".encode())


USERS = {b"alice": b"ecila", b"bob": b"bob"}


def test_a_right_password_is_checked_once_and_then_remembered(passwords):
    """A scrape runs bcrypt the first time only; a changed hash runs it again."""
    assert passwords.judge(USERS, basic("alice", "alice"), "a") is PasswordVerdict.OK
    assert passwords.judge(USERS, basic("alice", "alice"), "b") is PasswordVerdict.CACHED
    assert passwords.judge(USERS, basic("alice", "wrong"), "b") is PasswordVerdict.WRONG
    assert passwords.judge(USERS | {b"alice": b"other"}, basic("alice", "alice"), "a") is PasswordVerdict.WRONG
    assert len(passwords._check.runs) == 3


def test_an_unknown_name_costs_what_a_known_one_does(passwords):
    """An unknown name runs bcrypt once against a real hash, the same each time, and is never right."""
    for password in ("x", "ecila", "bob", "alice"):
        assert passwords.judge({b"alice": b"ecila"}, basic("mallory", password), "a") is PasswordVerdict.WRONG
    assert [hashed for _, hashed in passwords._check.runs] == [b"ecila"] * 4
    assert passwords._good == {}


@pytest.mark.parametrize("header", [b"", b"Basic", b"Basic !", b"Basic YQ==", b"Bearer YTpi", b"Digest YTpi"])
def test_without_credentials_nothing_is_checked(passwords, header):
    """A header without name and password does not run bcrypt."""
    assert passwords.judge(USERS, header, "a") is PasswordVerdict.MISSING
    assert passwords._check.runs == []


def test_who_guesses_waits_and_who_is_remembered_does_not(passwords):
    """After a burst a client has one guess a second; other clients and remembered passwords do not wait."""
    passwords.judge(USERS, basic("alice", "alice"), "a")
    verdicts = [passwords.judge(USERS, basic("alice", str(i)), "a") for i in range(int(BURST) + 3)]
    assert verdicts == [PasswordVerdict.WRONG] * int(BURST) + [PasswordVerdict.THROTTLED] * 3
    assert passwords.judge(USERS, basic("alice", "alice"), "a") is PasswordVerdict.CACHED
    assert passwords.judge(USERS, basic("bob", "bob"), "b") is PasswordVerdict.OK
    passwords._clock.now_s = 1.0
    assert passwords.judge(USERS, basic("alice", "x"), "a") is PasswordVerdict.WRONG
    assert passwords.judge(USERS, basic("alice", "x"), "a") is PasswordVerdict.THROTTLED


def test_many_clients_take_no_more_memory_than_some(passwords):
    """The client that was silent longest is forgotten."""
    for number in range(2 * MAX_CLIENTS):
        passwords.judge(USERS, basic("alice", "x"), str(number))
    assert len(passwords._budgets) <= MAX_CLIENTS


def test_few_wait_for_bcrypt_and_one_runs():
    """Further requests are refused, so that guesses cannot use up the connection limit."""
    started, finish = threading.Semaphore(0), threading.Event()
    running, most = [], []

    def slow(_password, _hashed):
        running.append(1)
        most.append(len(running))
        started.release()
        finish.wait(10.0)
        running.pop()
        return False

    passwords = Passwords(clock=Clock(), secret=b"s", check=slow)
    verdicts = []

    def guess(number):
        verdicts.append(passwords.judge(USERS, basic("alice", "x"), str(number)))

    threads = [threading.Thread(target=guess, args=(number,)) for number in range(MAX_WAITING + 3)]
    for thread in threads:
        thread.start()
    assert started.acquire(timeout=10.0)
    for thread in threads:
        if verdicts.count(PasswordVerdict.BUSY) == 3:
            break
        thread.join(1.0)
    finish.set()
    for thread in threads:
        thread.join(10.0)
    assert sorted(verdicts) == [PasswordVerdict.BUSY] * 3 + [PasswordVerdict.WRONG] * MAX_WAITING
    assert max(most) == 1


def test_bcrypt_is_the_real_one():
    """Every prefix of exporters' hashes, passwords beyond 72 bytes and odd hashes raise no error."""
    assert bcrypt_matches(PASSWORD.encode(), HASH.encode())
    assert bcrypt_matches(PASSWORD.encode(), HASH.replace("$2b$", "$2y$").encode())
    assert not bcrypt_matches(b"x" * 100, HASH.encode())
    assert not bcrypt_matches(b"a\0b", HASH.encode())
    assert not bcrypt_matches(b"a", b"$2a$04$" + b"z" * 53)


@settings(max_examples=100, deadline=None)
@given(name=st.binary(max_size=20).filter(lambda n: b":" not in n), password=st.binary(max_size=80), noise=st.binary())
def test_credentials_come_back_as_they_went_and_noise_does_no_harm(name, password, noise):
    """Names and passwords of any bytes are parsed; any other header gives None or two byte strings."""
    header = b"bAsIc  " + base64.b64encode(name + b":" + password)
    assert parse_basic(header) == (name, password)
    for odd in (noise, b"Basic " + noise, header + noise):
        got = parse_basic(odd)
        assert got is None or len(got) == 2
