"""`--plot` of every command: a PNG by matplotlib, where that is installed."""

from __future__ import annotations

from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING

from arpd.model.errors import ArpdError, UsageError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


def refuse_all_but_png(path: Path) -> None:
    """Raise ``UsageError`` when the name of a picture does not end in .png."""
    if path.suffix.lower() != ".png":
        raise UsageError(f"--plot {printable(str(path))} is not a PNG; write a name that ends in .png")


def drawing(module: str, name: str) -> Callable[..., None]:
    """Import a drawing function; called before any work, so that a missing library wastes none.

    Raises
    ------
    ArpdError
        If matplotlib is not installed.
    """
    try:
        draw: Callable[..., None] = getattr(import_module(module), name)
    except ImportError as error:
        raise ArpdError(f"--plot needs matplotlib ({error}); install it with pip install 'arpd[plot]'") from error
    return draw


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a fault of writing into an error that names the option."""
    try:
        yield
    except OSError as error:
        raise ArpdError(f"--plot {path} cannot be written ({error.strerror}); name another file") from None
