"""States of arpd's units, from the answer of `systemctl show`."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from arpd.adapters.systemd.units import NAMES, read_units
from arpd.report.health import Unknown
from arpd.report.health_host import Unit

ANSWER = """\
Id=arpd.service
LoadState=loaded
ActiveState=active
UnitFileState=enabled

Id=arpd-relay.service
LoadState=loaded
ActiveState=failed
UnitFileState=disabled

Id=arpd-peer.service
LoadState=not-found
ActiveState=inactive
UnitFileState=
"""


def test_units_that_are_installed_are_told(tmp_path):
    """Those that systemd does not find are not."""
    assert read_units(ask=lambda: ANSWER, booted=tmp_path) == [
        Unit(name="arpd", active="active", is_enabled=True),
        Unit(name="arpd-relay", active="failed", is_enabled=False),
    ]
    assert read_units(ask=lambda: "", booted=tmp_path) == []


@pytest.mark.parametrize("fault", [FileNotFoundError("systemctl"), subprocess.TimeoutExpired("systemctl", 10)])
def test_a_systemd_that_does_not_answer_is_not_known(tmp_path, fault):
    """Nor is one that does not run."""

    def fail():
        raise fault

    assert isinstance(read_units(ask=fail, booted=tmp_path), Unknown)
    assert isinstance(read_units(ask=lambda: ANSWER, booted=tmp_path / "nowhere"), Unknown)


def test_every_unit_of_the_repository_is_asked_for():
    """A new unit needs a name here."""
    units = {path.name for path in (Path(__file__).parents[4] / "systemd").glob("*.service")}
    assert units == set(NAMES)
