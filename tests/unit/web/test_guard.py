"""Passwords, and for whom they count."""

from __future__ import annotations

import base64
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from arpd.web.access import client_of
from arpd.web.passwords import (
    BURST,
    MAX_WAITING,
    Passwords,
    PasswordVerdict,
    bcrypt_matches,
)
from tests.unit.web_world import HASH, PASSWORD, Clock
from tests.waiting import eventually


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


def test_an_unknown_name_costs_what_a_known_one_does(passwords):
    """An unknown name runs bcrypt once against a real hash, the same each time, and is never right."""
    for password in ("x", "ecila", "bob", "alice"):
        assert passwords.judge({b"alice": b"ecila"}, basic("mallory", password), "a") is PasswordVerdict.WRONG
    assert [hashed for _, hashed in passwords._check.runs] == [b"ecila"] * 4
    assert passwords._good == {}


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


def test_few_wait_for_bcrypt_and_one_runs():
    """Further requests are refused, so that guesses cannot use up the connection limit."""
    finish = threading.Event()
    running, most = [], []

    def slow(_password, _hashed):
        running.append(1)
        most.append(len(running))
        finish.wait(60.0)
        running.pop()
        return False

    passwords = Passwords(clock=Clock(), secret=b"s", check=slow)
    guesses = range(MAX_WAITING + 3)
    with ThreadPoolExecutor(len(guesses)) as threads:
        judged = [threads.submit(passwords.judge, USERS, basic("alice", "x"), str(number)) for number in guesses]
        eventually("the last three are refused", lambda: sum(each.done() for each in judged) == 3)
        finish.set()
    verdicts = sorted(each.result() for each in judged)
    assert verdicts == [PasswordVerdict.BUSY] * 3 + [PasswordVerdict.WRONG] * MAX_WAITING
    assert max(most) == 1


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
