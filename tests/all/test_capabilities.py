"""What the machine must be able to do, so that no test of this folder is left out without a word."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from scripts.bench import slow
from scripts.netns import simlink
from scripts.netns.simlink import user_namespace_argv
from tests.all.system import machine


def _runs(*argv):
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stderr.strip()


CAPABILITIES = {
    "network namespaces with a shaped link that loses packets": simlink.available,
    "a machine with its own systemd, in systemd-nspawn on an overlay": machine.available,
    "cgroups with a quota of cpu": slow.available,
    "clocks of its own": lambda: _runs("unshare", "--time", "--boottime=60", "--fork", "--", "true"),
    "root of a user namespace": lambda: _runs(*user_namespace_argv(["true"])),
    "a /dev/shm of its own": lambda: _runs("unshare", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/dev/shm"),
    "Chromium": lambda: (shutil.which("chromium") is not None, "apt-get install chromium"),
    "Prometheus": lambda: _runs("scripts/get-prometheus", "prometheus"),
}


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_this_machine_has(capability):
    """A capability that is missing is a failure here, and the tests that need it are named as not tested."""
    is_there, why_not = CAPABILITIES[capability]()
    assert is_there, why_not
