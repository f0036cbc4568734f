"""What a command is, and the options that several have: configuration, the daemon's address, numbers within bounds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar
from urllib.parse import urlsplit

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
    """Add ``--config``, by default the installed file, and what stands for that where it may be missing."""
    about = f"YAML configuration (default {DEFAULT_CONFIG}{otherwise and ', or ' + otherwise})"
    parser.add_argument("--config", type=Path, metavar="FILE", default=DEFAULT_CONFIG, help=about)


def config_of(options: argparse.Namespace) -> Path | None:
    """Return the file of ``--config``, None where the installed one is missing and nobody named another."""
    config: Path = options.config
    return None if config is DEFAULT_CONFIG and is_missing(config) else config  # the same path given is another object


def is_missing(path: Path) -> bool:
    """Return whether there is no such file; one in a folder that is closed to this user may be there."""
    try:
        path.stat()
    except OSError as error:
        return isinstance(error, FileNotFoundError | NotADirectoryError)
    return False


def add_json(parser: argparse.ArgumentParser, about: str = "print JSON") -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help=about)


def add_address(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the daemon."""
    about = "base URL of the daemon (default %(default)s)"
    parser.add_argument("--url", type=read_address, default=DEFAULT_URL, metavar="URL", help=about)
    parser.add_argument(
        "--cacert", type=Path, metavar="FILE", help="CA of the daemon's certificate (default: the system's)"
    )
    parser.add_argument("--user", metavar="NAME", default="", help=f"log in; the password is taken from ${PASSWORD}")
    parser.add_argument(
        IN_CLEAR, action="store_true", help="with --user over http://: whoever hears the link may read the password"
    )


class Address(NamedTuple):
    """Address of a daemon: as given, the computer, and the base URL."""

    url: str
    host: str
    base: str

    @property
    def is_here(self) -> bool:
        """Whether it names this computer."""
        from arpd.host.kernel import is_own_address

        return self.host in {"localhost", "::1"} or is_own_address(self.host)


def read_address(url: str) -> Address:
    """Return the address that a URL names, for argparse."""
    try:
        parts = urlsplit(url)
        if parts.username is not None:  # not shown: a password may follow
            raise argparse.ArgumentTypeError("a user does not stand in the address; give --user NAME")
        if parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0:
            base = f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}"
            return Address(url, parts.hostname, base)
        why = "it needs http:// or https://, and a host"
    except ValueError as error:
        why = str(error)
    raise argparse.ArgumentTypeError(f"{printable(url)} is no HTTP address ({why}); write it like {DEFAULT_URL}")


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
