"""What a command is, and the options that several have: configuration, the daemon's address, numbers within bounds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar
from urllib.parse import urlsplit

from arpd.model.errors import UsageError
from arpd.model.quantities import printable
from arpd.model.settings import HttpSettings

if TYPE_CHECKING:
    from collections.abc import Callable


DEFAULT_CONFIG = Path("/etc/arpd/arpd.yaml")
_Number = TypeVar("_Number", int, float)
_DEFAULT = HttpSettings()
DEFAULT_URL = f"http://{_DEFAULT.host}:{_DEFAULT.port}"
PASSWORD = "ARPD_PASSWORD"  # noqa: S105 - the variable's name
IN_CLEAR = "--password-in-clear"


class Command(NamedTuple):
    """One command of `arpd`: its text with examples, what adds its options to a parser, and what runs it."""

    text: str
    add_options: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def add_config(parser: argparse.ArgumentParser, *, otherwise: str = "") -> None:
    """Add ``--config``, by default the installed file; None with the installed one beside it where it may be missing.

    Parameters
    ----------
    otherwise : what stands for an installed file that is missing
    """
    about = f"YAML configuration (default {DEFAULT_CONFIG}{otherwise and ', or ' + otherwise})"
    parser.add_argument(
        "--config", type=Path, metavar="FILE", default=None if otherwise else DEFAULT_CONFIG, help=about
    )
    parser.set_defaults(default_config=DEFAULT_CONFIG)


def config_of(options: argparse.Namespace) -> Path | None:
    """Return the file of ``--config``, otherwise the installed one; None where that is missing."""
    installed: Path = options.default_config
    return options.config or (installed if installed.exists() else None)


def add_json(parser: argparse.ArgumentParser, about: str = "print JSON") -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help=about)


def add_address(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the daemon."""
    parser.add_argument("--url", default=DEFAULT_URL, help="base URL of the daemon (default %(default)s)")
    parser.add_argument(
        "--cacert", type=Path, metavar="FILE", help="CA of the daemon's certificate (default: the system's)"
    )
    parser.add_argument("--user", metavar="NAME", default="", help=f"log in; the password is taken from ${PASSWORD}")
    parser.add_argument(
        IN_CLEAR, action="store_true", help="with --user over http://: whoever hears the link may read the password"
    )


def host_of(url: str) -> str:
    """Return the host that a URL names, empty if it names none.

    Raises
    ------
    UsageError
        If it is no URL.
    """
    try:
        return urlsplit(url).hostname or ""
    except ValueError as error:
        raise no_address(url, error) from None


def no_address(url: str, error: Exception) -> UsageError:
    """Return the error that says why a URL is none."""
    return UsageError(f"--url {url!r} is not an HTTP address ({error}); write it like {DEFAULT_URL}")


def is_here(url: str, *, is_own_address: Callable[[str], bool] | None = None) -> bool:
    """Return whether a URL names this computer.

    Parameters
    ----------
    is_own_address : returns whether an IPv4 address, or a host name, is this computer's; by default the kernel tells
    """
    from arpd.host import kernel

    host = host_of(url)
    return host in {"localhost", "::1"} or (bool(host) and (is_own_address or kernel.is_own_address)(host))


def within(
    least: float,
    most: float,
    *,
    parse: Callable[[str], _Number],
    spell: Callable[[float], str] = "{:g}".format,
) -> Callable[[str], _Number]:
    """Return a reader of an option's value between two bounds, for argparse."""

    def read(word: str) -> _Number:
        bounds = f"write {spell(least)} to {spell(most)}"
        try:
            value = parse(word)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{printable(str(error), longest=200)}; {bounds}") from None
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{printable(word)} is out of range; {bounds}")
        return value

    return read
