"""The fixtures of tests/ros, for tests of times, rates and many processes."""

from __future__ import annotations

from tests.ros.conftest import _own_network, background, environment, ros, stack  # noqa: F401 - pytest finds them here
