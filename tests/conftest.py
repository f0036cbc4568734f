"""Fixtures for more than one folder of tests."""

from __future__ import annotations

import pytest

from tests.golden.sample import make_snapshot


@pytest.fixture
def sample_snapshot():
    return make_snapshot()
