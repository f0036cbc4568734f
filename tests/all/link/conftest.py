"""A simulated link, built for each test."""

import os

import pytest


@pytest.fixture
def hosts(request, tmp_path):
    """Return `tests.all.link.hosts.Hosts`; a test's parameter may say how the link is.

    With ``memory`` each host has shared memory of its own, else Fast DDS shares none.
    """
    from scripts.netns.simlink import SimLink
    from tests.all.link.hosts import Hosts

    options = {**getattr(request, "param", {})}
    if "memory" in options:
        options["memory"] = tmp_path
    with SimLink(f"hosts-{os.getpid()}", **options) as link:
        hosts = Hosts(link, tmp_path)
        yield hosts
        print(hosts.told())
