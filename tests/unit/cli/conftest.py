"""The command line as tests run it."""

from __future__ import annotations

import pytest

from arpd.cli import main as cli


@pytest.fixture(autouse=True)
def _piped(monkeypatch):
    """Let what is printed be as wide as it is, and plain: pytest-xdist gives its workers a width, CI often colours."""
    for name in ("COLUMNS", "FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def run(capsys):
    """Run the command line; returns exit code, stdout and stderr."""

    def run(*arguments):
        code: int | str | None
        try:
            code = cli.main([str(argument) for argument in arguments])
        except SystemExit as exiting:
            code = exiting.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def config(tmp_path, request):
    """Write a configuration, by default the module's ``SMALL``; returns its path."""

    def config(text=None):
        path = tmp_path / "arpd.yaml"
        path.write_text(request.module.SMALL if text is None else text)
        return path

    return config
