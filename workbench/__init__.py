"""A question becomes an answer: figures with their errors, tables, pictures, a page, studies.

Matrices are small here, so BLAS threads cost more than they gain: there is one, unless the environment
says otherwise or NumPy is already loaded.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .answer import Answer, Findings, Show, Table
    from .charts.model import Chart, Curve, Mark, Panel
    from .context import Context
    from .figure import Figure
    from .judgement import Judgement
    from .live import Number, Reader, RunChart, RunPanel, Slider
    from .options import Options, RunOptions, option
    from .question import Question

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
for variable in THREADS:
    os.environ.setdefault(variable, "1")

HOMES = {
    "Answer": "answer", "Show": "answer", "Table": "answer", "Context": "context", "Findings": "answer",
    "Figure": "figure", "Judgement": "judgement", "Options": "options", "RunOptions": "options", "option": "options",
    "Chart": "charts.model", "Curve": "charts.model", "Mark": "charts.model",
    "Question": "question",
    "Panel": "charts.model", "Number": "live", "Reader": "live", "RunChart": "live", "RunPanel": "live", "Slider": "live",
}  # fmt: skip
__all__ = [
    "Answer", "Chart", "Context", "Curve", "Figure", "Findings", "Judgement", "Mark", "Number", "Options", "Panel", "Question",
    "Reader", "RunChart", "RunOptions", "RunPanel", "Show", "Slider", "Table", "option",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load what is requested, so that a process that only does runs need not load everything."""
    if name in HOMES:
        return getattr(import_module(f"{__name__}.{HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
