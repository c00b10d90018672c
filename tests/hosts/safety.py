"""What a host can do to an FMU; each function runs in a process of its own."""

import gc
import math
import signal
import struct
import sys
import zlib
from collections.abc import Callable
from ctypes import c_void_p, pythonapi
from math import inf, nan
from pathlib import Path
from typing import Any

from fmpy.fmi1 import FMICallException

from tests.hosts.host import MESSAGES, Unit, in_subprocess

MISUSE = {
    "DriveMotor": {
        "doStep is not allowed before initialisation": lambda u: u.step(0.0, 0.1),
        "doStep is not allowed in initialisation mode": lambda u: (
            u.fmi.enterInitializationMode(),
            u.step(0.0, 0.1),
        ),
        "enterInitializationMode is not allowed in initialisation mode": lambda u: (
            u.fmi.enterInitializationMode(),
            u.fmi.enterInitializationMode(),
        ),
        "exitInitializationMode is not allowed before": lambda u: u.fmi.exitInitializationMode(),
        "setupExperiment is not allowed after": lambda u: u.start().fmi.setupExperiment(),
        "doStep is not allowed after terminate": lambda u: u.start().end().step(0.0, 0.1),
        "terminate is not allowed after terminate": lambda u: u.start().end().end(),
        "communication step = 0.0 s must be": lambda u: u.start().step(0.0, 0.0),
        "communication step = nan s must be": lambda u: u.start().step(0.0, nan),
        "communication point = nan s must be 0.0 s": lambda u: u.start().step(nan, 0.1),
        "communication point = 2.5 s must be 2.0 s": lambda u: u.start(2.0).step(2.5, 0.1),
        "communication point = 0.0 s must be 0.5 s": lambda u: (
            u.start().step(0.0, 0.5).step(0.0, 0.5)
        ),
        "start time = nan s must be a finite number": lambda u: u.start(nan),
        "w = inf rad/s must be a finite number": lambda u: u.start().set(w=inf),
        "input_hold = 1 cannot be set: fixed parameter, after init": lambda u: u.start().set(
            input_hold=1
        ),
        "tau = 0.1 N.m cannot be set: continuous output": lambda u: u.start().set(tau=0.1),
        "P = 1.0 W cannot be set: continuous output": lambda u: u.set(P=1.0),
        "value reference 13 is unknown": lambda u: u.fmi.getReal([13]),
        "value reference 4294967294 is unknown": lambda u: u.fmi.setReal([0xFFFFFFFE], [1.0]),
        "A is of type Real, not Integer": lambda u: u.fmi.getInteger([1]),
        "A is of type Real, not String": lambda u: u.fmi.getString([1]),
        "A is of type Real, not Boolean": lambda u: u.fmi.setBoolean([1], [True]),
        "characteristic is of type Enumeration, not Real": lambda u: u.fmi.getReal([0]),
        "tau = nan N.m must be a finite number; w = 1e+307 rad/s, tau = 8.0 N.m": lambda u: (
            u.start().set(w=1e307).step(0.0, 0.1)
        ),
        "P = -inf W must be a finite number": lambda u: (
            u.start().set(w=1e200).step(0.0, 0.1).outputs()
        ),
    },
    "CrankConveyor": {
        "rod.finite is of type Boolean, not Real": lambda u: u.fmi.getReal([3]),
        "crank.r = 0.5 m must be below rod.l = 0.4 m": lambda u: u.start(
            **{"crank.r": 0.5, "rod.l": 0.4, "rod.finite": True}
        ),
        "tau = 1e+308 N.m, phi = 0.0 rad, w = 40.0 rad/s": lambda u: (
            u.start().set(tau=1e308).step(0.0, 0.1)
        ),
    },
}


CARELESS: list[list[Any]] = [
    ["enterInitializationMode"],
    ["exitInitializationMode"],
    ["doStep", 0.0, 0.1],
    ["doStep", 0.1, 0.1],
    ["terminate"],
]


@in_subprocess
def misuse(fmu: str) -> dict[str, list[Any]]:
    """What follows every misuse of an FMU, by its reason."""
    return {reason: misuse_twice(fmu, act) for reason, act in MISUSE[Path(fmu).stem].items()}


def misuse_twice(fmu: str, act: Callable[[Unit], Any]) -> list[Any]:
    """Two failures, each followed by a host that does not look, a reset and a proper step."""
    paths, before = len(sys.path), living(fmu)
    refusals, plausible, recovered = set(), [], set()
    for _ in range(2):
        unit = Unit(fmu, "unit 7")
        refusals.add(unit.refusal(act))
        for call, *args in CARELESS:
            unit.refusal(lambda u, call=call, args=args: getattr(u.fmi, call)(*args))
            plausible += [value for value in unit.outputs() if not math.isnan(value)]
        unit.fmi.reset()
        recovered.add(str(unit.start().step(0.0, 0.1).outputs()))
        unit.refusal(act)
        unit.fmi.freeInstance()
    recovered.add(str(Unit(fmu).start().step(0.0, 0.1).outputs()))
    living_count = living(fmu) - before
    Unit(fmu).refusal(act)
    return [*refusals, plausible, len(recovered), living_count, len(sys.path) - paths]


def living(fmu: str) -> int:
    """How many instances of a Python FMU are in memory."""
    name = Path(fmu).stem
    return sum(type(referenced).__name__ == name for referenced in gc.get_objects())


@in_subprocess
def unusual(fmu: str) -> list[Any]:
    """The log, the outputs and the refusal of a conveyor with a long crank and a nasty name."""
    unit = Unit(fmu, "100%s%n%d").start(**{"crank.r": 0.15, "rod.l": 0.4}).step(0.0, 1e-3)
    return [*MESSAGES, unit.outputs(), unit.refusal(lambda u: u.step(0.0, 0.0))]


@in_subprocess
def foreign_state(fmu: str, other: str, damage: str) -> list[Any]:
    """Why a state is refused, what is read then, and whether rollback leads out of the failure."""
    unit, foreign = Unit(fmu, "unit 7").start().step(0.0, 0.5), Unit(other).start()
    good = unit.fmi.getFMUstate()
    content = unit.fmi.serializeFMUstate(good)
    damaged = {
        "another build": foreign.fmi.serializeFMUstate(foreign.fmi.getFMUstate()),
        "one bit": content[:99] + bytes([content[99] ^ 1]) + content[100:],
        "cut": content[:-1],
        "nothing": b"",
        "binary": bytes(range(256)),
        "deep": b"[" * 100_000,
        "forged": f'["{unit.description.guid}"]'.encode(),
    }[damage]
    assert damaged != content
    state = unit.fmi.deSerializeFMUstate(damaged)
    unit.fmi.serializeFMUstate(state)
    before = unit.outputs()
    refusal = unit.refusal(lambda u: u.fmi.setFMUstate(state))
    observed = unit.outputs()
    unit.fmi.setFMUstate(good)
    same = unit.outputs() == before
    unit.step(0.5, 0.5).fmi.freeFMUstate(state)
    unit.fmi.freeInstance()
    return [refusal, observed, same]


@in_subprocess
def crafted_states(fmu: str) -> list[int]:
    """Which doubles of a serialised state may be NaN, where the checksum is right."""
    unit = Unit(fmu).start().step(0.0, 0.5)
    content = unit.fmi.serializeFMUstate(unit.fmi.getFMUstate())
    first, last = content.index(b"\0") + 1, len(content) - 4
    accepted = []
    for offset in range(first, last, 8):
        body = content[:offset] + struct.pack("<d", math.nan) + content[offset + 8 : last]
        state = unit.fmi.deSerializeFMUstate(body + struct.pack("<I", zlib.crc32(body)))
        try:
            unit.fmi.setFMUstate(state)
            accepted.append((offset - first) // 8)
        except FMICallException:
            pass
        unit.fmi.freeFMUstate(state)
        unit.fmi.reset()
    return [(last - first) // 8, *accepted]


def thread_states() -> int:
    """How many threads CPython knows."""
    for name in ("PyInterpreterState_Get", "PyInterpreterState_ThreadHead", "PyThreadState_Next"):
        getattr(pythonapi, name).restype = c_void_p
    state = pythonapi.PyInterpreterState_ThreadHead(c_void_p(pythonapi.PyInterpreterState_Get()))
    count = 0
    while state:
        state = pythonapi.PyThreadState_Next(c_void_p(state))
        count += 1
    return count


@in_subprocess
def on_foreign_threads(fmu: str, masters: int, steps: int) -> list[Any]:
    """Torque after the steps of C++ masters, each with threads of its own, and Python's threads."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.FATAL)
    pairs = []
    for _ in range(masters):
        master = CosimExecution.from_step_size(step_size=1e6)
        index = master.add_local_slave(CosimLocalSlave(fmu_path=fmu, instance_name="motor"))
        observer = CosimObserver.create_last_value()
        master.add_observer(observer)
        master.real_initial_value(slave_index=index, variable_reference=8, value=39.0)
        master.step(step_count=steps)
        pairs.append((master, observer))
    return [[o.last_real_values(0, [9])[0] for _, o in pairs], thread_states()]


@in_subprocess
def interrupt(fmu: str) -> list[Any]:
    """What is logged when Ctrl-C arrives during a step of an hour, and a step after it."""
    unit = Unit(fmu, "unit 7").start()
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    refusal = unit.refusal(lambda u: u.step(0.0, 3600.0))
    unit.fmi.reset()
    return [refusal, unit.start().step(0.0, 0.1).outputs()]
