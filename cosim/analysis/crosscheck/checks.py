"""What an FMU for co-simulation promises and whether it keeps it, one check for each promise.

Every check runs instances of the FMU by calls that the standard allows, and compares their values.
Clauses are those of FMI 2.0.4 and 3.0.2.
"""

from __future__ import annotations

import gc
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import cached_property
from itertools import chain, count, pairwise
from mmap import PAGESIZE
from pathlib import Path
from typing import NamedTuple, TypeVar

from fmpy.validation import validate_fmu

from ...engine.initialise import open_cosimulation
from ...errors import FmuError, SimulationTerminated, StepDiscarded
from ...fmu.instance import CoSimulation
from ...fmu.library import borrow
from ...fmu.messages import DISCARD, STATUS, WARNING
from ...system import (
    Port,
    Value,
    declared_start,
    describe_fmu,
    enumeration,
    is_continuous_input,
    require_cosimulation,
)
from ...system.description import ModelDescription, Variable
from .process import forked

STEPS, LONG = 60, 10_000
SHAKE, NUDGE = 0.05, 0.01
LEAK = 64 * 1024  # of resident memory, that so many steps may take [bytes]
AGREES, NOISE, ROUNDING = 0.01, 1e-7, 1e-12
#: Instances that are made and freed to see what they leave in memory, and the share of them before the
#: first measurement: a convention.
LIVES, EARLY_LIVES = 60, 0.4
#: Resident memory that an instance may leave [bytes]: a quarter of a page of 64 KiB. Measured on the
#: project's own FMUs, instances leave less than 2 KiB.
LEFT = 16 * 1024
LONGER = (1, 8, 64)
MOST_KNOWNS, MOST_INPUTS = 60, 20
PASSED, FAILED, NOT_OFFERED, NOT_RUN = "passed", "failed", "not offered", "not run"
STANDARD = {"2.0": "FMI 2.0.4", "3.0": "FMI 3.0.2"}
RENAMED = {
    "canGetAndSetFMUstate": "canGetAndSetFMUState",
    "canSerializeFMUstate": "canSerializeFMUState",
    "providesDirectionalDerivative": "providesDirectionalDerivatives",
}


class Verdict(NamedTuple):
    """A check, the clause it is based on, how it ended, what was found, and how to repeat it by hand."""

    check: str
    clause: str
    status: str
    said: str
    again: str


class Broken(Exception):
    """A promise that is not kept: what was found, and after which calls."""


class NotOffered(Exception):
    """The FMU does not promise this."""


Row = tuple[Value, ...]
Answer = TypeVar("Answer")


class Subject:
    """An FMU under test: its description, how it is excited and over which steps."""

    def __init__(self, path: Path, step: float | None = None) -> None:
        self.path = path
        self.description: ModelDescription = describe_fmu("fmu", path)
        require_cosimulation({"fmu": self.description}, {"fmu": path})
        self.third = self.description.fmiVersion == "3.0"
        self.can = self.description.interface("coSimulation")
        variables = self.description.modelVariables
        self.inputs = [v for v in variables if is_continuous_input(Port("fmu", v))]
        self.shown = [
            v for v in variables if v.causality in ("output", "local") and v.type != "Clock"
        ]
        self.outputs = [v for v in self.shown if v.causality == "output"]
        experiment = self.description.defaultExperiment
        self.start = experiment.start or 0.0
        self.stop = self.start + 1.0 if experiment.stop is None else experiment.stop
        self.h = step or experiment.step or abs(self.stop - self.start) / 100 or 0.01
        self.tolerance = experiment.tolerance
        self.once = bool(self.can.canBeInstantiatedOnlyOncePerProcess)
        self.shaken = True
        self._numbers = count(1)

    @contextmanager
    def instance(self) -> Iterator[CoSimulation]:
        """A new instance, which is terminated and freed."""
        part = open_cosimulation(
            f"instance_{next(self._numbers)}", self.description, borrow(self.path, self.description)
        )
        try:
            yield part
        finally:
            part.session.close()

    def in_process(self, work: Callable[[], Answer]) -> Answer:
        """What `work` returns, which makes an instance. If the FMU allows one instance per process, it is
        done in a process of its own, where the system can copy processes.
        """
        return forked(work) if self.once and hasattr(os, "fork") else work()

    @contextmanager
    def running(self, number: int = 0) -> Iterator[CoSimulation]:
        """A new instance after so many steps."""
        with self.instance() as part:
            self.initialise(part)
            self.go(part, 0, number)
            yield part

    def initialise(self, part: CoSimulation) -> None:
        """From instantiated to the first step."""
        self.enter(part)
        self.steer(part, self.inputs_at(0))
        part.begin()

    def enter(self, part: CoSimulation) -> None:
        """Into initialisation mode, with the tolerance that the FMU states and without a stop time."""
        part.set_up(self.tolerance, self.start, None)

    @staticmethod
    def size(v: Variable) -> float:
        """What is much for a variable."""
        return abs(float(declared_start(v) or 0.0)) or abs(float(v.nominal or 0.0)) or 1.0

    def inputs_at(self, k: int) -> list[float]:
        """The Real inputs at step k."""
        wide = [SHAKE * self.size(v) * self.shaken for v in self.inputs]
        return [
            bounded(v, float(declared_start(v) or 0.0) + w * math.sin(0.37 * (j + 1) * k + j))
            for j, (v, w) in enumerate(zip(self.inputs, wide))
        ]

    def steer(self, part: CoSimulation, u: Sequence[float]) -> None:
        """Set the Real inputs."""
        for v, value in zip(self.inputs, u):
            part.set(v, value)

    def go(self, part: CoSimulation, first: int, last: int) -> list[Row]:
        """The rows after the steps from number `first` to `last`, each with the inputs of its step."""
        rows = []
        for k in range(first, last):
            self.steer(part, self.inputs_at(k))
            part.advance(self.start + k * self.h, self.h)
            rows.append(self.row(part))
        return rows

    def row(self, part: CoSimulation) -> Row:
        """What the FMU shows now."""
        return tuple(part.access.values(self.shown).values())

    @cached_property
    def steps(self) -> int:
        """How many steps it takes as it is excited, at most STEPS; raises FmuError if none."""
        for self.shaken in (True, False):
            taken, failure = self.in_process(self._taken)
            if failure is None or taken > STEPS // 2 or (not self.shaken and taken > 3):
                return taken
            if not self.shaken:
                raise failure
        raise AssertionError

    def _taken(self) -> tuple[int, FmuError | None]:
        """How many of STEPS steps a new instance takes, and why not more."""
        taken = 0
        try:
            with self.running() as part:
                for taken in range(STEPS):
                    self.go(part, taken, taken + 1)
                return STEPS, None
        except FmuError as failure:
            return taken, failure

    def rows(self) -> list[Row]:
        """What a new instance shows after each step."""
        number = self.steps  # found with instances of its own

        def work() -> list[Row]:
            with self.running() as part:
                return self.go(part, 0, number)

        return self.in_process(work)

    @cached_property
    def reference(self) -> list[Row]:
        """The rows of the first instance."""
        return self.rows()

    @cached_property
    def second_rows(self) -> list[Row]:
        """The rows of a second instance."""
        return self.rows()

    @cached_property
    def unsteady(self) -> frozenset[str]:
        """The variables in which the second instance differs, such as a processor time."""
        with suppress(FmuError):
            return frozenset(
                v.name
                for ours, theirs in zip(self.second_rows, self.reference)
                for v, x, y in zip(self.shown, ours, theirs)
                if differ(x, y)
            )
        return frozenset()

    def how(self) -> str:
        """Over which steps and with which inputs it is run."""
        told = f"steps of h = {self.h:g} s from {self.start:g} s"
        excited = f"start + {SHAKE:g} size sin(0.37 (j + 1) k + j)"
        return f"{told}; Real inputs j = 0, 1, ... in step k: {excited}" if self.inputs else told

    def same(self, rows: Sequence[Row], wanted: Sequence[Row], what: str, first: int = 0) -> None:
        """Raise Broken at the first value that differs in a bit; `first` is the number of the first row.

        What does not repeat in a second instance, which has a check of its own, is left out.
        """
        for k, (row, other) in enumerate(zip(rows, wanted), first + 1):
            for v, ours, theirs in zip(self.shown, row, other):
                if differ(ours, theirs) and v.name not in self.unsteady:
                    raise Broken(f"{v.name} after step {k} is {ours!r} {what}, not {theirs!r}")

    def needs(self, ability: str) -> None:
        """Raise NotOffered without a capability flag."""
        if not getattr(self.can, ability):
            raise NotOffered(f"{RENAMED.get(ability, ability) if self.third else ability} is false")

    def known(self, v: Variable) -> bool:
        """Whether a variable may be set while initialising."""
        exact: bool = v.initial == "exact" and v.variability != "constant"
        return exact or v.causality == "input"

    def after(self, n: int, u: Sequence[float], sizes: Sequence[float]) -> dict[str, float]:
        """The Real outputs of a new instance after n steps and some of these sizes [s] with inputs u."""

        def work() -> dict[str, float]:
            with self.running(n) as part:
                t = self.start + n * self.h
                for h in sizes:
                    self.steer(part, u)
                    part.advance(t, h)
                    t += h
                return reals(part, [v for v in self.outputs if smooth(v)])

        return self.in_process(work)

    def slopes(
        self, n: int, u: Sequence[float], j: int, h: float, share: float
    ) -> dict[str, tuple[float, float]]:
        """Of the Real outputs by input j, above and below its value, after n steps and one of h [s]."""
        wide = share * self.size(self.inputs[j])
        up, middle, down = (
            self.after(n, [*u[:j], u[j] + off, *u[j + 1 :]], [h]) for off in (wide, 0.0, -wide)
        )
        return {x: ((up[x] - middle[x]) / wide, (middle[x] - down[x]) / wide) for x in up}

    @cached_property
    def ranges(self) -> dict[str, float]:
        """How far each Real output that repeats moves, or its size if it does not move."""
        spans = {}
        for v, column in zip(self.shown, zip(*self.reference)):
            if smooth(v) and v.causality == "output" and v.name not in self.unsteady:
                spans[v.name] = max(column) - min(column) or max(map(abs, column)) or 1.0
        return spans


def differ(a: Value, b: Value) -> bool:
    """Whether two values differ; two that are not a number do not."""
    return a != b and (a == a or b == b)  # noqa: PLR0124


def smooth(v: Variable) -> bool:
    """Whether it is a Real whose digits are enough for differences."""
    return bool(v.type == "Real" and v.native != "Float32")


def reals(part: CoSimulation, variables: Sequence[Variable]) -> dict[str, float]:
    """The values of Real variables."""
    return {name: float(value) for name, value in part.access.values(variables).items()}


def bounded(v: Variable, value: float) -> float:
    """The nearest value that a variable may have."""
    low = -math.inf if v.min is None else float(v.min)
    high = math.inf if v.max is None else float(v.max)
    return min(max(value, low), high)


def nudged(v: Variable, share: float = NUDGE) -> Value | None:
    """Another value that a variable may have, near its start; None for a text, or where there is none."""
    own = declared_start(v)
    if v.type == "Boolean":
        return not own
    if v.type == "Enumeration":
        return next((x for x in enumeration(v).values() if x != own), None)
    if v.type not in ("Real", "Integer"):
        return None
    value = float(own or 0.0)
    wide = share * Subject.size(v) if v.type == "Real" else 1.0
    for other in (bounded(v, value + wide), bounded(v, value - wide)):
        if other != value:
            return other if v.type == "Real" else round(other)
    return None


def description(s: Subject) -> str:
    """The XML schema, and what FMPy looks for beyond it."""
    if problems := validate_fmu(str(s.path)):
        raise Broken("; ".join(" ".join(problem.split()) for problem in problems[:3]))
    return f"{len(s.description.modelVariables)} variables; FMPy reports no problem"


def binary(s: Subject) -> str:
    """What the binary says of itself."""
    with s.instance() as part:
        told = part.session.binding.getVersion()
        platform = "default" if s.third else part.session.binding.getTypesPlatform()
    version = s.description.fmiVersion
    if (platform, told.partition("-")[0]) != ("default", version):
        found = f"types platform {platform!r} and version {told!r}"
        raise Broken(f"{found}, not 'default' and {version!r}")
    return f"version {told}" if s.third else f"version {told}, types platform {platform}"


def runs(s: Subject) -> str:
    """All outputs are finite numbers."""
    for k, row in enumerate(s.reference, 1):
        for v, value in zip(s.shown, row):
            if v.causality == "output" and isinstance(value, float) and not math.isfinite(value):
                raise Broken(f"{v.name} after step {k} is {value!r}")
    shaken = "" if s.shaken or not s.inputs else "; its inputs had to be kept constant"
    return f"{s.steps} steps of {s.h:g} s{shaken}"


def starts(s: Subject) -> str:
    """Exact outputs while initialising, and parameters after it; an FMU may round them."""
    exact = [
        v for v in s.description.modelVariables if v.initial == "exact" and v.start is not None
    ]
    shown = [v for v in exact if v.causality == "output"]
    parameters = [v for v in exact if v.causality == "parameter"]
    with s.instance() as part:
        s.enter(part)
        found = part.access.values(shown)
        part.begin()
        found |= part.access.values(parameters)
    for v in [*shown, *parameters]:
        value, own = found[v.name], declared_start(v)
        match value, own:
            case float(), float() if math.isclose(value, own, rel_tol=ROUNDING):
                continue
        if value != own:
            raise Broken(f"{v.name} is {value!r}, not {own!r}")
    return f"{len(found)} start values"


def terminates(s: Subject) -> str:
    """The last values remain after termination."""
    with s.running(s.steps - 1) as part:
        last = s.go(part, s.steps - 1, s.steps)
        part.session.terminate()
        s.same([s.row(part)], last, "after it is terminated", s.steps - 1)
    return "the last values stay"


def repeats(s: Subject) -> str:
    """A second instance gives the rows of the first."""
    for k, (row, other) in enumerate(zip(s.second_rows, s.reference), 1):
        for v, ours, theirs in zip(s.shown, row, other):
            if differ(ours, theirs):
                raise Broken(
                    f"{v.name} after step {k} is {ours!r} in a new instance, not {theirs!r}; "
                    f"the other checks leave out {', '.join(sorted(s.unsteady))}"
                )
    return f"{s.steps} rows of {len(s.shown)} variables, bit for bit"


def looks(s: Subject) -> str:
    """Getting values again, in the opposite order or one at a time, does not change them."""
    with s.running() as part:
        rows: list[Row] = []
        for k in range(s.steps):
            rows += s.go(part, k, k + 1)
            s.same([s.row(part)], rows[-1:], "when it is got again", k)
            if k in (0, s.steps // 2, s.steps - 1):
                back = tuple(part.access.values(s.shown[::-1]).values())[::-1]
                s.same([back], rows[-1:], "when the values are got in the opposite order", k)
                single = tuple(part.access.values([v])[v.name] for v in s.shown)
                s.same([single], rows[-1:], "when it is got alone", k)
    s.same(rows, s.reference, "where values are got twice")
    return f"{s.steps} rows got twice, three of them in the opposite order and one value at a time"


def resets(s: Subject) -> str:
    """A reset after a run with other parameters, if it runs with them."""
    others = [v for v in s.description.modelVariables if v.causality == "parameter"]
    values = {v: nudged(v) for v in others if v.type == "Real" and v.variability != "constant"}
    for given in ({v: x for v, x in values.items() if x is not None}, {}):

        def work(given: dict[Variable, Value] = given) -> list[Row] | None:
            with s.instance() as part:
                try:
                    for v, value in given.items():
                        part.set(v, value)
                    s.initialise(part)
                    s.go(part, 0, s.steps // 2)
                except FmuError:
                    return None
                part.session.reset()
                s.initialise(part)
                return s.go(part, 0, s.steps)

        if (rows := s.in_process(work)) is not None:
            s.same(rows, s.reference, "after a reset")
            return f"{s.steps} rows after a run with {len(given)} other parameters, bit for bit"
    raise Broken("it does not run a second time")


def instances(s: Subject) -> str:
    """An instance stepped in turn with another one whose inputs are ahead."""
    if s.can.canBeInstantiatedOnlyOncePerProcess:
        raise NotOffered("canBeInstantiatedOnlyOncePerProcess is true")
    with s.running() as part, s.running(s.steps // 3) as other:
        rows: list[Row] = []
        for k in range(s.steps):
            rows += s.go(part, k, k + 1)
            with suppress(FmuError):
                s.go(other, k + s.steps // 3, k + s.steps // 3 + 1)
    s.same(rows, s.reference, "beside another instance")
    return f"{s.steps} rows beside another instance, bit for bit"


def states(s: Subject) -> str:
    """Two states that are kept at the same time, and each restored."""
    s.needs("canGetAndSetFMUstate")
    third = s.steps // 3
    with s.running(third) as part:
        early, late = part.state(), part.state()
        part.save(early)
        s.same(s.go(part, third, 2 * third), s.reference[third:], "after a state is saved", third)
        part.save(late)
        s.go(part, 2 * third, s.steps)
        for state, first in ((early, third), (late, 2 * third), (early, third)):
            part.restore(state)
            s.same([s.row(part)], [s.reference[first - 1]], "when the state is set", first - 1)
            rows = s.go(part, first, s.steps)
            s.same(rows, s.reference[first:], "after the state is set", first)
    return f"{s.steps - third} rows from two states, bit for bit"


def bytes_(s: Subject) -> str:
    """A state carried as bytes from one instance to another."""
    s.needs("canSerializeFMUstate")
    half = s.steps // 2
    with s.running(half) as part, nullcontext(part) if s.once else s.running() as other:
        state = part.state()
        part.save(state)
        copy, size = part.session.transfer(state, other.session)
        other.restore(copy)
        rows = s.go(other, half, s.steps)
    s.same(rows, s.reference[half:], "after the state was carried over as bytes", half)
    return f"{s.steps - half} rows from {size} bytes, bit for bit"


def halves(s: Subject) -> str:
    """One step of 4 h against two of 2 h, and one of 2 h against two of h; longer ones to see an order."""
    s.needs("canHandleVariableCommunicationStepSize")
    for h in (s.h * longer for longer in LONGER):
        try:
            apart, moved = split(s, h)
        except FmuError:
            if h == s.h:
                raise
            break
        moving = [name for name in moved if moved[name][1] > NOISE]
        off = [x for x in moving if apart[x][1] > max(0.3 * moved[x][1], 0.5 * apart[x][0])]
        if h == s.h and off and 2 * len(off) >= len(moving):
            raise Broken(
                f"{', '.join(off)}: one step and two of half the size differ by a third of the change "
                f"or more, for {4 * h:g} s and for {2 * h:g} s"
            )
        far, near = (sum(apart[name][level] for name in moving) for level in (0, 1))
        if near > NOISE:
            order = math.log2(far / near) - 1.0
            return f"order {order:.1f}: {far:.2g} and {near:.2g} of the range, {4 * h:g} and {2 * h:g} s"
    return f"no difference above {NOISE:g} of the range: exact, or smaller internal steps"


def split(s: Subject, h: float) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """By Real output, in units of its range and summed over three points: the difference between one step
    of 4 h and two of 2 h, then between one of 2 h and two of h; and how far the one step moves it.
    """
    apart, moved = ({name: [0.0, 0.0] for name in s.ranges} for _ in range(2))
    for n in (1, s.steps // 3, 2 * s.steps // 3):
        u = s.inputs_at(n)
        begin = s.after(n, u, [])
        for level, size in enumerate((4 * h, 2 * h)):
            whole, parts = s.after(n, u, [size]), s.after(n, u, [size / 2, size / 2])
            for name, wide in s.ranges.items():
                apart[name][level] += abs(whole[name] - parts[name]) / wide
                moved[name][level] += abs(whole[name] - begin[name]) / wide
    return apart, moved


def outputs(s: Subject) -> str:
    """Which outputs an input moves in a step too short for any state to move."""
    s.needs("canHandleVariableCommunicationStepSize")
    declared = {
        u.variable.name: (u.dependencies, u.dependenciesKind) for u in s.description.outputs
    }
    reals = [v for v in s.outputs if v.name in s.ranges and v.variability in (None, "continuous")]
    coarse: set[str] = set()
    for n in (0, s.steps // 2):
        u = s.inputs_at(n)
        coarse |= _unresolved(s, n)
        reals = [v for v in reals if v.name not in coarse]
        for j, known in enumerate(s.inputs[:MOST_INPUTS]):
            slopes = {h: s.slopes(n, u, j, h, SHAKE) for h in (s.h / 64, s.h / 1024)}
            for v in reals:
                (up, down), (long_up, _) = slopes[s.h / 1024][v.name], slopes[s.h / 64][v.name]
                floor = NOISE * s.ranges[v.name] / s.size(known)
                feels = abs(up) > max(0.5 * abs(long_up), floor)
                names, kinds = declared.get(v.name, (None, None))
                if feels and names is not None and known not in names:
                    raise Broken(
                        f"{v.name} depends on {known.name} at once, with slope {up:.4g}, undeclared"
                    )
                kind = kinds[names.index(known)] if kinds and names and known in names else ""
                if kind in ("constant", "fixed") and abs(up - down) > AGREES * abs(up) + floor:
                    raise Broken(
                        f"{v.name} by {known.name} is declared {kind}, but its slope is {down:.6g} on one "
                        f"side and {up:.6g} on the other"
                    )
    if coarse and not reals:
        raise NotOffered(f"it takes no steps as short as {s.h / 1024:.3g} s")
    tried = min(len(s.inputs), MOST_INPUTS)
    return f"{len(reals)} Real outputs by {tried} of {len(s.inputs)} Real inputs"


def _unresolved(s: Subject, n: int) -> set[str]:
    """The Real outputs that a step of h / 1024 moves about as far as one of h / 64, with the same inputs.

    An FMU that takes whole internal steps only, or rounds the size of a step, moves its states in such a
    step; the slopes by its inputs then show no direct dependence.
    """
    u = s.inputs_at(max(n - 1, 0))
    begin, short, long = (s.after(n, u, sizes) for sizes in ([], [s.h / 1024], [s.h / 64]))
    return {
        name
        for name, wide in s.ranges.items()
        if abs(short[name] - begin[name]) > max(0.5 * abs(long[name] - begin[name]), NOISE * wide)
    }


def unknowns(s: Subject) -> str:
    """Which unknowns a value moves while initialising."""
    entries = s.description.initialUnknowns
    if not entries:
        raise NotOffered("there are no InitialUnknowns")
    known = [v for v in s.description.modelVariables if s.known(v)]
    shown = [u.variable for u in entries]

    def found(v: Variable | None = None, value: Value = 0) -> dict[str, Value]:
        def work() -> dict[str, Value]:
            with s.instance() as part:
                s.enter(part)
                if v is not None:
                    part.set(v, value)
                return part.access.values(shown)

        return s.in_process(work)

    base, tried = found(), 0
    steady = [u for u in entries if u.variable.name not in s.unsteady]
    for v in known[:MOST_KNOWNS]:
        if (value := nudged(v)) is None:
            continue
        with suppress(FmuError):
            other = found(v, value)
            tried += 1
            for u in steady:
                name = u.variable.name
                felt = other[name] != base[name] and base[name] == base[name]  # not so for nan
                if felt and u.dependencies is not None and v not in u.dependencies:
                    raise Broken(
                        f"{name} is {other[name]!r}, not {base[name]!r}, with {v.name} = {value!r}, undeclared"
                    )
    return f"{len(entries)} unknowns by {tried} of {len(known)} values"


class Slope(NamedTuple):
    """A directional derivative: when, of what, by what; the FMU's value, and the one by differences.

    `low` and `high` are the slopes on either side, which differ at a kink, and `error` is how uncertain
    these are.
    """

    when: str
    unknown: Variable
    known: Variable
    stated: float
    low: float
    high: float
    error: float


def derivatives(s: Subject) -> str:
    """Directional derivatives: while initialising by inputs and initial states, after a step by inputs."""
    s.needs("providesDirectionalDerivative")
    pairs = kinks = 0
    for slope in chain(s.in_process(lambda: list(_initial_slopes(s))), _later_slopes(s)):
        x, v = slope.unknown, slope.known
        middle = (slope.low + slope.high) / 2.0
        floor = NOISE * s.ranges.get(x.name, s.size(x)) / s.size(v)
        allowed = AGREES * abs(middle) + 2.0 * slope.error + floor
        kink = slope.high - slope.low > 2.0 * allowed
        off = max(slope.low - slope.stated, slope.stated - slope.high) if kink else (
            abs(slope.stated - middle)
        )  # fmt: skip
        if not off <= allowed:
            sides = f"{slope.low:.6g} and {slope.high:.6g}, on two sides of a kink"
            raise Broken(
                f"the derivative of {x.name} by {v.name} {slope.when} is {slope.stated:.6g}; "
                f"differences give {sides if kink else f'{middle:.6g}'}"
            )
        pairs, kinks = pairs + 1, kinks + kink
    return f"{pairs} derivatives" + (f", {kinks} of them at a kink" if kinks else "")


def _initial_slopes(s: Subject) -> Iterator[Slope]:
    known = [v for v in s.description.modelVariables if s.known(v) and smooth(v)]
    known = [v for v in known if v.causality != "parameter" and nudged(v) is not None]
    real = [u.variable for u in s.description.initialUnknowns if smooth(u.variable)]
    real = [v for v in real if v.name not in s.unsteady]
    with s.instance() as part:
        s.enter(part)
        for v in known if real else ():
            own = float(declared_start(v) or 0.0)
            stated, middle = part.access.slopes(real, v), reals(part, real)
            middles, sides = [], []
            for wide in (1e-4 * s.size(v), 2e-4 * s.size(v)):
                above, below = (bounded(v, own + off) for off in (wide, -wide))
                ends = []
                for value in (above, below):
                    part.set(v, value)
                    ends.append(reals(part, real))
                part.set(v, own)
                middles.append(
                    [(ends[0][x.name] - ends[1][x.name]) / (above - below) for x in real]
                )
                sides.append(_sides(real, middle, ends, (above - own, below - own)))
            for x, value, near, far, either in zip(real, stated, *middles, sides[0]):
                low, high = sorted(either)
                yield Slope("while initialising", x, v, value, low, high, abs(near - far))


def _sides(
    real: Sequence[Variable],
    middle: dict[str, float],
    ends: Sequence[dict[str, float]],
    away: Sequence[float],
) -> list[list[float]]:
    """By variable, the slopes from its value in the middle to those at the ends that are away from it."""
    pairs = [(end, far) for end, far in zip(ends, away) if far]
    slopes = [[(end[x.name] - middle[x.name]) / far for end, far in pairs] for x in real]
    return [pair * 2 if len(pair) == 1 else pair for pair in slopes]


def _later_slopes(s: Subject) -> Iterator[Slope]:
    real = [v for v in s.outputs if v.name in s.ranges]
    for n in (1, s.steps // 2) if s.can.canHandleVariableCommunicationStepSize else ():
        u = s.inputs_at(n)
        for j, v in enumerate(s.inputs[:MOST_INPUTS]):
            near, far = (s.slopes(n, u, j, s.h / d, 1e-3) for d in (1024, 64))

            def work(n: int = n, u: list[float] = u, v: Variable = v) -> list[float]:
                with s.running(n) as part:
                    s.steer(part, u)
                    part.advance(s.start + n * s.h, s.h / 1024)
                    return part.access.slopes(real, v)

            for x, value in zip(real, s.in_process(work)):
                middle, other = sum(near[x.name]) / 2, sum(far[x.name]) / 2
                low, high = sorted(near[x.name])
                yield Slope(f"after step {n + 1}", x, v, value, low, high, abs(middle - other))


def discards(s: Subject) -> str:
    """A step over the whole experiment, which the FMU may discard."""
    s.needs("canHandleVariableCommunicationStepSize")
    t, h = s.start, s.stop - s.start
    if s.third:
        return untouched(s, t, h)

    def long_step() -> tuple[int, float, bool]:
        with s.running() as part:
            if part.step_status(t, h) != DISCARD:
                raise NotOffered(f"a step of {h:g} s is not discarded")
            return part.last_success()

    answer, reached, ended = s.in_process(long_step)
    said = f"a step of {h:g} s is discarded"
    if answer > WARNING:
        raise Broken(f"{said}, fmi2LastSuccessfulTime is not reported: {STATUS[answer]}")
    if not t <= reached < t + h:
        raise Broken(f"fmi2LastSuccessfulTime is {reached!r} s after a step from {t!r} by {h!r} s")
    if ended:
        return f"{said} at {reached:g} s, where the FMU wants to end"

    def short_step() -> None:
        with s.running() as part:
            part.advance(t, reached - t)

    if reached > t:
        s.in_process(short_step)
    return f"{said}, one to {reached:g} s is accepted"


def untouched(s: Subject, t: float, h: float) -> str:
    """In FMI 3.0, a discarded step leaves the FMU as it was."""
    step = f"a step of {h:g} s is"
    with s.running() as part:
        try:
            part.advance(t, h)
        except StepDiscarded:
            s.same(s.go(part, 0, s.steps), s.reference, f"after {step} discarded")
            return f"{step} discarded, {s.steps} rows after it bit for bit"
        except SimulationTerminated as reason:
            raise NotOffered(f"{step} not discarded: {reason}") from reason
        raise NotOffered(f"{step} not discarded")


def stop_time(s: Subject) -> str:
    """A defined stop time, far beyond the last step, does not change the rows before it."""
    stop = max(s.stop, s.start + 2 * s.steps * s.h)
    with s.instance() as part:
        part.set_up(s.tolerance, s.start, stop)
        s.steer(part, s.inputs_at(0))
        part.begin()
        rows = s.go(part, 0, s.steps)
    condition = f"with a stop time of {stop:g} s"
    worst = 0.0
    for v, ours, theirs in zip(s.shown, zip(*rows), zip(*s.reference)):
        if v.name in s.unsteady:
            continue
        real = v.type == "Real"
        wide = (max(theirs) - min(theirs) or max(map(abs, theirs)) or 1.0) if real else 0.0
        for k, (x, y) in enumerate(zip(ours, theirs), 1):
            if not differ(x, y):
                continue
            if not real or not abs(float(x) - float(y)) <= AGREES * wide:
                raise Broken(f"{v.name} after step {k} is {x!r} {condition}, {y!r} without one")
            worst = max(worst, abs(float(x) - float(y)) / wide)
    agree = f"within {worst:.2g} of the range" if worst else "bit for bit"
    return f"{s.steps} rows {condition} are those without one, {agree}"


def start_time(s: Subject) -> str:
    """The independent variable in a run from another start time."""
    variables = s.description.modelVariables
    clocks = [v for v in variables if v.causality == "independent" and smooth(v)]
    if not clocks:
        raise NotOffered("it has no independent variable, so nothing shows its time")
    first = s.start + max(1, s.steps // 3) * s.h
    with s.instance() as part:
        try:
            part.set_up(s.tolerance, first, None)
            s.steer(part, s.inputs_at(0))
            part.begin()
        except FmuError as reason:
            raise NotOffered(f"it does not start at {first:g} s: {reason}") from reason
        for k in range(3):
            t = first + k * s.h
            for name, value in reals(part, clocks).items():
                if not abs(value - t) <= NOISE * (abs(t) + s.h):
                    raise Broken(
                        f"{name} is {value!r} after {k} steps of a run from {first!r} s, not {t!r}"
                    )
            s.steer(part, s.inputs_at(k))
            part.advance(t, s.h)
    return f"{clocks[0].name} is right in a run from {first:g} s"


def resident() -> int:
    """The resident memory of this process [bytes]."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGESIZE


def memory(s: Subject) -> str:
    """Resident memory over many steps, ignoring the first ones, and over many instances."""
    if not Path("/proc/self/statm").exists():
        raise NotOffered("the memory of a process cannot be read here")
    sizes: list[int] = []
    taken, life = 0, LONG
    while taken < LONG:
        with s.running() as part:
            for k in range(min(life, LONG - taken)):
                try:
                    part.advance(s.start + k * s.h, s.h)
                except FmuError:
                    life = k
                    break
                taken += 1
                if taken % (LONG // 5) == 0:
                    sizes.append(resident())
        if life <= s.steps // 2 or (s.once and life < LONG):
            raise NotOffered(f"it takes no more than {life} steps with constant inputs")
    grown = [after - before for before, after in pairwise(sizes)]
    said = f"{sum(grown) / 1024:.0f} KiB more after {LONG} steps than after {LONG // 5}"
    if sum(grown) > LEAK and sum(g > 0 for g in grown) > len(grown) / 2:
        raise Broken(said)
    return said if s.once else f"{said}; {_lives(s)}"


def _lives(s: Subject) -> str:
    """Resident memory over many instances, each initialised, stepped once and freed."""
    early = round(EARLY_LIVES * LIVES)
    marks = range(early, LIVES + 1, (LIVES - early) // 4)
    sizes = []
    for k in range(1, LIVES + 1):
        with s.running(1):
            pass
        if k in marks:
            sizes.append(resident())
    grown = [after - before for before, after in pairwise(sizes)]
    growth = f"{sum(grown) / 1024:.0f} KiB more after {LIVES} instances than after {early}"
    if sum(grown) > LEFT * (LIVES - early) and all(g > 0 for g in grown):
        raise Broken(growth)
    return growth


class Check(NamedTuple):
    """A check, its clauses of FMI 2.0 and 3.0, its function, and how to repeat it by hand."""

    name: str
    second: str
    third: str
    does: Callable[[Subject], str]
    again: str

    def verdict(self, version: str, status: str, said: str) -> Verdict:
        """How the check of an FMU of a version ended."""
        clause = self.third if version == "3.0" else self.second
        return Verdict(self.name, clause, status, said, self.again)


CHECKS = {check.name: check for check in (
    Check("description", "2.2", "2.4", description, "validate the FMU with FMPy"),
    Check("binary", "2.1.4", "2.2.5", binary,
          "ask the binary for its version and, in FMI 2.0, for its types platform"),
    Check("run", "4.2.2", "4.2.1", runs, "initialise; doStep and get the outputs"),
    Check("termination", "2.1.6", "2.3.8", terminates, "run, terminate, get the values again"),
    Check("start values", "2.2.7", "2.4.7.4", starts,
          "enter initialization mode, set nothing; get exact outputs, and parameters after it"),
    Check("stop time", "2.1.6", "2.3.2", stop_time,
          "run with a stop time far beyond the last step, and without one"),
    Check("start time", "2.1.6", "2.3.2", start_time,
          "run from a later start time; get the independent variable"),
    Check("repetition", "4.1.2", "4.1", repeats, "run; free the instance, run a new one"),
    Check("getting", "2.1.7", "2.2.7.2", looks, "run, and get all values twice after each step, in the opposite order, and one at a time"),
    Check("reset", "2.1.6", "2.3.1", resets, "set other parameters, run; reset, run without them"),
    Check("instances", "4.3.1", "2.2.1", instances, "step two instances in turn, one a third ahead"),
    Check("state", "2.1.8", "2.2.7.4", states,
          "get the FMU state after a third and after two thirds of the steps; set each, step on"),
    Check("serialization", "2.1.8", "2.2.7.4", bytes_,
          "after half the steps serialize the state; deserialize and set it in a new instance, step on"),
    Check("step size", "4.2.2", "4.2.1", halves,
          "with constant inputs: one step of 4 h against two of 2 h, one of 2 h against two of h"),
    Check("output dependencies", "2.2.8", "2.4.8", outputs,
          "a step of h / 1024, and in an equal instance with another input; the same with h / 64"),
    Check("initial dependencies", "2.2.8", "2.4.8", unknowns,
          "enter initialization mode, set one value, get the InitialUnknowns; the same without setting"),
    Check("directional derivatives", "2.1.9", "2.2.12.1", derivatives,
          "the FMU's derivative against the difference for two values of the known"),
    Check("discard", "4.2.3", "4.2.1", discards, "initialise; one step over the whole default experiment"),
    Check("memory", "2.1.5", "2.2.1", memory, "10 000 steps, then 60 instances; watch the resident memory"),
)}  # fmt: skip


def checked(s: Subject, name: str) -> Verdict:
    """The verdict of one check; what needs a run is not tried where there is none."""
    status, before = NOT_RUN, "it does not run: "
    try:
        if name not in ("description", "binary", "run"):
            s.unsteady  # noqa: B018
            s.reference  # noqa: B018
        status, before = FAILED, ""
        said = s.in_process(lambda: CHECKS[name].does(s))
        status = PASSED
    except NotOffered as reason:
        status, said = NOT_OFFERED, str(reason)
    except (Broken, FmuError) as reason:
        said = f"{before}{reason}"
    return CHECKS[name].verdict(s.description.fmiVersion, status, said)
