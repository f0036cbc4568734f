"""The picture of a benchmark, drawn with matplotlib without a display."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def picture(path: Path, *grid: int, dpi: int = 110, **options: Any) -> Iterator[tuple[Any, Any]]:
    """Yield a figure and its axes, as ``subplots`` of matplotlib returns them; then write the PNG and print its path.

    Parameters
    ----------
    grid : rows and columns of axes
    options : of ``subplots``
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(*grid, **{"layout": "constrained", **options})
    yield figure, axes
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    print(path)
