"""Linearise a coupled system about a working point: eigenmodes, frequency response, plots.

Small deviations from the working point follow the linear state space model

    dx' = A dx + B du,   dy = C dx + D du

of n states x, m inputs u and k outputs y: A is (n, n), B is (n, m), C is (k, n), D is (k, m). It
follows from the same matrices of the parts, whose wires give u = F y + v, where F (m, k) holds their
factors and v is what is added to the inputs from outside. Elimination of y leaves

    u = (I - F D)^-1 (F C x + v)

and so, with K = (I - F D)^-1, the matrices A + B K F C, B K, C + D K F C and D K of the coupled
system, from v to y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..accuracy.coupled_ode import CoupledOde
from ..accuracy.reference import DEFAULT_TOLERANCE, travel
from ..errors import FmuError, SetupError
from ..fmu.exchange import Array
from ..system import System, connect

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Complex = NDArray[np.complex128]
#: Relative size below which a rate, an eigenvalue or its real part counts as zero: a convention of this
#: project, which limits how slow a motion beside the fastest one may be.
STILL = 1e-9
#: Decades that a frequency response is drawn beyond the slowest and the fastest mode: a convention.
DECADES = 1.0
#: Points of a drawn curve: a convention, 100 for each of MOST_PERIODS.
SAMPLES = 2000
#: Time constants of the slowest mode that a step response is drawn for: derived from exp(-7) = 0.0009, as
#: little as a chart shows.
SPAN = 7.0
#: Most periods of the fastest mode in a step response: a convention, so that each can be seen.
MOST_PERIODS = 20


@dataclass(frozen=True, repr=False)
class Linear:
    """dx' = A dx + B du, dy = C dx + D du: small deviations from a working point.

    Attributes
    ----------
    A, B, C, D
        The matrices, with a row for each state (A, B) or output (C, D), and a column for each state
        (A, C) or input (B, D).
    states, inputs, outputs
        The names of rows and columns.
    units
        The unit of each state, input and output.
    point
        Their values at the working point.
    rates
        The derivatives of the states there, in the states' units per second: the point is at rest
        only if they are zero.
    time
        The time of the working point [s].
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: list[str]
    inputs: list[str]
    outputs: list[str]
    units: dict[str, str]
    point: dict[str, float]
    rates: dict[str, float]
    time: float

    @property
    def eigenvalues(self) -> Complex:
        """The eigenvalues of A [1/s], slowest first, with conjugate pairs side by side."""
        s = np.linalg.eigvals(self.A).astype(complex)
        return s[np.lexsort((s.imag, s.real, np.abs(s).round(9)))]

    @property
    def modes(self) -> pd.DataFrame:
        """Eigenvalue s [1/s], natural frequency abs(s) [rad/s], damping ratio -Re s / abs(s); one row a pair."""
        import pandas as pd

        s = self.eigenvalues
        s = s[s.imag >= 0.0]
        frequency = np.abs(s)
        ratio = -s.real / np.where(frequency > 0.0, frequency, np.nan)
        columns = {"eigenvalue [1/s]": s, "frequency [rad/s]": frequency, "damping ratio": ratio}
        return pd.DataFrame(columns)

    def frame(self, matrix: str) -> pd.DataFrame:
        """A, B, C or D with the names and units of its rows and columns.

        Parameters
        ----------
        matrix : str
            "A", "B", "C" or "D".
        """
        import pandas as pd

        rows = self.states if matrix in "AB" else self.outputs
        columns = self.states if matrix in "AC" else self.inputs
        index, header = (
            [f"{name} [{self.units[name] or '1'}]" for name in names] for names in (rows, columns)
        )
        return pd.DataFrame(getattr(self, matrix), index, header)

    def frequency_response(self, input: str, output: str, w: Any) -> Complex:
        """The frequency response C (i w I - A)^-1 B + D from an input to an output.

        It has the shape of w and the output's unit per the input's. Raises SetupError for an unknown
        name.

        Parameters
        ----------
        input : str
            The dotted name of an input.
        output : str
            The dotted name of an output.
        w : array_like
            Angular frequencies [rad/s].
        """
        b, c, d = self._between(input, output)
        s = 1j * np.asarray(w, float)[..., None, None]
        x = np.linalg.solve(s * np.eye(len(self.A)) - self.A, b[:, None].astype(complex))
        response: Complex = (x[..., 0] @ c) + d
        return response

    def step_response(self, input: str, output: str, t: Any) -> Array:
        """The response of an output to a unit step of an input at 0 s.

        Under a constant input the state and the input, (x, u), follow the matrix exponential of
        [[A, B], [0, 0]]. The response has the shape of t and the output's unit. Raises SetupError for
        an unknown name.

        Parameters
        ----------
        input : str
            The dotted name of an input.
        output : str
            The dotted name of an output.
        t : array_like
            Times after the step [s].
        """
        from scipy.linalg import expm

        b, c, d = self._between(input, output)
        augmented = np.block([[self.A, b[:, None]], [np.zeros((1, len(b) + 1))]])
        x = expm(augmented * np.asarray(t, float)[..., None, None])[..., :-1, -1]
        return np.asarray(x @ c + d)

    def plot(
        self, input: str, output: str, path: Path | str | None = None, *, span: float | None = None
    ) -> Figure:
        """Draw the Bode diagram and the step response from an input to an output.

        Parameters
        ----------
        input : str
            The dotted name of an input.
        output : str
            The dotted name of an output.
        path : path, optional
            The file that the figure is written to.
        span : float, optional
            The duration of the step response [s], by default until the slowest mode has decayed, but
            at most some periods of the fastest mode.
        """
        from ..picture import Picture

        frequencies = self._nonzero_frequencies()
        margin = 10.0**DECADES
        w = np.geomspace(frequencies.min() / margin, frequencies.max() * margin, SAMPLES)
        response = self.frequency_response(input, output, w)
        t = np.linspace(0.0, self._settling_time() if span is None else span, SAMPLES)
        y = self.step_response(input, output, t)
        figure = Picture(figsize=(9, 8), layout="constrained")
        axes = figure.subplots(3)
        gain = np.abs(response)
        axes[0].loglog(w, np.where(gain > 0.0, gain, np.nan))
        axes[1].semilogx(w, np.degrees(np.unwrap(np.angle(response))))
        axes[2].plot(t, y)
        per = f"{self.units[output] or '1'} / ({self.units[input] or '1'})"
        for axis, label in zip(axes, (f"gain / {per}", "phase / deg", f"unit step / {per}")):
            axis.set_ylabel(label)
            axis.grid(alpha=0.3)
        axes[1].set_xlabel("angular frequency / (rad/s)")
        axes[2].set_xlabel("time / s")
        axes[0].set_title(f"{input} to {output}", fontsize="small", loc="left")
        figure.write(path)
        return figure

    def __repr__(self) -> str:
        moving = [
            f"{name} at {rate:.6g} {self.units[name]} per s"
            for name, rate in self.rates.items()
            if abs(rate) > STILL * max(1.0, abs(self.point[name]))
        ]
        rest = f"not at rest, {', '.join(moving)}" if moving else "at rest"
        sizes = f"{len(self.states)} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"
        return f"Linear({sizes}; t = {self.time!r} s, {rest})\n{self.modes.to_string(index=False)}"

    def _nonzero_frequencies(self) -> Array:
        """The natural frequencies [rad/s] but for those that count as zero; 1 rad/s if all do."""
        frequencies = np.abs(self.eigenvalues)
        if not frequencies.any():
            return np.ones(1)
        nonzero: Array = frequencies[frequencies > STILL * frequencies.max()]
        return nonzero

    def _settling_time(self) -> float:
        """The duration of a step response [s]: until the slowest mode has decayed, see SPAN."""
        fastest = self._nonzero_frequencies().max()
        decays = np.abs(self.eigenvalues.real)
        slowest = decays.min(initial=fastest, where=decays > STILL * fastest)
        return float(min(SPAN / slowest, MOST_PERIODS * 2 * np.pi / fastest))

    def _between(self, input: str, output: str) -> tuple[Array, Array, float]:
        """The column of B, the row of C and the element of D from an input to an output."""
        for name, names in ((input, self.inputs), (output, self.outputs)):
            if name not in names:
                raise SetupError(f"{name} is not one of {', '.join(names) or 'none'}")
        i, o = self.inputs.index(input), self.outputs.index(output)
        return self.B[:, i], self.C[o], float(self.D[o, i])


def linearize(
    system: System, *, inputs: Sequence[str] | None = None, start: float = 0.0, at: float = 0.0
) -> Linear:
    """Linearise the coupled system about its start values, from the model-exchange sides of its parts.

    The outputs are all Real outputs. Derivatives come from the FMUs where they offer directional
    derivatives, else from central differences. Discrete variables, and the active side of each event, keep
    their values.

    Parameters
    ----------
    system : System
        The coupled system; each part needs a model-exchange side.
    inputs : sequence of str, optional
        The names of the inputs, by default all Real inputs that no wire drives. An input that a wire drives
        stands for a value that is added to the wire.
    start : float
        The time of the start values [s].
    at : float
        The time from there to the working point [s], which the reference solution passes through.

    Returns
    -------
    Linear
        The linear system, whose inputs have the sequence of `inputs`.

    Raises
    ------
    SetupError
        If a part has no model exchange, an input is unknown, or an algebraic loop has no solution.
    """
    if not 0.0 <= at < math.inf:
        raise SetupError(f"at = {at!r} s must be a finite number of at least 0")
    network = connect(system)
    ports = None if inputs is None else [network.port(name) for name in inputs]
    for port in ports or ():
        if port.variable.causality != "input" or port.type != "Real":
            raise SetupError(f"{port} is not a Real input")
    try:
        with CoupledOde.open(network, start, start + at) as ode:
            for _ in travel(ode, start + at, "DOP853", DEFAULT_TOLERANCE):
                pass
            A, B, C, D, F = blocks = ode.blocks()
            K = np.linalg.inv(ode.loop_matrix(blocks))
            rates = ode.slopes(ode.t, ode.x).tolist()
            variables = [*ode.states, *ode.inputs, *ode.outputs]
            values = {name: model.instance.session.values for name, model in ode.models.items()}
            point = {p.name: float(*values[p.part]([p.variable]).values()) for p in variables}
    except FmuError as failure:
        raise SetupError(str(failure)) from failure
    states, entries, outputs = (
        [port.name for port in each] for each in (ode.states, ode.inputs, ode.outputs)
    )
    wired = {target.name for _, target, *_ in network.wires}
    chosen = [name for name in entries if name not in wired]
    if ports is not None:
        chosen = [port.name for port in ports]
    columns = [entries.index(name) for name in chosen]
    B, D = B @ K, D @ K  # those that v acts through
    return Linear(
        A + B @ F @ C,
        B[:, columns],
        C + D @ F @ C,
        D[:, columns],
        states=states,
        inputs=chosen,
        outputs=outputs,
        units={port.name: port.unit for port in variables},
        point=point,
        rates=dict(zip(states, rates)),
        time=start + at,
    )
