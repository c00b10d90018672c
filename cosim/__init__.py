"""Couple co-simulation FMUs of FMI 2.0 and 3.0: systems of parts and wires, and their coupling errors."""

from importlib import import_module
from typing import TYPE_CHECKING

from .accuracy.certify import Certified, certify, summary
from .accuracy.estimate import Estimate
from .accuracy.limit import Limit, limit
from .accuracy.referee import RefereeReport, referee
from .accuracy.reference import Judged, oracle, true_errors
from .analysis.compare import Comparison, Deviation, compare
from .analysis.crosscheck import crosscheck
from .analysis.crosscheck.checks import Verdict
from .analysis.crosscheck.report import Crosscheck
from .analysis.linearize import Linear, linearize
from .engine.algorithms import ALGORITHMS, CONVERGENCE_ORDERS
from .engine.control import Adaptive
from .errors import SetupError
from .fmu.messages import quiet
from .formats.container import write_container
from .formats.osp import read_osp, write_osp
from .formats.ssp.read import Package, read_ssp
from .formats.ssp.write import write_ssp
from .isolated import run_isolated
from .master import run, versions
from .metrics import crossing, largest, mean, rms, smallest, time_of_largest, time_of_smallest
from .result import Interrupted, Result, SimulationError
from .system import System, Wire
from .system.inputs import Table

if TYPE_CHECKING:
    from .analysis.damping import Diagnosis, diagnose
    from .identification.design import Advice, Experiment, advise
    from .identification.identify import Identified, identify
    from .identification.intervals import Interval
    from .identification.record import measured

__version__ = "1.0.0rc1"

#: the modules whose parts of SciPy take longer to import than most runs, loaded on request
HOMES = {
    "Advice": "identification.design", "Experiment": "identification.design", "advise": "identification.design",
    "Diagnosis": "analysis.damping", "diagnose": "analysis.damping",
    "Identified": "identification.identify", "Interval": "identification.intervals",
    "identify": "identification.identify", "measured": "identification.record",
}  # fmt: skip

__all__ = [
    "ALGORITHMS", "CONVERGENCE_ORDERS", "Adaptive", "Advice", "Certified", "Comparison", "Crosscheck",
    "Deviation", "Diagnosis", "Estimate", "Experiment", "Identified", "Interrupted", "Interval",
    "Judged", "Limit", "Linear", "Package", "RefereeReport", "Result", "SetupError", "SimulationError", "System", "Table",
    "Verdict", "Wire", "advise", "certify", "compare", "crosscheck", "crossing", "diagnose",
    "identify", "largest", "limit", "linearize", "mean", "measured", "oracle", "quiet",
    "read_osp", "read_ssp", "referee", "rms", "run", "run_isolated", "smallest", "summary",
    "time_of_largest", "time_of_smallest", "true_errors", "versions", "write_container",
    "write_osp", "write_ssp",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Load a name of `HOMES` from its module."""
    if name in HOMES:
        return getattr(import_module(f"{__name__}.{HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
