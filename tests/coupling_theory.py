"""Co-simulation as linear algebra: what each algorithm makes of coupled linear parts, without FMUs.

A part is a linear system, and wires and constants make the inputs of all parts:

    x' = A x + B u,   y = C x + D u,   u = L y + c

For all parts side by side A, B, C and D are block diagonal, with n states, m inputs and k outputs:
A is (n, n), B is (n, m), C is (k, n), D is (k, m). L is (m, k), with a 1 where an output drives an
input, and c is (m,). Without a master the coupled system follows from the elimination of u:

    u = (I - L D)^-1 (L C x + c)

Under a master, each part integrates exactly from an input that is a straight line, from u_0 at the
beginning to u_1 at the end of h:

    x(h) = E x(0) + G_0 u_0 + G_1 u_1

E, G_0 and G_1 are blocks of one matrix exponential (C. F. Van Loan, Computing integrals involving
the matrix exponential, IEEE Transactions on Automatic Control 23, 1978).

What the parts and the master remember from one communication step to the next is the vector

    z = (x, y, y_old, u_old, 1)

of the states, the outputs, the outputs before these, and the inputs that were set last; the 1
carries c. All that happens in a step is linear in z, so the step of any algorithm is a matrix M:
z <- M z. Its powers are the run, and its eigenvalues decide on stability (R. Kübler and W.
Schiehlen, Two methods of simulator coupling, Mathematical and Computer Modelling of Dynamical
Systems 6, 2000).

M follows from the stages of the algorithm, which the engine carries out too. A stage is a set of
turns, and a turn is a part's integration over a fraction of the step. The turns of a stage do not
see each other's outputs; the next stage does. The step is taken with the unit matrix in place of z,
so that each quantity becomes the matrix by which it follows from z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from cosim.engine.algorithms import Stage, find_algorithm

Matrix = NDArray[np.float64]
Rows = Sequence[Sequence[float]]
#: The `input_hold` of FMUs that extrapolate an input within a step, a convention of `fmukit`.
EXTRAPOLATE = 1
#: The `input_hold` of FMUs that interpolate an input within a step, a convention of `fmukit`.
INTERPOLATE = 2


@dataclass(frozen=True)
class LinearPart:
    """A part x' = A x + B u, y = C x + D u.

    Parameters
    ----------
    A, B, C
        Its matrices, row by row.
    x
        The states at the start.
    u
        For each input its source "part.output", with outputs counted from 1, or a constant.
    D
        The direct feedthrough, zeros if it is not stated.
    """

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
    """An algorithm with the settings that decide what inputs do within a step.

    Parameters
    ----------
    algorithm
        The name of a coupling algorithm.
    input_order
        The degree of the polynomials that the master forms for inputs: 0 holds them, 1 is the line
        through two values of the source, of which a part receives the mean over its step.
    hold
        How the FMUs themselves continue an input within a step, their `input_hold`: 0 hold, 1
        extrapolate, 2 interpolate.
    substeps
        The number of steps that the last part takes within one.
    """

    algorithm: str
    input_order: int = 0
    hold: int = 0
    substeps: int = 1


class Exchange(NamedTuple):
    """What a part exchanges in a turn of this size [s]: outputs before and after it, and inputs.

    Each matrix gives these from z at the beginning of the step. The inputs are those of the first
    and of the last substep in the turn.
    """

    part: int
    size: float
    y_before: Matrix
    y_after: Matrix
    u_first: Matrix
    u_last: Matrix


class OutputLines(NamedTuple):
    """Straight lines through two values of each output, which belong to times [s], shape (k,)."""

    y: Matrix
    t: Matrix
    y_old: Matrix
    t_old: Matrix

    def at(self, time: float) -> Matrix:
        """The outputs on these lines at a time [s]."""
        slope = (self.y - self.y_old) / (self.t - self.t_old)[:, None]
        outputs: Matrix = self.y + slope * (time - self.t)[:, None]
        return outputs


@dataclass(frozen=True)
class Progress:
    """The quantities of z after some stages of a step.

    Each matrix gives a quantity from z at the beginning of the step and, in k further columns, from
    the outputs at its end, on which the inputs of implicit algorithms depend.

    Parameters
    ----------
    x, y, y_old, u_old
        The quantities of z.
    t, t_old
        The times [s] that `y` and `y_old` belong to, from the beginning of the step, shape (k,).
    """

    x: Matrix
    y: Matrix
    y_old: Matrix
    u_old: Matrix
    t: Matrix
    t_old: Matrix

    def copy(self) -> Progress:
        """The same with arrays of its own."""
        return replace(self, **{name: value.copy() for name, value in vars(self).items()})


class Ideal:
    """Coupled parts under an algorithm that is carried out exactly.

    Parameters
    ----------
    units : mapping
        The parts by name, in their stepping order.

    Attributes
    ----------
    A, B, C, D, L, c
        The matrices of the coupled system, see the top of the module.
    x0
        The states at the start, shape (n,).
    outputs
        The names of the outputs, "part.output".
    """

    def __init__(self, units: Mapping[str, LinearPart]) -> None:
        parts = list(units.values())
        self.A, self.B, self.C, self.D = (
            block_diag(*blocks) for blocks in zip(*((u.A, u.B, u.C, u.feedthrough) for u in parts))
        )
        self.x0 = np.concatenate([u.x for u in parts]).astype(float)
        self.outputs = [f"{name}.{i + 1}" for name, u in units.items() for i in range(len(u.C))]
        sources = [source for u in parts for source in u.u]
        self.L = np.zeros((len(sources), len(self.outputs)))
        self.c = np.zeros(len(sources))
        for row, source in enumerate(sources):
            if isinstance(source, str):
                self.L[row, self.outputs.index(source)] = 1.0
            else:
                self.c[row] = source
        self.parts = range(len(parts))
        self.x_of, self.u_of, self.y_of = (
            [slice(*bounds) for bounds in pairwise(np.cumsum([0, *sizes]).tolist())]
            for sizes in zip(*((len(u.x), len(u.u), len(u.C)) for u in parts))
        )
        self.owner = [p for p in self.parts for _ in parts[p].C]
        self.coupled_flow = lru_cache(maxsize=None)(self._coupled_flow)
        self.part_flow = lru_cache(maxsize=None)(self._part_flow)
        self.step = lru_cache(maxsize=None)(self._step)

    @property
    def start(self) -> Matrix:
        """The vector z at the start, where the inputs agree with the outputs."""
        loop = np.eye(len(self.c)) - self.L @ self.D
        u = np.linalg.solve(loop, self.L @ self.C @ self.x0 + self.c)
        y = self.C @ self.x0 + self.D @ u
        return np.concatenate([self.x0, y, y, u, [1.0]])

    @property
    def coupled_rates(self) -> Matrix:
        """The matrix of the coupled system without a master, shape (n + 1, n + 1).

        It maps (x, 1) to (x', 0), with x' = A x + B (I - L D)^-1 (L C x + c).
        """
        loop = np.linalg.inv(np.eye(len(self.c)) - self.L @ self.D)
        n = len(self.x0)
        rates = np.zeros((n + 1, n + 1))
        rates[:n, :n] = self.A + self.B @ loop @ self.L @ self.C
        rates[:n, n] = self.B @ loop @ self.c
        return rates

    def exact(self, sizes: Sequence[float]) -> Matrix:
        """The states without a master, after steps of these sizes [s], shape (steps + 1, n)."""
        start = np.append(self.x0, 1.0)
        rows = accumulate(sizes, lambda x, h: self.coupled_flow(h) @ x, initial=start)
        return np.array([*rows])[:, :-1]

    def run(self, scheme: Scheme, sizes: Sequence[float]) -> Matrix:
        """The vector z at every communication point of steps of these sizes [s], a row each."""
        rows = accumulate(sizes, lambda z, h: self.step(scheme, h)[0] @ z, initial=self.start)
        return np.array([*rows])

    def states(self, scheme: Scheme, sizes: Sequence[float]) -> Matrix:
        """The states at every communication point, shape (steps + 1, n)."""
        return self.run(scheme, sizes)[:, : len(self.x0)]

    def eigenvalues(self, scheme: Scheme, h: float) -> NDArray[np.complex128]:
        """The eigenvalues of M for a step of h [s], without the 1 of the constants."""
        return np.linalg.eigvals(self.step(scheme, h)[0][:-1, :-1]).astype(np.complex128)

    def radius(self, scheme: Scheme, h: float) -> float:
        """The largest absolute value of these eigenvalues: above 1 the run is unstable."""
        return float(np.abs(self.eigenvalues(scheme, h)).max())

    def energy(self, scheme: Scheme, sizes: Sequence[float], bond: tuple[str, str]) -> Matrix:
        """The work [J] that a bond of two outputs transfers, shape (2,).

        It is what the first side supplies and what the second takes. Each side multiplies its
        output by its input, and integrates over its turns by the trapezoidal rule.
        """
        z = self.run(scheme, sizes)[:-1]
        first, second = map(self.outputs.index, bond)
        total = np.zeros(2)
        for h in set(sizes):
            z_h = z[np.array(sizes) == h].T
            for turn in self.step(scheme, h)[1]:
                for side, (output, source) in enumerate([(first, second), (second, first)]):
                    if turn.part == self.owner[output]:
                        port = self._input_driven_by(turn.part, source)
                        work = (turn.y_before[output] @ z_h) * (turn.u_first[port] @ z_h)
                        work += (turn.y_after[output] @ z_h) * (turn.u_last[port] @ z_h)
                        total[side] += turn.size / 2 * work.sum()
        return total

    def _input_driven_by(self, part: int, output: int) -> int:
        """The input of a part that an output drives."""
        ports = range(*self.u_of[part].indices(len(self.c)))
        return next(int(row) for row in np.flatnonzero(self.L[:, output]) if row in ports)

    def _coupled_flow(self, h: float) -> Matrix:
        """The map of (x, 1) over h [s] without a master."""
        return expm(self.coupled_rates * h)

    def _part_flow(self, h: float) -> tuple[Matrix, Matrix, Matrix]:
        """E, G_0 and G_1 of all parts side by side, over h [s].

        With P = int_0^h exp(A (h - s)) B ds and Q = int_0^h exp(A (h - s)) B s / h ds, the matrix
        exponential of [[A h, B h, 0], [0, 0, I], [0, 0, 0]] has E, P and Q as its first n rows. An
        input u_0 + (u_1 - u_0) s / h gives G_0 = P - Q and G_1 = Q.
        """
        n, m = self.B.shape
        block = np.zeros((n + 2 * m, n + 2 * m))
        block[:n, :n], block[:n, n : n + m] = self.A * h, self.B * h
        block[n : n + m, n + m :] = np.eye(m)
        E, P, Q = np.split(expm(block)[:n], [n, n + m], axis=1)
        return E, P - Q, Q

    def _step(self, scheme: Scheme, h: float) -> tuple[Matrix, list[Exchange]]:
        """M of a step of h [s], and what the turns in it exchange.

        An implicit algorithm needs the outputs at the end, y = Y z + Y_end y, which are eliminated:
        y = (I - Y_end)^-1 Y z. An explicit one has Y_end = 0.
        """
        n, k, m = len(self.x0), len(self.outputs), len(self.c)
        size = n + 2 * k + m + 1
        x, y, y_old, u_old, unit, y_end = np.split(
            np.eye(size + k), np.cumsum([n, k, k, m, 1]).tolist()
        )
        algorithm = find_algorithm(scheme.algorithm)
        stages = algorithm.stages([str(part) for part in self.parts])
        progress = Progress(x, y, y_old, u_old, np.zeros(k), self._old_times(stages, h))
        exchanges: list[Exchange] = []
        for stage in stages:
            y, t = progress.y, progress.t
            if algorithm.is_implicit:
                line = OutputLines(y_end, np.full(k, h), y, t)
                fixed = algorithm.end_weight * y_end + (1.0 - algorithm.end_weight) * y
            else:
                line, fixed = OutputLines(y, t, progress.y_old, progress.t_old), y
            after = progress.copy()
            for name, begin, fraction in stage:
                part = int(name)
                pieces = scheme.substeps if part == self.parts[-1] else 1
                substep = fraction * h / pieces
                middles = [begin * h + (i + 0.5) * substep for i in range(pieces)]
                means = [line.at(middle) if scheme.input_order else fixed for middle in middles]
                inputs = [self.L @ mean + np.outer(self.c, unit) for mean in means]
                self._take_turn(part, inputs, scheme.hold, fraction * h, after)
                out = self.y_of[part]
                after.t[out] = (begin + fraction) * h
                after.y_old[out], after.t_old[out] = y[out], t[out]
                exchanges.append(Exchange(part, fraction * h, y, after.y, inputs[0], inputs[-1]))
            progress = after
        y = progress.y
        y_of_z = np.linalg.solve(np.eye(k) - y[:, size:], y[:, :size])

        def eliminate(rows: Matrix) -> Matrix:
            """Rows that act on z alone."""
            return rows[:, :size] + rows[:, size:] @ y_of_z

        z = np.concatenate([progress.x, y, progress.y_old, progress.u_old, unit])
        return eliminate(z), [Exchange(*each[:2], *map(eliminate, each[2:])) for each in exchanges]

    def _old_times(self, stages: Sequence[Stage], h: float) -> Matrix:
        """The times [s] of the outputs before the newest, at the beginning of a step of h [s].

        A part with several turns has shown them at the end of its last turn but one, any other at
        the beginning of the step before.
        """
        times = np.empty(len(self.outputs))
        for part in self.parts:
            ends = [
                turn.end_fraction for stage in stages for turn in stage if turn.part == str(part)
            ]
            times[self.y_of[part]] = (ends[-2] - 1.0 if len(ends) > 1 else -1.0) * h
        return times

    def _take_turn(
        self, part: int, inputs: Sequence[Matrix], hold: int, size: float, progress: Progress
    ) -> None:
        """Take a part over its turn of a size [s], in as many equal pieces as there are inputs."""
        x, u, y = self.x_of[part], self.u_of[part], self.y_of[part]
        E, G_0, G_1 = self.part_flow(size / len(inputs))
        for value in inputs:
            u_1 = 2 * value - progress.u_old if hold == EXTRAPOLATE else value
            u_0 = progress.u_old if hold == INTERPOLATE else value
            progress.x[x] = (E @ progress.x + G_0 @ u_0 + G_1 @ u_1)[x]
            progress.u_old[u] = value[u]
        progress.y[y] = (self.C @ progress.x + self.D @ u_1)[y]
