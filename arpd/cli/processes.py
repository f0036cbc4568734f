"""`arpd run`, `arpd relay` and `arpd peer`: the processes that run for long."""

from __future__ import annotations

import argparse

from arpd.cli.options import Command, add_config, config_of
from arpd.model.quantities import printable
from arpd.ros.names import is_full_name
from arpd.ros.probe_messages import MOST_NAME_BYTES
from arpd.ros.rmw import require_middleware

_LEVELS = ("debug", "info", "warning", "error")
_RUN = """\
Run the daemon in the foreground: ten times a second it estimates what the link carries and sends the price that gives
every topic its rate; twice a second it also solves for DEADLINE and DEPTH, and applies changes to the live publishers.
It is never in the data path: when it stops, messages keep flowing. A clean stop (SIGTERM, Ctrl-C) gives the
publishers their own QoS back (on_stop in the configuration); SIGHUP reloads the configuration.

examples:
  arpd run                                   with /etc/arpd/arpd.yaml, as systemd runs it
  arpd run --config my.yaml --log-level debug"""
_RELAY = """\
Carry topics through publishers that arpd can tune. Any installed message type; no message is decoded.

Two ends (relay.link_domain in the configuration): this process on the robot and `arpd relay --far` on the base computer
carry topics under their own names, in both directions, while somebody on the other side reads them, and services and
actions.

One end (without it): subscribe on this host to the topics under relay.topics and publish them again, unchanged, as
relay.prefix + name. Readers across the link subscribe to the new name.

examples:
  arpd relay                                 with /etc/arpd/arpd.yaml
  arpd relay --far                           on the base computer, with the same file
  arpd relay --config my.yaml --node-name arpd_relay_camera"""
_PEER = """\
Run on the base computer, at the other end of the link. Ten times a second it reports to the daemon what its interface
received and which probe packets arrived; the robot cannot see either. It needs a configuration only for a relay with
two ends, whose link domain it joins.

examples:
  arpd peer                                  the likeliest interface, this host's name
  arpd peer --interface wlan0 --name laptop"""


def _add_log_level(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--log-level", choices=_LEVELS, default="info", help="how much to log (default %(default)s)")


def _add_run(parser: argparse.ArgumentParser) -> None:
    add_config(parser)
    _add_log_level(parser)


def _run(options: argparse.Namespace) -> int:
    from arpd.daemon.run import run_daemon

    require_middleware()
    return run_daemon(config_path=options.config, log_level=options.log_level)


def _add_relay(parser: argparse.ArgumentParser) -> None:
    add_config(parser)
    parser.add_argument(
        "--far", action="store_true", help="be the far end of a relay with two ends, on the base computer"
    )
    about = "name of the ROS node (default arpd_relay_HOST)"
    parser.add_argument("--node-name", type=_node_name, metavar="NAME", help=about)
    _add_log_level(parser)


def _node_name(word: str) -> str:
    if "/" in word or not is_full_name(f"/{word}"):
        raise argparse.ArgumentTypeError(f"{printable(word)} is no name of a ROS node; write letters, digits and _")
    return word


def _relay(options: argparse.Namespace) -> int:
    require_middleware()
    from arpd.relay.main import run_relay

    return run_relay(
        config_path=options.config, node_name=options.node_name, log_level=options.log_level, is_far=options.far
    )


def _add_peer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--interface", default="auto", help="interface of the link on this host (default %(default)s)")
    add_config(parser, otherwise="none where that does not exist")
    about = "name in the reports (default: that of this host, and the end of its interface's address)"
    parser.add_argument("--name", type=_peer_name, metavar="HOST", help=about)
    _add_log_level(parser)


def _peer_name(word: str) -> str:
    if not word.isprintable() or not 0 < len(word.encode()) <= MOST_NAME_BYTES:
        what = f"write up to {MOST_NAME_BYTES} bytes of printable characters"
        raise argparse.ArgumentTypeError(f"'{printable(word)}' is no name; {what}")
    return word


def _peer(options: argparse.Namespace) -> int:
    require_middleware()
    from arpd.ros.peer import run_peer

    config = config_of(options)
    return run_peer(interface=options.interface, name=options.name, config_path=config, log_level=options.log_level)


RUN = Command(_RUN, _add_run, _run)
RELAY = Command(_RELAY, _add_relay, _relay)
PEER = Command(_PEER, _add_peer, _peer)
