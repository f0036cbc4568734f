"""A robot and a base computer, each booted with its own systemd, a shaped link between them, and arpd's package."""

import os
from contextlib import ExitStack

import pytest


@pytest.fixture(scope="package")
def computers():
    """Boot both once for all tests of the folder, and build the package."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    pytest.importorskip("pyroute2", reason="pyroute2 is not installed: pip install pyroute2")
    from scripts.netns import simlink
    from scripts.netns.namespaces import NETNS_DIR
    from tests.all.system import machine
    from tests.all.system.computers import IS_SYSTEMS, Computers

    for can, why in (
        (IS_SYSTEMS, "ROS is here for another Python than the system's"),  # on which a package depends
        simlink.available(),
        machine.available(),
    ):
        if not can:
            pytest.skip(why)
    with ExitStack() as stack:
        link = stack.enter_context(simlink.SimLink(f"system-{os.getpid()}", domain_id=0))
        booted = (
            machine.booted(f"arpd-{os.getpid()}-{host.name}", network=NETNS_DIR / host.namespace) for host in link.hosts
        )
        yield Computers(link, *map(stack.enter_context, booted))
