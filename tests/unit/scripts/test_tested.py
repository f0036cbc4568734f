"""What scripts/test makes of pytest's outcomes: skipped tests that are failures there, and its closing lines."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.tested import lines, tally

REPO = Path(__file__).parents[3]
TESTS = """
import pytest

class TestOne:
    def test_passes(self): pass

@pytest.mark.parametrize("n", [1, 2])
def test_fails(n): assert n < 0

@pytest.fixture
def broken(): raise OSError

def test_breaks(broken): pass

@pytest.mark.skipif(True, reason="no link here")
def test_is_refused(): pass

def test_lacks_a_package(): pytest.skip("chromium is not installed (apt-get install chromium)")
"""
WHOLE_FILE = "import pytest\npytest.importorskip('nosuch', reason='nosuch is not installed')\ndef test_x(): pass\n"


@pytest.fixture
def closing(tmp_path):
    """Run pytest on both files with the hooks of tests/conftest.py, and return the closing lines."""

    def closing(**environment):
        (tmp_path / "test_mixed.py").write_text(TESTS)
        (tmp_path / "test_whole.py").write_text(WHOLE_FILE)
        report = tmp_path / "report.xml"
        options = ("-q", "-p", "tests.conftest", "-c", os.devnull, "--continue-on-collection-errors", "--rootdir", ".")
        subprocess.run(
            [sys.executable, "-m", "pytest", *options, "-o", "junit_family=xunit1", "--junit-xml", report, "."],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": f"{REPO}:{REPO / 'tests'}", **environment},
            capture_output=True,
            check=False,
        )
        return lines(tally([report, report]))

    return closing


def test_the_closing_lines_name_what_failed_and_why_tests_were_skipped(closing):
    """Two runs are summed up; the last line has the form of pytest's own."""
    *wrong, untested, counts = closing(ARPD_TESTS_MISSING="")
    assert wrong == 2 * [f"FAILED test_mixed.py::{name}" for name in ("test_fails[1]", "test_fails[2]", "test_breaks")]
    assert untested == (
        "not tested: 2 (nosuch is not installed); 2 (no link here); "
        "2 (chromium is not installed (apt-get install chromium))"
    )
    assert counts.startswith("4 failed, 2 passed, 6 skipped, 2 errors in ")


def test_a_missing_package_is_a_failure_where_scripts_test_installs_it(closing):
    """What is skipped for another reason stays so."""
    *wrong, untested, counts = closing(ARPD_TESTS_MISSING="fail")
    assert {"FAILED test_mixed.py::test_lacks_a_package", "FAILED test_whole.py"} <= set(wrong)
    assert untested == "not tested: 2 (no link here)"
    assert counts.startswith("6 failed, 2 passed, 2 skipped, 4 errors in ")
