"""A matplotlib figure that shows itself in a notebook, whatever backend is set there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .files import replacement

#: Dots per inch of a picture in a notebook: a convention, that of matplotlib.
NOTEBOOK_DPI = 100


#: Width of a picture of results, height of what is around its panels, and of a panel [inch]: conventions.
WIDTH, FRAME_HEIGHT, PANEL_HEIGHT = 9.0, 1.1, 2.2
#: Dots per inch of a picture in a file: a convention of printers, halved.
FILE_DPI = 150


class Picture(Figure):
    """A figure that is shown where it is the last value of a notebook's cell."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure as Matplotlib does, a file in place of an old one and not through a link."""
        if isinstance(fname, str | PathLike) and Path(fname).suffix:
            with replacement(Path(fname)) as fresh:
                super().savefig(fresh, **options)
        else:
            super().savefig(fname, **options)

    def write(self, path: Any) -> None:
        """Write a file, unless the path is None."""
        if path is not None:
            self.savefig(path, dpi=FILE_DPI)

    def _repr_png_(self) -> bytes:
        """The picture as PNG, which notebooks ask for."""
        png = BytesIO()
        self.savefig(png, format="png", dpi=NOTEBOOK_DPI)
        return png.getvalue()


def panels(over_time: Sequence[tuple[str, Callable[[Axes], None]]], path: Any = None) -> Picture:
    """A panel over time for each pair of a unit and what draws its curves, with a legend; a `path` is written, too."""
    number = max(1, len(over_time))
    figure = Picture(figsize=(WIDTH, FRAME_HEIGHT + PANEL_HEIGHT * number), layout="constrained")
    axes = figure.subplots(number, sharex=True, squeeze=False)[:, 0]
    for axis, (unit, draw) in zip(axes, over_time):
        draw(axis)
        axis.set_ylabel(unit or "1")
        axis.grid(alpha=0.3)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    axes[-1].set_xlabel("time / s")
    figure.write(path)
    return figure
