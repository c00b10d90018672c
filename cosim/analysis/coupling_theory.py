"""Co-simulation as linear algebra: what each algorithm makes of coupled linear parts, without FMUs.

A step of any algorithm is an affine map from what the parts and the master keep to the same after
the step, since parts that integrate exactly are matrix exponentials and their inputs are sums of
what the others have shown. The map is found by taking the step with the unit matrix in place of
what is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from ..engine.algorithms import find_algorithm

Matrix = NDArray[np.float64]
Rows = Sequence[Sequence[float]]


@dataclass(frozen=True)
class Unit:
    """A part; `u` gives for each input its source "part.output", outputs counted from 1, or a value."""

    A: Rows
    B: Rows
    C: Rows
    x: Sequence[float]
    u: Sequence[str | float]
    D: Rows | None = None

    @property
    def feedthrough(self) -> Matrix:
        """D, or zeros of its shape."""
        return np.zeros((len(self.C), len(self.u))) if self.D is None else np.array(self.D, float)


class Scheme(NamedTuple):
    """An algorithm, the degree of what inputs do within a step, and what the FMUs do themselves.

    `hold` is the `input_hold` of the FMUs: 0 hold, 1 extrapolate, 2 interpolate. `substeps` is the
    number of steps that the last part takes within one.
    """

    algorithm: str
    input_order: int = 0
    hold: int = 0
    substeps: int = 1


class Exchange(NamedTuple):
    """What a part showed before and after its turn of a size [s], and heard first and last.

    Rows of matrices that act on what is kept before the step.
    """

    part: int
    size: float
    before: Matrix
    after: Matrix
    first: Matrix
    last: Matrix


class Ideal:
    """Coupled units; what is kept is states, outputs, outputs before, inputs last set, and a 1."""

    def __init__(self, units: Mapping[str, Unit]) -> None:
        parts = list(units.values())
        self.A, self.B, self.C, self.D = (
            block_diag(*blocks) for blocks in zip(*((u.A, u.B, u.C, u.feedthrough) for u in parts))
        )
        self.x0 = np.concatenate([u.x for u in parts]).astype(float)
        places = [f"{name}.{i + 1}" for name, u in units.items() for i in range(len(u.C))]
        sources = [source for u in parts for source in u.u]
        self.L = np.zeros((len(sources), len(places)))
        self.given = np.zeros(len(sources))
        for row, source in enumerate(sources):
            if isinstance(source, str):
                self.L[row, places.index(source)] = 1.0
            else:
                self.given[row] = source
        self.outputs = places
        self.parts = range(len(parts))
        self.x_of, self.u_of, self.y_of = (
            [slice(*ends) for ends in pairwise(np.cumsum([0, *sizes]).tolist())]
            for sizes in zip(*((len(u.x), len(u.u), len(u.C)) for u in parts))
        )
        self.owner = [p for p in self.parts for _ in parts[p].C]
        self.whole = lru_cache(maxsize=None)(self._whole)
        self.flow = lru_cache(maxsize=None)(self._flow)
        self.step = lru_cache(maxsize=None)(self._step)

    @property
    def start(self) -> Matrix:
        """What is kept at the start, where the inputs agree with the outputs."""
        loop = np.eye(len(self.given)) - self.L @ self.D
        u = np.linalg.solve(loop, self.L @ self.C @ self.x0 + self.given)
        y = self.C @ self.x0 + self.D @ u
        return np.concatenate([self.x0, y, y, u, [1.0]])

    def exact(self, sizes: Sequence[float]) -> Matrix:
        """The states of the coupled whole after steps of these sizes [s], shape (steps + 1, states)."""
        steps = accumulate(sizes, lambda x, h: self.whole(h) @ x, initial=np.append(self.x0, 1.0))
        return np.array([*steps])[:, :-1]

    def run(self, scheme: Scheme, sizes: Sequence[float]) -> Matrix:
        """What is kept at every communication point of steps of these sizes [s], a row each."""
        steps = accumulate(sizes, lambda x, h: self.step(scheme, h)[0] @ x, initial=self.start)
        return np.array([*steps])

    def states(self, scheme: Scheme, sizes: Sequence[float]) -> Matrix:
        """The states at every communication point, shape (steps + 1, states)."""
        return self.run(scheme, sizes)[:, : len(self.x0)]

    def energy(self, scheme: Scheme, sizes: Sequence[float], bond: tuple[str, str]) -> Matrix:
        """What goes over a bond [J]: outputs times inputs of either side by the trapezoidal rule.

        What the first side gives and what the second takes, shape (2,).
        """
        kept = self.run(scheme, sizes)
        there, back = map(self.outputs.index, bond)
        total = np.zeros(2)
        for h in set(sizes):
            begun = kept[:-1][np.array(sizes) == h].T
            for turn in self.step(scheme, h)[1]:
                for side, (out, heard) in enumerate([(there, back), (back, there)]):
                    if turn.part == self.owner[out]:
                        port = self._port(turn.part, heard)
                        work = (turn.before[out] @ begun) * (turn.first[port] @ begun)
                        work += (turn.after[out] @ begun) * (turn.last[port] @ begun)
                        total[side] += turn.size / 2 * work.sum()
        return total

    def _port(self, part: int, output: int) -> int:
        """The input of a part that hears an output."""
        heard = np.flatnonzero(self.L[:, output])
        own = range(*self.u_of[part].indices(len(self.given)))
        return next(int(row) for row in heard if row in own)

    def radius(self, scheme: Scheme, h: float) -> float:
        """The spectral radius of a step, constant inputs left out."""
        return float(np.abs(self.eigenvalues(scheme, h)).max())

    def eigenvalues(self, scheme: Scheme, h: float) -> NDArray[np.complex128]:
        """The eigenvalues of a step, constant inputs left out."""
        return np.linalg.eigvals(self.step(scheme, h)[0][:-1, :-1]).astype(np.complex128)

    def _whole(self, h: float) -> Matrix:
        """The map of the coupled states, and a 1, over h [s]."""
        loop = np.linalg.inv(np.eye(len(self.given)) - self.L @ self.D)
        n = len(self.x0)
        rates = np.zeros((n + 1, n + 1))
        rates[:n, :n] = self.A + self.B @ loop @ self.L @ self.C
        rates[:n, n] = self.B @ loop @ self.given
        return expm(rates * h)

    def _flow(self, h: float) -> tuple[Matrix, Matrix, Matrix]:
        """E, G_0, G_1 of all parts side by side: x <- E x + G_0 u(0) + G_1 u(h)."""
        n, m = self.B.shape
        big = np.zeros((n + 2 * m, n + 2 * m))
        big[:n, :n], big[:n, n : n + m], big[n : n + m, n + m :] = self.A * h, self.B * h, np.eye(m)
        whole = expm(big)[:n]
        G_1 = whole[:, n + m :]
        return whole[:, :n], whole[:, n : n + m] - G_1, G_1

    def _step(self, scheme: Scheme, h: float) -> tuple[Matrix, list[Exchange]]:
        """The map of a step of size h [s] and what the turns in it exchange."""
        n, k, m = len(self.x0), len(self.C), len(self.given)
        kept = n + 2 * k + m + 1
        x, y, past, held, one, end = np.split(np.eye(kept + k), np.cumsum([n, k, k, m, 1]).tolist())
        at, before = np.zeros(k), np.full(k, -h)
        algorithm = find_algorithm(scheme.algorithm)
        number = {str(part): part for part in self.parts}
        stages = algorithm.stages([*number])
        for name, part in number.items():
            ends = [turn.end for stage in stages for turn in stage if turn.part == name]
            before[self.y_of[part]] = (ends[-2] - 1.0 if len(ends) > 1 else -1.0) * h
        turns = []
        for stage in stages:
            ahead = algorithm.is_implicit
            nodes = (end, np.full(k, h), y, at) if ahead else (y, at, past, before)
            held_at = algorithm.end_weight * end + (1.0 - algorithm.end_weight) * y if ahead else y
            fresh, times = y.copy(), at.copy()
            x, held, past, before = x.copy(), held.copy(), past.copy(), before.copy()
            for name, begin, share in stage:
                part = number[name]
                own, port, out = self.x_of[part], self.u_of[part], self.y_of[part]
                pieces = scheme.substeps if part == self.parts[-1] else 1
                size = share * h / pieces
                E, G_0, G_1 = self.flow(size)
                heard = []
                for piece in range(pieces):
                    middle = begin * h + (piece + 0.5) * size
                    shown = _course(nodes, middle) if scheme.input_order else held_at
                    now = self.L @ shown + np.outer(self.given, one)
                    then = {0: now, 1: 2 * now - held, 2: now}[scheme.hold]
                    since = held if scheme.hold == 2 else now
                    x[own] = (E @ x + G_0 @ since + G_1 @ then)[own]
                    held[port] = now[port]
                    heard.append(now)
                fresh[out] = (self.C @ x + self.D @ then)[out]
                times[out] = (begin + share) * h
                past[out], before[out] = y[out], at[out]
                turns.append(Exchange(part, share * h, y, fresh, heard[0], heard[-1]))
            y, at = fresh, times
        loop = np.linalg.solve(np.eye(k) - y[:, kept:], y[:, :kept])

        def known(rows: Matrix) -> Matrix:
            return rows[:, :kept] + rows[:, kept:] @ loop

        step = known(np.concatenate([x, y, past, held, one]))
        return step, [Exchange(*turn[:2], *map(known, turn[2:])) for turn in turns]


def _course(nodes: tuple[Matrix, Matrix, Matrix, Matrix], time: float) -> Matrix:
    """The line through the two newest outputs at a time [s]."""
    new, at, old, before = nodes
    slope = (new - old) / (at - before)[:, None]
    shown: Matrix = new + slope * (time - at)[:, None]
    return shown
