"""An FMU under test: how it is excited, over which steps, and what its instances then show."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import TypeVar

from ...engine.system_instance import open_cosimulation
from ...errors import FmuError
from ...fmu.instance import CoSimulation
from ...fmu.library import borrow
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
from ...system.reading import OF_FMI3
from .process import forked

#: Steps of a run at most. Chosen: thirds, halves and quarters of it are whole, and a run takes a moment.
STEPS = 60
#: Fewest steps that a check can do with. Chosen: three parts, as the check of states has them.
FEWEST_STEPS = 3
#: Amplitude of the inputs, over the size of a variable. Chosen: enough to move what there is, and small enough for most
#: machines to stay where their equations hold.
EXCITATION = 0.05
#: Change of a value, over the size of a variable. Chosen: a fifth of the excitation.
CHANGE = 0.01
#: Phase that an input gains in a step [rad], times its number. Chosen: no whole number of steps is a period.
PHASE_PER_STEP = 0.37
#: Steps of an experiment for which the FMU prefers none. Convention of the command line.
DEFAULT_STEPS = 100
#: Step of an FMU that states neither step nor experiment [s]. Chosen.
DEFAULT_STEP = 0.01


class CheckFailed(Exception):
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
        self.is_fmi3 = self.description.fmiVersion == "3.0"
        self.can = self.description.offered_interface("coSimulation")
        variables = self.description.modelVariables
        self.inputs = [v for v in variables if is_continuous_input(Port("fmu", v))]
        self.observed = [
            v for v in variables if v.causality in ("output", "local") and v.type != "Clock"
        ]
        self.outputs = [v for v in self.observed if v.causality == "output"]
        experiment = self.description.defaultExperiment
        self.start = experiment.start or 0.0
        self.stop = self.start + 1.0 if experiment.stop is None else experiment.stop
        self.h = (
            step or experiment.step or abs(self.stop - self.start) / DEFAULT_STEPS or DEFAULT_STEP
        )
        self.tolerance = experiment.tolerance
        self.once = bool(self.can.canBeInstantiatedOnlyOncePerProcess)
        self.is_excited = True
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
        """What `work` returns, which makes an instance.

        If the FMU allows one instance per process, the work is done in a process of its own, where the
        system can copy processes.
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
        self.set_inputs(part, self.inputs_at(0))
        part.leave_initialisation()

    def enter(self, part: CoSimulation) -> None:
        """Into initialisation mode, with the tolerance that the FMU states and without a stop time."""
        part.enter_initialisation(self.tolerance, self.start, None)

    @staticmethod
    def size(v: Variable) -> float:
        """What is much for a variable."""
        return abs(float(declared_start(v) or 0.0)) or abs(float(v.nominal or 0.0)) or 1.0

    def inputs_at(self, k: int) -> list[float]:
        """The Real inputs at step k."""
        amplitudes = [EXCITATION * self.size(v) * self.is_excited for v in self.inputs]
        return [
            bounded(
                v,
                float(declared_start(v) or 0.0)
                + amplitude * math.sin(PHASE_PER_STEP * (j + 1) * k + j),
            )
            for j, (v, amplitude) in enumerate(zip(self.inputs, amplitudes))
        ]

    def set_inputs(self, part: CoSimulation, u: Sequence[float]) -> None:
        """Set the Real inputs."""
        for v, value in zip(self.inputs, u):
            part.set(v, value)

    def go(self, part: CoSimulation, first: int, last: int) -> list[Row]:
        """The rows after the steps from number `first` to `last`, each with the inputs of its step."""
        rows = []
        for k in range(first, last):
            self.set_inputs(part, self.inputs_at(k))
            part.advance(self.start + k * self.h, self.h)
            rows.append(self.row(part))
        return rows

    def row(self, part: CoSimulation) -> Row:
        """What the FMU shows now."""
        return tuple(part.session.values(self.observed).values())

    @cached_property
    def steps(self) -> int:
        """How many steps it takes as it is excited, at most STEPS; raises FmuError if none."""
        for self.is_excited in (True, False):
            taken, failure = self.in_process(self._taken)
            if (
                failure is None
                or taken > STEPS // 2
                or (not self.is_excited and taken > FEWEST_STEPS)
            ):
                return taken
            if not self.is_excited:
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
                for v, x, y in zip(self.observed, ours, theirs)
                if differ(x, y)
            )
        return frozenset()

    def how(self) -> str:
        """Over which steps and with which inputs it is run."""
        stepping = f"steps of h = {self.h:g} s from {self.start:g} s"
        excited = f"start + {EXCITATION:g} size sin({PHASE_PER_STEP:g} (j + 1) k + j)"
        return (
            f"{stepping}; Real inputs j = 0, 1, ... in step k: {excited}"
            if self.inputs
            else stepping
        )

    def same(
        self, rows: Sequence[Row], expected_rows: Sequence[Row], what: str, first: int = 0
    ) -> None:
        """Raise Broken at the first value that differs in a bit; `first` is the number of the first row.

        What does not repeat in a second instance, which has a check of its own, is left out.
        """
        for k, (row, reference) in enumerate(zip(rows, expected_rows), first + 1):
            for v, value, expected in zip(self.observed, row, reference):
                if differ(value, expected) and v.name not in self.unsteady:
                    raise CheckFailed(
                        f"{v.name} after step {k} is {value!r} {what}, not {expected!r}"
                    )

    def needs(self, ability: str) -> None:
        """Raise NotOffered without a capability flag."""
        if not getattr(self.can, ability):
            raise NotOffered(
                f"{OF_FMI3.get(ability, ability) if self.is_fmi3 else ability} is false"
            )

    def is_settable(self, v: Variable) -> bool:
        """Whether a variable may be set while initialising."""
        exact: bool = v.initial == "exact" and v.variability != "constant"
        return exact or v.causality == "input"

    def after(self, n: int, u: Sequence[float], sizes: Sequence[float]) -> dict[str, float]:
        """The Real outputs of a new instance after n steps and some of these sizes [s] with inputs u."""

        def work() -> dict[str, float]:
            with self.running(n) as part:
                t = self.start + n * self.h
                for h in sizes:
                    self.set_inputs(part, u)
                    part.advance(t, h)
                    t += h
                return reals(part, [v for v in self.outputs if smooth(v)])

        return self.in_process(work)

    def slopes(
        self, n: int, u: Sequence[float], j: int, h: float, share: float
    ) -> dict[str, tuple[float, float]]:
        """Of the Real outputs by input j, above and below its value, after n steps and one of h [s]."""
        amplitude = share * self.size(self.inputs[j])
        up, middle, down = (
            self.after(n, [*u[:j], u[j] + change, *u[j + 1 :]], [h])
            for change in (amplitude, 0.0, -amplitude)
        )
        return {x: ((up[x] - middle[x]) / amplitude, (middle[x] - down[x]) / amplitude) for x in up}

    @cached_property
    def ranges(self) -> dict[str, float]:
        """How far each Real output that repeats moves, or its size if it does not move."""
        spans = {}
        for v, column in zip(self.observed, zip(*self.reference)):
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
    return {name: float(value) for name, value in part.session.values(variables).items()}


def bounded(v: Variable, value: float) -> float:
    """The nearest value that a variable may have."""
    low = -math.inf if v.min is None else float(v.min)
    high = math.inf if v.max is None else float(v.max)
    return min(max(value, low), high)


def nudged(v: Variable) -> Value | None:
    """Another value that a variable may have, near its start; None for a text, or where there is none."""
    start = declared_start(v)
    if v.type == "Boolean":
        return not start
    if v.type == "Enumeration":
        return next((x for x in enumeration(v).values() if x != start), None)
    if v.type not in ("Real", "Integer"):
        return None
    value = float(start or 0.0)
    change = CHANGE * Subject.size(v) if v.type == "Real" else 1.0
    for candidate in (bounded(v, value + change), bounded(v, value - change)):
        if candidate != value:
            return candidate if v.type == "Real" else round(candidate)
    return None
