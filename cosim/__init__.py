"""Couple co-simulation FMUs of FMI 2.0 and 3.0: systems of parts and wires, and their coupling errors."""

from difflib import get_close_matches
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .accuracy.certify import Certified, certify, summary
    from .accuracy.coupled_ode import CoupledOde
    from .accuracy.estimate import Estimate
    from .accuracy.limit import Limit, limit
    from .accuracy.referee import RefereeReport, referee
    from .accuracy.reference import Judged, oracle, true_errors
    from .analysis.compare import Comparison, Deviation, compare
    from .analysis.crosscheck import crosscheck
    from .analysis.crosscheck.checks import CheckResult
    from .analysis.crosscheck.report import Crosscheck
    from .analysis.damping import Diagnosis, diagnose
    from .analysis.linearize import Linear, linearize
    from .engine.algorithms import ALGORITHMS, CONVERGENCE_ORDERS
    from .engine.control import Adaptive
    from .engine.settings import RunSettings
    from .engine.snapshot import SystemState
    from .ensemble import Case, Ensemble
    from .errors import FmuError, SetupError
    from .fmu.messages import quiet
    from .fmu.reference_rows import ReferenceRows
    from .formats.container import write_container
    from .formats.osp import read_osp, write_osp
    from .formats.ssp.read import Package, read_ssp
    from .formats.ssp.write import write_ssp
    from .identification.design import Advice, Experiment, advise
    from .identification.identify import Identified, identify
    from .identification.intervals import Interval
    from .identification.record import measured
    from .isolated import run_isolated
    from .master import run
    from .metrics import crossing, largest, mean, rms, smallest, time_of_largest, time_of_smallest
    from .prepared import How, Paused, Prepared
    from .result import Interrupted, Result, SimulationError
    from .scoreboards import scoreboard
    from .series import Column, Kind, Series
    from .simulation import versions
    from .standings import Scoreboard, Standing
    from .sweeps import combinations, sample, sweep
    from .system import Network, Port, System, Wire, connect, conversion_to

__version__ = "1.0.0"

#: The module of each public name, imported when the name is first asked for: NumPy and SciPy take longer than most runs.
_HOMES = {
    name: module
    for module, names in {
        "accuracy.certify": "Certified, certify, summary",
        "accuracy.coupled_ode": "CoupledOde",
        "accuracy.estimate": "Estimate",
        "accuracy.limit": "Limit, limit",
        "accuracy.referee": "RefereeReport, referee",
        "accuracy.reference": "Judged, oracle, true_errors",
        "analysis.compare": "Comparison, Deviation, compare",
        "analysis.crosscheck": "crosscheck",
        "analysis.crosscheck.checks": "CheckResult",
        "analysis.crosscheck.report": "Crosscheck",
        "analysis.damping": "Diagnosis, diagnose",
        "analysis.linearize": "Linear, linearize",
        "engine.algorithms": "ALGORITHMS, CONVERGENCE_ORDERS",
        "engine.control": "Adaptive",
        "engine.settings": "RunSettings",
        "engine.snapshot": "SystemState",
        "ensemble": "Case, Ensemble",
        "errors": "FmuError, SetupError",
        "fmu.messages": "quiet",
        "fmu.reference_rows": "ReferenceRows",
        "formats.container": "write_container",
        "formats.osp": "read_osp, write_osp",
        "formats.ssp.read": "Package, read_ssp",
        "formats.ssp.write": "write_ssp",
        "identification.design": "Advice, Experiment, advise",
        "identification.identify": "Identified, identify",
        "identification.intervals": "Interval",
        "identification.record": "measured",
        "isolated": "run_isolated",
        "master": "run",
        "metrics": "crossing, largest, mean, rms, smallest, time_of_largest, time_of_smallest",
        "prepared": "How, Paused, Prepared",
        "result": "Interrupted, Result, SimulationError",
        "simulation": "versions",
        "scoreboards": "scoreboard",
        "standings": "Scoreboard, Standing",
        "sweeps": "combinations, sample, sweep",
        "series": "Column, Kind, Series",
        "system": "Network, Port, System, Wire, connect, conversion_to",
    }.items()
    for name in names.split(", ")
}

__all__ = [
    "ALGORITHMS",
    "CONVERGENCE_ORDERS",
    "Adaptive",
    "Advice",
    "Case",
    "Certified",
    "CheckResult",
    "Column",
    "Comparison",
    "CoupledOde",
    "Crosscheck",
    "Deviation",
    "Diagnosis",
    "Ensemble",
    "Estimate",
    "Experiment",
    "FmuError",
    "How",
    "Identified",
    "Interrupted",
    "Interval",
    "Judged",
    "Kind",
    "Limit",
    "Linear",
    "Network",
    "Package",
    "Paused",
    "Port",
    "Prepared",
    "RefereeReport",
    "ReferenceRows",
    "Result",
    "RunSettings",
    "Scoreboard",
    "Series",
    "SetupError",
    "SimulationError",
    "Standing",
    "System",
    "SystemState",
    "Wire",
    "advise",
    "certify",
    "combinations",
    "compare",
    "connect",
    "conversion_to",
    "crosscheck",
    "crossing",
    "diagnose",
    "identify",
    "largest",
    "limit",
    "linearize",
    "mean",
    "measured",
    "oracle",
    "quiet",
    "read_osp",
    "read_ssp",
    "referee",
    "rms",
    "run",
    "run_isolated",
    "sample",
    "scoreboard",
    "smallest",
    "summary",
    "sweep",
    "time_of_largest",
    "time_of_smallest",
    "true_errors",
    "versions",
    "write_container",
    "write_osp",
    "write_ssp",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Load a public name from its module, or a module."""
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _HOMES:
        value = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return value
    try:
        return import_module(f"{__name__}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{__name__}.{name}":
            raise
    near = get_close_matches(name, __all__, 1)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return [*__all__, "__version__"]
