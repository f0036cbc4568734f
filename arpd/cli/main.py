"""The `arpd` command: parses, runs the subcommand, turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import errno
import os
import re
import sys
from contextlib import suppress
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from arpd import __version__
from arpd.model.errors import GET_ROS, ArpdError, ConfigError, NoAnswerError, RosUnavailableError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.cli.options import Command

_INTERRUPTED = 130  # 128 + SIGINT, what a shell reports
_BROKEN_PIPE = 141  # 128 + SIGPIPE, the same
# Of a full disk, a quota, a limit of the shell, a terminal that is gone: nothing but standard output raises them.
_OF_OUTPUT = {errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
COMMANDS = {
    "run": ("processes", "run the daemon on the robot computer"),
    "relay": ("processes", "carry topics of nodes whose code is not yours"),
    "peer": ("processes", "report what arrives at the other end of the link"),
    "topics": ("topics", "list and measure what crosses the link or could; --suggest writes a first configuration"),
    "check": ("check", "check a configuration file"),
    "solve": ("solve", "solve the published program, or plan your topics offline to tune their weights"),
    "simulate": ("simulate", "try a configuration on a recorded or made-up link"),
    "status": ("status", "show what the daemon sees and does"),
    "top": ("top", "watch what the daemon sees and does, live"),
    "doctor": ("doctor", "find what about this computer harms a robot on Wi-Fi"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : command line without the program's name, by default the process's own
    """
    _write_plainly()
    try:
        arguments = sys.argv[1:] if arguments is None else arguments
        command = next((word for word in arguments if not word.startswith("-")), "")
        options = _parser(command).parse_args(arguments)
        code: int = options.handler(options)
        print(end="", flush=True)
    except ConfigError as error:
        # Without a prefix, so that an editor finds the place.
        for fault in error.faults:
            print(fault, file=sys.stderr)
        return error.exit_code
    except ArpdError as error:
        print(f"arpd: {error}", file=sys.stderr)
        if isinstance(error, NoAnswerError):
            from arpd.cli.no_daemon import step_after

            if step := step_after(error):
                print(f"arpd: {step}", file=sys.stderr)
        return error.exit_code
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        if package in {"", "arpd"}:  # a fault of arpd itself
            raise
        print(f"arpd: {_incomplete(package, error)}", file=sys.stderr)
        return RosUnavailableError.exit_code
    except KeyboardInterrupt:
        return _INTERRUPTED
    except OSError as error:
        return _unwritten(error)
    return code


def _unwritten(error: OSError) -> int:
    if error.errno not in _OF_OUTPUT:
        raise error
    # The interpreter flushes stdout at exit, which must not raise again.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if error.errno == errno.EPIPE:
        return _BROKEN_PIPE
    print(f"arpd: {error.strerror}", file=sys.stderr)
    return ArpdError.exit_code


def _write_plainly() -> None:
    """Let no stream be missing where it is closed, or refuse a character that its encoding lacks."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name) or Path(os.devnull).open("w")  # noqa: SIM115 - until the process ends
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
        setattr(sys, name, stream)


def run_executable() -> int:
    """Run the command that an executable of ROS 2 is named after: `ros2 run arpd relay` is `arpd relay`.

    A launch file's Node gives each process ``--ros-args``, which rclpy reads from the process itself.
    """
    command, *arguments = sys.argv
    with suppress(Exception):  # argparse refuses what ROS cannot read
        from rclpy.utilities import remove_ros_args

        arguments = remove_ros_args(arguments)
    return main([Path(command).name, *arguments])


def _incomplete(package: str, error: ImportError) -> str:
    if package == "rclpy" or package.endswith(("_interfaces", "_msgs")):
        way_out = GET_ROS
    else:
        way_out = (
            "arpd's Debian package (scripts/deb) brings all that its commands need; "
            "a colcon workspace brings the library for nodes alone"
        )
    return f"{package} cannot be imported by {sys.executable} ({' '.join(str(error).split())}); {way_out}"


def is_table(paragraph: str) -> bool:
    """Return whether a paragraph of a command's text is no prose, but a table, an equation or examples."""
    return re.search(r"^ |\S {2,}\S", paragraph, re.MULTILINE) is not None


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Fills prose to the width of the terminal, and leaves the rest line by line."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        del indent
        paragraphs = text.strip("\n").split("\n\n")
        return "\n\n".join(each if is_table(each) else fill(each, width, break_on_hyphens=False) for each in paragraphs)


def _parser(command: str | None = None) -> argparse.ArgumentParser:
    """Return the parser; the module of a command is imported for that command alone, where one is given."""
    parser = argparse.ArgumentParser(
        prog="arpd",
        description="Keeps a ROS 2 robot's wireless traffic inside what the link can carry, live.",
        epilog="""\
`arpd run`, the daemon, runs on the robot, beside `arpd relay` if the code of nodes is not yours. `arpd peer` runs at
the other end of the link, so that the daemon knows the link, beside `arpd relay --far` if the relay has two ends.

`arpd COMMAND --help` explains each, with examples.

exit codes: 0 done, 1 failed, 2 wrong usage, 3 no daemon answers, 69 ROS or a package is not there, 78 the configuration
is wrong""",
        formatter_class=_HelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"arpd {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, (module, summary) in COMMANDS.items():
        added = commands.add_parser(name, help=summary, formatter_class=_HelpFormatter)
        if command in {None, name}:
            made: Command = getattr(import_module(f"arpd.cli.{module}"), name.upper())
            about, examples, rest = made.text.partition("\nexamples:\n")
            added.description, added.epilog = about, examples + rest
            made.add_options(added)
            added.set_defaults(handler=made.run)
    return parser
