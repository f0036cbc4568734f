"""Passwords, and for whom they count."""

import asyncio
import base64
import threading
from unittest.mock import Mock

import pytest

from arpd.web.access import client_of
from arpd.web.passwords import MAX_WAITING, MOST_WRONG, Passwords, PasswordVerdict, bcrypt_matches
from tests.unit.web_world import HASH, PASSWORD

USERS = {b"alice": b"ecila", b"bob": b"bob"}


@pytest.fixture
def passwords():
    reverse = Mock(side_effect=lambda password, hashed: password == hashed[::-1])
    return Passwords(clock=Mock(return_value=0.0), secret=b"s" * 32, check=reverse)


@pytest.fixture
def judge(passwords):
    return lambda *who, users=USERS: asyncio.run(verdict(passwords, *who, users=users))


async def verdict(passwords, name, password, client, *, users=USERS):
    given = b"Basic " + base64.b64encode(f"{name}:{password}".encode())
    return await passwords.judge(users, given, client)


def test_an_unknown_name_costs_what_a_known_one_does(passwords, judge):
    """An unknown name runs bcrypt once against a real hash, the same each time, and is never right."""
    for password in ("x", "ecila", "bob", "alice"):
        assert judge("mallory", password, "a", users={b"alice": b"ecila"}) is PasswordVerdict.WRONG
    assert [run.args[1] for run in passwords._check.call_args_list] == [b"ecila"] * 4
    assert passwords._good == {}


def test_who_guesses_waits_and_who_is_remembered_does_not(passwords, judge):
    """A client has five guesses in five seconds; other clients and remembered passwords do not wait."""
    judge("alice", "alice", "a")
    verdicts = [judge("alice", str(i), "a") for i in range(MOST_WRONG + 3)]
    assert verdicts == [PasswordVerdict.WRONG] * MOST_WRONG + [PasswordVerdict.THROTTLED] * 3
    assert judge("alice", "alice", "a") is PasswordVerdict.CACHED
    assert judge("bob", "bob", "b") is PasswordVerdict.OK
    passwords._clock.return_value = 5.0
    assert judge("alice", "x", "a") is PasswordVerdict.WRONG


def test_few_wait_for_bcrypt_and_one_runs():
    """Further requests are refused, so that guesses cannot use up the connection limit, and do not count as guesses."""
    finish, one_at_a_time = threading.Event(), threading.Lock()
    alone = []

    def slow(_password, _hashed):
        alone.append(one_at_a_time.acquire(blocking=False))
        finish.wait(60.0)
        one_at_a_time.release()
        return False

    passwords = Passwords(clock=Mock(return_value=0.0), secret=b"s", check=slow)

    async def flood():
        guesses = [asyncio.create_task(verdict(passwords, "alice", "x", f"{n}")) for n in range(MAX_WAITING + 3)]
        refused, waiting = await asyncio.wait(guesses, return_when=asyncio.FIRST_COMPLETED)
        finish.set()
        verdicts = [await each for each in refused], [await each for each in waiting]
        return *verdicts, [await verdict(passwords, "alice", "x", f"{MAX_WAITING}") for _ in range(MOST_WRONG)]

    busy, *wrong = asyncio.run(flood())
    assert busy == [PasswordVerdict.BUSY] * 3
    assert wrong == [[PasswordVerdict.WRONG] * MAX_WAITING, [PasswordVerdict.WRONG] * MOST_WRONG]
    assert alone == [True] * (MAX_WAITING + MOST_WRONG)


def test_whoever_has_many_addresses_counts_once():
    """An IPv6 host may take any address of its /64."""
    found = [client_of(address) for address in ("192.0.2.1", "2001:db8:1:2:3:4:5:6", "fe80::1%eth0")]
    assert found == ["192.0.2.1", "2001:db8:1:2::/64", "fe80::/64"]


def test_bcrypt_is_the_real_one():
    """Every prefix of exporters' hashes, passwords beyond 72 bytes and odd hashes raise no error."""
    assert bcrypt_matches(PASSWORD.encode(), HASH.encode())
    assert bcrypt_matches(PASSWORD.encode(), HASH.replace("$2b$", "$2y$").encode())
    assert not bcrypt_matches(b"x" * 100, HASH.encode())
    assert not bcrypt_matches(b"a\0b", HASH.encode())
    assert not bcrypt_matches(b"a", b"$2a$04$" + b"z" * 53)
