"""Couple FMI 2.0 co-simulation FMUs: a system of parts and wires, and the error of its coupling."""

from .adaptive import Adaptive
from .algorithms import ALGORITHMS, ORDERS
from .certify import Certified, Estimate, certify, estimate, summary
from .container import write_container
from .damping import Diagnosis, diagnose
from .errors import Interrupted, SetupError, SimulationError
from .isolated import run_isolated
from .master import run, versions
from .osp import write_osp
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
    "diagnose",
    "estimate",
    "read_ssp",
    "run",
    "run_isolated",
    "summary",
    "versions",
    "write_container",
    "write_osp",
    "write_ssp",
]
