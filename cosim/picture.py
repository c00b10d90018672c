"""A matplotlib figure that shows itself in a notebook, whatever backend is set there."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

#: Dots per inch of a picture in a notebook: a convention, that of matplotlib.
NOTEBOOK_DPI = 100


class Picture(Figure):
    """A figure that is shown where it is the last value of a notebook's cell."""

    def _repr_png_(self) -> bytes:
        """The picture as PNG, which notebooks ask for."""
        png = BytesIO()
        self.savefig(png, format="png", dpi=NOTEBOOK_DPI)
        return png.getvalue()
