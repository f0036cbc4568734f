"""A simulated link, built for each test."""

import os

import pytest


@pytest.fixture
def hosts(request, tmp_path):
    """Return `tests.all.link.hosts.Hosts`; a test's parameter may say how the link is."""
    from scripts.netns.simlink import SimLink
    from tests.all.link.hosts import Hosts

    with SimLink(f"hosts-{os.getpid()}", **getattr(request, "param", {})) as link:
        hosts = Hosts(link, tmp_path)
        yield hosts
        print(hosts.told())
