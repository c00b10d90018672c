"""Couple FMI 2.0 co-simulation FMUs: a system of parts and wires, and the error of its coupling."""

from .engine.adaptive import Adaptive
from .engine.algorithms import ALGORITHMS, ORDERS
from .engine.part import quiet
from .errors import SetupError
from .figures import (
    crossing,
    largest,
    mean,
    rms,
    smallest,
    time_of_largest,
    time_of_smallest,
)
from .formats.container import write_container
from .formats.osp import read_osp, write_osp
from .formats.ssp import Package, read_ssp, write_ssp
from .inputs import Table
from .judge.certify import Certified, Estimate, certify, estimate, summary
from .judge.diagnose import Diagnosis, diagnose
from .judge.isolated import run_isolated
from .judge.linearize import Linear, linearize
from .judge.oracle import Judged, oracle, true_errors
from .master import run, versions
from .result import Interrupted, Result, SimulationError
from .system import System, Wire

__version__ = "0.1.0"

__all__ = [
    "ALGORITHMS",
    "ORDERS",
    "Adaptive",
    "Certified",
    "Diagnosis",
    "Estimate",
    "Interrupted",
    "Judged",
    "Linear",
    "Package",
    "Result",
    "SetupError",
    "SimulationError",
    "System",
    "Table",
    "Wire",
    "certify",
    "crossing",
    "diagnose",
    "estimate",
    "largest",
    "linearize",
    "mean",
    "oracle",
    "quiet",
    "read_osp",
    "read_ssp",
    "rms",
    "run",
    "run_isolated",
    "smallest",
    "summary",
    "time_of_largest",
    "time_of_smallest",
    "true_errors",
    "versions",
    "write_container",
    "write_osp",
    "write_ssp",
]
