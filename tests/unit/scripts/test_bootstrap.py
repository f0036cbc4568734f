"""Which Python scripts/bootstrap takes: the one that PYTHON names, or none. And the headers of the one in .venv."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BOOTSTRAP = Path(__file__).parents[3] / "scripts" / "bootstrap"


@pytest.fixture
def find(tmp_path):
    """Run find_python where ``programs`` are all the Python there is; returns what it found, or what it said."""
    (tmp_path / "tools").mkdir()
    for tool in ("basename", "head", "ls"):
        (tmp_path / "tools" / tool).symlink_to(shutil.which(tool))

    def find(wanted, **programs):
        for place, text in programs.items():
            folder = tmp_path / {"path": "bin", "pyenv": "pyenv/versions/3.12.9/bin"}[place]
            folder.mkdir(parents=True)
            program = folder / "python3.12"
            program.write_text(f"#!/bin/sh\n{text}\n")
            program.chmod(0o755)
        done = subprocess.run(
            [str(shutil.which("bash")), "-c", f"set -euo pipefail; . {BOOTSTRAP}; find_python"],
            env={"PATH": f"{tmp_path}/bin:{tmp_path}/tools", "PYENV_ROOT": f"{tmp_path}/pyenv", "PYTHON": wanted},
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout.strip().removeprefix(f"{tmp_path}/") if done.returncode == 0 else done.stderr

    return find


def test_a_name_is_looked_for_along_path(find):
    """The first one that runs and has a version arpd can use."""
    assert find("python3.12", path="echo 3.12.1", pyenv="echo 3.12.9") == "bin/python3.12"


def test_a_shim_of_pyenv_that_refuses_is_no_obstacle(find):
    """Pyenv's own 3.12 is taken in its place."""
    found = find("python3.12", path="echo pyenv: python3.12: command not found >&2; exit 127", pyenv="echo 3.12.9")
    assert found == "pyenv/versions/3.12.9/bin/python3.12"


@pytest.mark.parametrize(
    ("wanted", "program", "said"),
    [
        ("python3.12", "echo 3.10.4", "PYTHON=python3.12 is Python 3.10.4; 3.11, 3.12 or 3.13 is needed"),
        ("python3.12", "echo out of order >&2; exit 1", "PYTHON=python3.12 does not run: out of order"),
        ("/nosuch/python", "echo 3.12.1", "PYTHON=/nosuch/python is no program here"),
    ],
)
def test_another_one_is_never_taken_instead(find, wanted, program, said):
    """A sentence says what is wrong with the one that was named."""
    assert said in find(wanted, path=program)


@pytest.mark.parametrize(
    ("include", "code", "said"),
    [("with", 0, ""), ("without", 1, "install python3.12-dev by hand")],
)
def test_a_python_without_headers_names_their_package(tmp_path, include, code, said):
    """Debian's Python has its headers in a package of their own."""
    (tmp_path / "with").mkdir()
    (tmp_path / "with" / "Python.h").touch()
    (tmp_path / "sysconfig.py").write_text(
        f"def get_path(_): return {str(tmp_path / include)!r}\ndef get_python_version(): return '3.12'\n"
    )
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    (tmp_path / ".venv" / "bin" / "python").symlink_to(sys.executable)
    (tmp_path / "basename").symlink_to(shutil.which("basename"))
    done = subprocess.run(
        [str(shutil.which("bash")), "-c", f"set -euo pipefail; . {BOOTSTRAP}; need_headers"],
        # No PATH but this folder: no apt-get. The interpreter imports its sysconfig from there, too.
        env={"PATH": str(tmp_path), "PYTHONPATH": str(tmp_path), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr
