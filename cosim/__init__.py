"""Couple FMI 2.0 co-simulation FMUs: a system of parts and wires, and the error of its coupling."""

from .adaptive import Adaptive
from .algorithms import ALGORITHMS, ORDERS
from .certify import Certified, Estimate, certify, estimate, summary
from .container import write_container
from .damping import Diagnosis, diagnose
from .errors import Interrupted, SetupError, SimulationError
from .figures import (
    crossing,
    largest,
    mean,
    rms,
    smallest,
    time_of_largest,
    time_of_smallest,
)
from .isolated import run_isolated
from .master import run, versions
from .osp import write_osp
from .part import quiet
from .result import Result
from .ssp import Package, read_ssp, write_ssp
from .system import System

__all__ = [
    "ALGORITHMS",
    "ORDERS",
    "Adaptive",
    "Certified",
    "Diagnosis",
    "Estimate",
    "Interrupted",
    "Package",
    "Result",
    "SetupError",
    "SimulationError",
    "System",
    "certify",
    "crossing",
    "diagnose",
    "estimate",
    "largest",
    "mean",
    "quiet",
    "read_ssp",
    "rms",
    "run",
    "run_isolated",
    "smallest",
    "summary",
    "time_of_largest",
    "time_of_smallest",
    "versions",
    "write_container",
    "write_osp",
    "write_ssp",
]
