"""A matplotlib figure that shows itself in a notebook, whatever backend is set there."""

from __future__ import annotations

from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from .files import replacement

#: Dots per inch of a picture in a notebook: a convention, that of matplotlib.
NOTEBOOK_DPI = 100


class Picture(Figure):
    """A figure that is shown where it is the last value of a notebook's cell."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure as Matplotlib does, a file in place of an old one and not through a link."""
        if isinstance(fname, str | PathLike) and Path(fname).suffix:
            with replacement(Path(fname)) as fresh:
                super().savefig(fresh, **options)
        else:
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        """The picture as PNG, which notebooks ask for."""
        png = BytesIO()
        self.savefig(png, format="png", dpi=NOTEBOOK_DPI)
        return png.getvalue()
