"""Patterns of names."""

from __future__ import annotations

import re
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.names import compile_patterns, is_pattern


@pytest.mark.parametrize(
    "text", ["", "/", "scan", "/scan/", "//scan", "/a b", "/1a", "/a**", "/**a", "/a/***", "/[ab]", "/a?", "/é", "~/a"]
)
def test_what_is_no_pattern(text):
    """Only stars are special, and two of them are a level of their own."""
    assert not is_pattern(text)


LEVELS = st.text(alphabet="ab*", min_size=1, max_size=4).filter(lambda level: "**" not in level) | st.just("**")
PATTERNS = st.lists(LEVELS, min_size=1, max_size=5).map(lambda levels: "/" + "/".join(levels))
NAMES = st.lists(st.text(alphabet="ab", min_size=1, max_size=5), min_size=1, max_size=6).map(tuple)


@cache
def matches(pattern, name):
    """Match levels one by one and try every way."""
    if not pattern:
        return not name
    first, rest = pattern[0], pattern[1:]
    if first != "**":
        is_level = bool(name) and re.fullmatch(first.replace("*", ".*"), name[0])
        return bool(is_level) and matches(rest, name[1:])
    least = 0 if rest else 1
    return any(matches(rest, name[skipped:]) for skipped in range(least, len(name) + 1))


@given(PATTERNS, NAMES)
def test_a_pattern_agrees_with_a_search_that_tries_everything(pattern, name):
    """The expression without a way back finds every match."""
    assert is_pattern(pattern)
    found = compile_patterns([pattern]).fullmatch("/" + "/".join(name))
    assert bool(found) is matches(tuple(pattern.split("/")[1:]), name)


@pytest.mark.parametrize("pattern", ["/" + "*a" * 100 + "*b", "/**/a" * 40 + "/b", "/**/*a*a*a" * 12 + "/b"])
def test_no_pattern_takes_long(pattern):
    """A pattern full of stars does not stop the relay; an expression with a way back would search for years."""
    compiled = compile_patterns([pattern])
    assert not any(compiled.fullmatch(name) for name in ("/" + "a" * 246, "/a" * 123))
