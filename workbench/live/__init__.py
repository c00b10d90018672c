"""The live part of a page: sliders, and the FMUs' own C code run again in the browser at every move.

The method `live` of a question returns a `Live`. Nothing of its Python runs in the browser: what is live are sliders, formulas, readers, curves, a motion and a sweep.
"""

from ..answer import LivePart
from .build import of
from .declare import (
    REVOLUTION,
    Caption,
    Coordinate,
    Formulas,
    Live,
    LiveMotion,
    LiveRun,
    LiveSweep,
    Number,
    Reader,
    RunChart,
    RunPanel,
    Slider,
    Steady,
)  # fmt: skip
from .still import drawn, moved

__all__ = [
    "REVOLUTION", "Caption", "Coordinate", "Formulas", "Live", "LiveMotion", "LivePart",
    "LiveRun", "LiveSweep", "Number", "Reader", "RunChart", "RunPanel", "Slider", "Steady", "drawn", "moved", "of",
]  # fmt: skip
