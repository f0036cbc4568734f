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
import os, pytest

def test_passes(): pass

def test_fails(): assert False

def test_needs_the_machine_alone(): assert "IS_ALONE" in os.environ

@pytest.fixture
def broken(): raise OSError

def test_breaks(broken): pass

def test_lacks_a_link(): pytest.skip("no link here")
"""
WHOLE_FILE = "import pytest\npytest.importorskip('nosuch', reason='nosuch is not installed')\ndef test_x(): pass\n"


@pytest.fixture
def run(tmp_path):
    """Run pytest on both files with the hooks of tests/conftest.py, and return the path of its report."""
    (tmp_path / "test_mixed.py").write_text(TESTS)
    (tmp_path / "test_whole.py").write_text(WHOLE_FILE)

    def run(name, **environment):
        report = tmp_path / name
        options = ("-q", "-p", "tests.conftest", "-c", os.devnull, "--continue-on-collection-errors", "--rootdir", ".")
        subprocess.run(
            [sys.executable, "-m", "pytest", *options, "-o", "junit_family=xunit1", "--junit-xml", report, "."],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": f"{REPO}:{REPO / 'tests'}", **environment},
            capture_output=True,
            check=False,
        )
        return report

    return run


def test_the_closing_lines_name_what_failed_and_why_tests_were_skipped(run):
    """A test that failed and passes when it runs again has a line of its own; CI reads the last line."""
    first, again = run("report.xml", ARPD_TESTS_MISSING=""), run("again.xml", ARPD_TESTS_MISSING="", IS_ALONE="1")
    assert sorted(lines(tally([first], [again]))[:-1]) == [
        "FAILED test_mixed.py::test_breaks",
        "FAILED test_mixed.py::test_fails",
        "not tested: 1 (no link here)",
        "not tested: 1 (nosuch is not installed)",
        "passed only alone: test_mixed.py::test_needs_the_machine_alone",
    ]
    assert lines(tally([first], [again]))[-1] == "2 passed, 2 failed, 2 skipped"
    assert lines(tally([first]))[-1] == "1 passed, 3 failed, 2 skipped"


def test_a_skipped_test_is_a_failure_where_nothing_may_be_missing(run):
    """What is skipped there was not tested."""
    told = lines(tally([run("report.xml", ARPD_TESTS_MISSING="fail")]))
    assert {"FAILED test_mixed.py::test_lacks_a_link", "FAILED test_whole.py"} <= set(told)
    assert told[-1] == "1 passed, 5 failed"
