"""An exact solution of systems of parts of `drawn`, event by event, and such systems drawn by a seed.

It shares nothing with the engine. Between events x' = M x + k is a matrix exponential. At an event, one rule: free
inputs take their values of that time; the wires are followed; then the parts that are due sample, in the stepping order,
each once and with what the parts before it have given; then the wires are followed until nothing moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from cosim import Series, System

from .drawn import STARTS, pack2, pack3

Array = NDArray[np.float64]
#: Times that differ by less are one [s].
NEAR = 1e-10
OUTPUTS = ("x", "y", "e", "n")


@dataclass(frozen=True)
class Drawn:
    """A system: `ticks` are the interval and shift [s] of clocks, `tables` the times [s] and values that inputs take."""

    versions: Mapping[str, int]
    wires: Mapping[str, str]
    start: Mapping[str, float]
    tables: Mapping[str, tuple[Sequence[float], Sequence[float]]] = field(default_factory=dict)
    ticks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    order: Sequence[str] | None = None
    stop: float = 1.0
    step: float = 0.1
    #: Inputs that change by `changes` rather than by a table.
    changed: frozenset[str] = frozenset()

    def system(self, folder: Path, **packing: Any) -> System:
        """The system on FMUs, which are written to a folder."""
        parts = {
            name: pack3(folder / f"{name}.fmu", self.ticks.get(name), **packing)
            if version == 3
            else pack2(folder / f"{name}.fmu", **packing)
            for name, version in self.versions.items()
        }
        tables, changes = {}, []
        for name, (times, values) in self.tables.items():
            if name in self.changed:
                changes += [f"at {t!r} s {name} = {v!r}" for t, v in zip(times[1:], values[1:])]
            else:
                tables[name] = Series.of({"t": list(times), "v": list(values)}).held()
        wires = [f"{source} -> {target}" for target, source in self.wires.items()]
        return System(parts, wires, dict(self.start), inputs=tables, changes=changes)

    @property
    def stepping(self) -> Sequence[str]:
        """The names of the parts in their stepping order, which is the order as declared where nothing else is said."""
        return self.order or list(self.versions)

    @cached_property
    def exact(self) -> Exact:
        """Its solution."""
        return Exact(self)


class Exact:
    """The solution of a drawn system: `events` are its times [s]; `before` and `after` the outputs at each of them."""

    def __init__(self, drawn: Drawn) -> None:
        self.drawn, names = drawn, list(drawn.versions)
        self.parts = names
        defaults = dict.fromkeys(["u", "d", "x", "y", "e", "a", "b", "c", "q", "g", "w", "n"], 0.0)
        self.value = {f"{p}.{v}": x for p in names for v, x in (defaults | STARTS).items()}
        self.value |= drawn.start
        self.value |= {name: values[0] for name, (_, values) in drawn.tables.items()}
        due: dict[str, list[float]] = {}
        for p, version in drawn.versions.items():
            period, first = (drawn.start.get(f"{p}.{v}", 0.0) for v in ("period", "first"))
            if p in drawn.ticks:
                period, first = drawn.ticks[p]
            if version == 3 and period > 0.0:
                due[p] = (
                    first + period * np.arange(int((drawn.stop - first) / period + 2))
                ).tolist()
        times = [t for ticks in due.values() for t in ticks]
        times += [t for ts, _ in drawn.tables.values() for t in ts]
        inside = sorted(t for t in times if 0.0 < t <= drawn.stop + NEAR)
        self.events = [0.0]
        self.events += [b for a, b in zip([0.0, *inside], inside) if b - a > NEAR]
        self.before: list[dict[str, float]] = []
        self.after: list[dict[str, float]] = []
        self.pieces: list[tuple[Array, Array]] = []
        now = 0.0
        for t in self.events:
            if self.pieces:
                self._drift(t - now)
            now = t
            self._follow_wires()
            self.before.append(dict(self.value))
            self._happen(t, due)
            self.after.append(dict(self.value))
            self.pieces.append(self._piece())

    def _follow_wires(self) -> None:
        for _ in range(2 * len(self.value)):
            old = dict(self.value)
            for target, source in self.drawn.wires.items():
                self.value[target] = self.value[source]
            for p in self.parts:
                self.value[f"{p}.e"] = self.value[f"{p}.d"]
            if old == self.value:
                return
        raise AssertionError("the wires do not rest")

    def _happen(self, t: float, due: Mapping[str, Sequence[float]]) -> None:
        """All that is due at a time [s], by the one rule."""
        v = self.value
        for name, (times, values) in self.drawn.tables.items():
            v[name] = values[max(0, int(np.searchsorted(times, t + NEAR)) - 1)]
        self._follow_wires()
        for p in self.drawn.stepping:
            if any(abs(tick - t) <= NEAR for tick in due.get(p, ())):
                v[f"{p}.y"] = v[f"{p}.q"] * v[f"{p}.y"] + v[f"{p}.g"] * v[f"{p}.d"] + v[f"{p}.w"]
                v[f"{p}.n"] += 1.0
                self._follow_wires()

    def _piece(self) -> tuple[Array, Array]:
        """M and k of x' = M x + k until the next event."""
        n, v = len(self.parts), self.value
        slopes, constant = np.zeros((n, n)), np.zeros(n)
        for k, p in enumerate(self.parts):
            slopes[k, k] += v[f"{p}.a"]
            for inner, gain in (("u", "b"), ("d", "c")):
                source = self.drawn.wires.get(f"{p}.{inner}", "")
                if source.endswith(".x"):
                    slopes[k, self.parts.index(source.split(".")[0])] += v[f"{p}.{gain}"]
                else:
                    constant[k] += v[f"{p}.{gain}"] * v[f"{p}.{inner}"]
        return slopes, constant

    def _drift(self, h: float) -> None:
        """All states, h [s] later."""
        x = np.array([self.value[f"{p}.x"] for p in self.parts])
        for p, end in zip(self.parts, _drifted(self.pieces[-1], x, h)):
            self.value[f"{p}.x"] = float(end)

    def at(self, t: float) -> tuple[dict[str, float], dict[str, float]]:
        """The outputs just before and just after a time [s]."""
        k = int(np.searchsorted(self.events, t + NEAR)) - 1
        if abs(self.events[k] - t) <= NEAR:
            return self.before[k], self.after[k]
        values = dict(self.after[k])
        x = np.array([values[f"{p}.x"] for p in self.parts])
        for p, end in zip(self.parts, _drifted(self.pieces[k], x, t - self.events[k])):
            values[f"{p}.x"] = float(end)
        return values, values


def _drifted(piece: tuple[Array, Array], x: Array, h: float) -> Array:
    """The solution of x' = M x + k after a time h [s]."""
    slopes, constant = piece
    n = len(x)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = slopes, constant
    return np.asarray(expm(h * augmented)[:n] @ np.append(x, 1.0))


def draw(seed: int, *, coupled: bool) -> Drawn:
    """A system of two to four parts with samples, held wires, and changes at and beside communication points.

    The states of `coupled` ones drive each other, so that they converge only.
    """
    rng = np.random.default_rng([seed, int(coupled)])
    step = 0.1
    names = list("pqrs")[: int(rng.integers(2, 5))]
    versions = {p: int(rng.choice([2, 3, 3])) for p in names}
    versions[names[0]] = 3
    beside = (0.0, 0.0, 0.037, 1e-6, -1e-6)

    def moment() -> float:
        """A time at a communication point, or beside one."""
        return float(rng.integers(1, 10) * step + rng.choice(beside))

    common = (
        float(rng.choice([0.1, 0.2, 0.25, 0.3, 0.17])),
        float(rng.choice([0.0, 0.1, 0.05, 0.13])),
    )
    start: dict[str, float] = {}
    wires: dict[str, str] = {}
    tables: dict[str, tuple[list[float], list[float]]] = {}
    ticks: dict[str, tuple[float, float]] = {}
    changed = set()
    whole = [float(k) for k in range(-3, 4)]

    def table(at_points: bool, k: int = 3) -> tuple[list[float], list[float]]:
        """Times [s] and values of an input that is held."""
        moments = {float(rng.integers(1, 10)) * step if at_points else moment() for _ in range(k)}
        if not at_points and rng.random() < 0.6:
            moments.add(common[0] * 2 + common[1])  # a tick
        return [0.0, *sorted(moments)], [float(rng.choice(whole)) for _ in range(len(moments) + 1)]

    sampling = []
    for k, p in enumerate(names):
        start |= {
            f"{p}.a": float(rng.choice([-1.0, -0.5, 0.0, -3.0])),
            f"{p}.b": float(rng.choice([1.0, -1.0, 0.5])),
        }
        start |= {f"{p}.c": float(rng.choice([1.0, 0.0, -2.0])), f"{p}.x": float(rng.choice(whole))}
        samples = versions[p] == 3 and (k == 0 or rng.random() < 0.8)
        if samples:
            sampling.append(p)
            interval, shift = (
                common if rng.random() < 0.65 else (float(rng.choice([0.2, 0.15, 0.1])), 0.05)
            )
            start |= {
                f"{p}.q": float(rng.choice([0.0, 0.5, -0.5, 1.0])),
                f"{p}.g": float(rng.choice([1.0, 0.5, 2.0])),
            }
            if rng.random() < 0.5:
                ticks[p] = (interval, shift)
            else:
                start |= {f"{p}.period": interval, f"{p}.first": shift}
    for p in names:
        others = [s for s in sampling if s != p]
        kind = rng.choice(["wire", "table", "change", "constant"], p=[0.45, 0.25, 0.2, 0.1])
        if kind == "wire" and others:
            wires[f"{p}.d"] = f"{rng.choice(others)}.y"
        elif kind in ("table", "change"):
            tables[f"{p}.d"] = table(at_points=False)
            if kind == "change":
                changed.add(f"{p}.d")
        else:
            start[f"{p}.d"] = float(rng.choice(whole))
        if versions[p] == 3 and others and rng.random() < 0.4:
            wires[f"{p}.w"] = f"{rng.choice(others)}.n"
        if coupled:
            wires[f"{p}.u"] = f"{names[names.index(p) - 1]}.x"
        elif others and rng.random() < 0.5:
            wires[f"{p}.u"] = f"{rng.choice(others)}.y"
        else:
            tables[f"{p}.u"] = table(at_points=True, k=1)
    start |= {name: tables[name][1][0] for name in changed}
    return Drawn(versions, wires, start, tables, ticks, list(names), 1.0, step, frozenset(changed))
