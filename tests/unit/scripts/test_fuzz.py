"""scripts/bench/fuzz.py: the tests whose examples it draws."""

from __future__ import annotations

import importlib

import pytest

from scripts.bench.fuzz import READERS


@pytest.mark.parametrize("reader", READERS)
def test_each_reader_has_a_test_that_takes_what_the_fuzzer_draws(reader):
    """A test that gets another name would end the fuzzer after minutes."""
    module, name = READERS[reader]
    assert hasattr(getattr(importlib.import_module(f"tests.unit.{module}"), name), "hypothesis")
