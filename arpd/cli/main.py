"""The `arpd` command: parses, runs the subcommand, turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from arpd import __version__
from arpd.cli.check import add_check
from arpd.cli.doctor import add_doctor
from arpd.cli.simulate import add_simulate
from arpd.cli.solve import add_solve
from arpd.cli.status import add_status, add_top
from arpd.cli.topics import add_topics
from arpd.model.errors import GET_ROS, ArpdError, ConfigError, RosUnavailableError

if TYPE_CHECKING:
    from collections.abc import Sequence

DEFAULT_CONFIG = Path("/etc/arpd/arpd.yaml")
_INTERRUPTED = 130  # 128 + SIGINT, what a shell reports
_BROKEN_PIPE = 141  # 128 + SIGPIPE, the same
_LEVELS = ("debug", "info", "warning", "error")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : command line without the program's name, by default the process's own
    """
    try:
        options = _parser().parse_args(arguments)
        code: int = options.handler(options)
        sys.stdout.flush()
    except ConfigError as error:
        # Without a prefix, so that an editor finds the place.
        for fault in error.faults:
            print(fault, file=sys.stderr)
        return error.exit_code
    except ArpdError as error:
        print(f"arpd: {error}", file=sys.stderr)
        return error.exit_code
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        if package in {"", "arpd"}:  # a fault of arpd itself
            raise
        print(f"arpd: {_incomplete(package, error)}", file=sys.stderr)
        return RosUnavailableError.exit_code
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        # The interpreter flushes stdout at exit, which must not raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    return code


def _incomplete(package: str, error: ImportError) -> str:
    if package == "rclpy" or package.endswith(("_interfaces", "_msgs")):
        way_out = GET_ROS
    else:
        way_out = (
            "arpd's Debian package (scripts/deb) brings all that its commands need; "
            "a colcon workspace brings the library for nodes alone"
        )
    return f"{package} cannot be imported by {sys.executable} ({' '.join(str(error).split())}); {way_out}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="arpd",
        description="Keeps a ROS 2 robot's wireless traffic inside what the link can carry, live.",
        epilog="""\
on the robot:     arpd run          the daemon: measures the link, plans rate, DEADLINE and DEPTH, applies them
                  arpd relay        carries topics of nodes whose code is not yours (optional)
on the other end: arpd peer         reports what arrives, so that the daemon knows the link
                  arpd relay --far  the far end of a relay with two ends (optional)

`arpd COMMAND --help` explains each, with examples.

exit codes: 0 done, 1 failed, 2 wrong usage, 3 no daemon answers, 69 ROS or a package is not there, 78 the configuration
is wrong""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"arpd {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_run(commands)
    _add_relay(commands)
    _add_peer(commands)
    add_topics(commands, default_config=DEFAULT_CONFIG)
    add_check(commands, default_config=DEFAULT_CONFIG)
    add_solve(commands)
    add_simulate(commands, default_config=DEFAULT_CONFIG)
    add_status(commands)
    add_top(commands)
    add_doctor(commands, default_config=DEFAULT_CONFIG)
    return parser


def _add_run(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "run",
        help="run the daemon on the robot computer",
        description="""\
Run the daemon in the foreground: ten times a second it estimates what the link carries and sends the price that gives
every topic its rate; twice a second it also solves for DEADLINE and DEPTH, and applies changes to the live publishers.
It is never in the data path: when it stops, messages keep flowing. A clean stop (SIGTERM, Ctrl-C) gives the
publishers their own QoS back (on_stop in the configuration); SIGHUP reloads the configuration.""",
        epilog="""\
examples:
  arpd run                                   with /etc/arpd/arpd.yaml, as systemd runs it
  arpd run --config my.yaml --log-level debug""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_config(parser)
    _add_log_level(parser)
    parser.set_defaults(handler=_run)


def _add_relay(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "relay",
        help="carry topics of nodes whose code is not yours",
        description="""\
Carry topics through publishers that arpd can tune. Any installed message type; no message is decoded.

Two ends (relay.link_domain in the configuration): this process on the robot and `arpd relay --far` on the base computer
carry topics under their own names, in both directions, while somebody on the other side reads them, and services and
actions.
One end (without it): subscribe on this host to the topics under relay.topics and publish them again, unchanged, as
relay.prefix + name. Readers across the link subscribe to the new name.""",
        epilog="""\
examples:
  arpd relay                                 with /etc/arpd/arpd.yaml
  arpd relay --far                           on the base computer, with the same file
  arpd relay --config my.yaml --node-name arpd_relay_camera""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_config(parser)
    parser.add_argument(
        "--far", action="store_true", help="be the far end of a relay with two ends, on the base computer"
    )
    parser.add_argument("--node-name", metavar="NAME", help="name of the ROS node (default arpd_relay_HOST)")
    _add_log_level(parser)
    parser.set_defaults(handler=_relay)


def _add_peer(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "peer",
        help="report what arrives at the other end of the link",
        description="""\
Run on the base computer, at the other end of the link. Ten times a second it reports to the daemon what its interface
received and which probe packets arrived; the robot cannot see either. It needs a configuration only for a relay with
two ends, whose link domain it joins.""",
        epilog="""\
examples:
  arpd peer                                  the likeliest interface, this host's name
  arpd peer --interface wlan0 --name laptop""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--interface", default="auto", help="interface of the link on this host (default %(default)s)")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help=f"YAML configuration (default {DEFAULT_CONFIG} if there is one)"
    )
    parser.add_argument("--name", metavar="HOST", help="name in the reports (default: this host's name)")
    _add_log_level(parser)
    parser.set_defaults(handler=_peer)


def _add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help="YAML configuration (default %(default)s)"
    )


def _add_log_level(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--log-level", choices=_LEVELS, default="info", help="how much to log (default %(default)s)")


def _run(options: argparse.Namespace) -> int:
    from arpd.daemon.run import run_daemon

    return run_daemon(config_path=options.config, log_level=options.log_level)


def _relay(options: argparse.Namespace) -> int:
    from arpd.relay.main import run_relay

    return run_relay(
        config_path=options.config, node_name=options.node_name, log_level=options.log_level, is_far=options.far
    )


def _peer(options: argparse.Namespace) -> int:
    from arpd.ros.peer import run_peer

    config_path = options.config or (DEFAULT_CONFIG if DEFAULT_CONFIG.exists() else None)
    return run_peer(
        interface=options.interface, name=options.name, config_path=config_path, log_level=options.log_level
    )
