"""Standard output as rich writes to it: a terminal has colours and a size, a pipe neither."""

from __future__ import annotations

import shutil
import sys
from typing import TYPE_CHECKING

from rich.console import Console

from arpd.cli.columns import WITHOUT_END

if TYPE_CHECKING:
    from rich.console import RenderableType


def show(shown: RenderableType) -> None:
    """Print to standard output, no line wider than a terminal, or than COLUMNS says."""
    width, height = shutil.get_terminal_size((WITHOUT_END, WITHOUT_END))
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr] # a terminal may lack a character
    console = Console(width=width, height=height, highlight=False)
    with console.capture() as drawn:
        console.print(shown)
    print("\n".join(line.rstrip() for line in drawn.get().splitlines()))
