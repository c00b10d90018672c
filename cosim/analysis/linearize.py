"""Linearise a coupled system about a working point: modes, frequency response, plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..accuracy.coupled_ode import opened
from ..accuracy.reference import TOLERANCE, travel
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
    """dx' = A dx + B du, dy = C dx + D du: small deviations from a working point at `time` [s].

    `states`, `inputs` and `outputs` name the rows and columns; `units` gives the unit of each. `point`
    gives the values of all of them there, and `rates` those of the states' derivatives, in the states'
    units per second: the point is at rest only if they are zero.
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
        """Eigenvalue [1/s], natural frequency `|s|` [rad/s], damping ratio `-Re s/|s|`; a pair as one."""
        import pandas as pd

        s = self.eigenvalues
        s = s[s.imag >= 0.0]
        size = np.where(np.abs(s) > 0.0, np.abs(s), np.nan)
        columns = {"eigenvalue [1/s]": s, "frequency [rad/s]": np.abs(s)}
        return pd.DataFrame(columns | {"damping ratio": -s.real / size})

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
        index, heads = (
            [f"{n} [{self.units[n] or '1'}]" for n in names] for names in (rows, columns)
        )
        return pd.DataFrame(getattr(self, matrix), index, heads)

    def frequency_response(self, input: str, output: str, w: Any) -> Complex:
        """C (i w - A)^-1 B + D from an input to an output at angular frequencies w [rad/s].

        In the output's unit per the input's; shape of w. Raises SetupError for an unknown name.

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
        """What an output does after a unit step of an input at 0 s, at times t [s]; shape of t.

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
        held = np.block([[self.A, b[:, None]], [np.zeros((1, len(b) + 1))]])
        x = expm(held * np.asarray(t, float)[..., None, None])[..., :-1, -1]
        return np.asarray(x @ c + d)

    def plot(
        self, input: str, output: str, path: Path | str | None = None, *, span: float | None = None
    ) -> Figure:
        """Bode diagram and step response from an input to an output; `path` also writes a file.

        The response lasts `span` [s], by default until the slowest mode has decayed, but at most some
        periods of the fastest.

        Parameters
        ----------
        input : str
            The dotted name of an input.
        output : str
            The dotted name of an output.
        path : path, optional
            The file that the figure is written to.
        span : float, optional
            How long the step response lasts [s].
        """
        from ..picture import Picture

        sizes = np.abs(self.eigenvalues)
        sizes = sizes[sizes > STILL * sizes.max(initial=0.0)] if sizes.any() else np.ones(1)
        wide = 10.0**DECADES
        w = np.geomspace(sizes.min() / wide, sizes.max() * wide, SAMPLES)
        response = self.frequency_response(input, output, w)
        decays = np.abs(self.eigenvalues.real)
        slowest = decays.min(initial=sizes.max(), where=decays > STILL * sizes.max())
        shown = min(SPAN / slowest, MOST_PERIODS * 2 * np.pi / sizes.max())
        t = np.linspace(0.0, shown if span is None else span, SAMPLES)
        y = self.step_response(input, output, t)
        figure = Picture(figsize=(9, 8), layout="constrained")
        axes = figure.subplots(3)
        axes[0].loglog(w, np.abs(response))
        axes[1].semilogx(w, np.degrees(np.unwrap(np.angle(response))))
        axes[2].plot(t, y)
        per = f"{self.units[output] or '1'} / ({self.units[input] or '1'})"
        for axis, label in zip(axes, (f"gain / {per}", "phase / deg", f"unit step / {per}")):
            axis.set_ylabel(label)
            axis.grid(alpha=0.3)
        axes[1].set_xlabel("angular frequency / (rad/s)")
        axes[2].set_xlabel("time / s")
        axes[0].set_title(f"{input} to {output}", fontsize="small", loc="left")
        if path is not None:
            figure.savefig(path, dpi=150)
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

    def _between(self, input: str, output: str) -> tuple[Array, Array, float]:
        for name, known in ((input, self.inputs), (output, self.outputs)):
            if name not in known:
                raise SetupError(f"{name} is not one of {', '.join(known) or 'none'}")
        i, o = self.inputs.index(input), self.outputs.index(output)
        return self.B[:, i], self.C[o], float(self.D[o, i])


def linearize(
    system: System, *, inputs: Sequence[str] | None = None, start: float = 0.0, at: float = 0.0
) -> Linear:
    """Linearise the coupled system about its start values, from the model-exchange sides of its parts.

    With `at` [s], the working point is the one that the oracle's run from `start` reaches after that time.

    `inputs` are the columns of B and D, by default the Real inputs that no wire drives. The column of an
    input that a wire drives stands for a value added to the wire. The outputs are all Real outputs.

    The parts' x' = A x + B u, y = C x + D u and the wires u = F y + v give

        u = (I - F D)^-1 (F C x + v)

    Derivatives come from the FMUs where they offer directional derivatives, else from central differences.
    Discrete variables, and the active side of each event, stay as they are. Raises SetupError for a part
    without model exchange, an unknown input, and an algebraic loop without a solution.

    Parameters
    ----------
    system : System
        What is linearised; each part needs a model-exchange side.
    inputs : sequence of str, optional
        The columns of B and D.
    start : float
        When the oracle's run begins [s].
    at : float
        How long after that the working point is [s].
    """
    if not 0.0 <= at < math.inf:
        raise SetupError(f"at = {at!r} s must be a finite number of at least 0")
    network = connect(system)
    ports = None if inputs is None else [network.port(name) for name in inputs]
    for port in ports or ():
        if port.variable.causality != "input" or port.type != "Real":
            raise SetupError(f"{port} is not a Real input")
    try:
        with opened(network, start, start + at) as whole:
            for _ in travel(whole, start + at, "DOP853", TOLERANCE):
                pass
            blocks = whole.blocks()
            inverse = np.linalg.inv(whole.closure(blocks))
            rates = whole.slopes(whole.t, whole.x)
            names = [[p.name for p in g] for g in (whole.states, whole.inputs, whole.outputs)]
            known = [*whole.states, *whole.inputs, *whole.outputs]
            values = {name: model.instance.access.values for name, model in whole.models.items()}
            point = {p.name: float(*values[p.part]([p.variable]).values()) for p in known}
    except FmuError as failure:
        raise SetupError(str(failure)) from failure
    states, entries, outputs = names
    wired = {target.name for _, target, *_ in network.wires}
    chosen = [name for name in entries if name not in wired]
    if ports is not None:
        chosen = [port.name for port in ports]
    columns = [entries.index(name) for name in chosen]
    A, B, C, D, F = blocks
    B, D = B @ inverse, D @ inverse
    A, C = A + B @ F @ C, C + D @ F @ C
    names_of = states, chosen, outputs, {port.name: port.unit for port in known}
    rising = dict(zip(states, rates.tolist()))
    return Linear(A, B[:, columns], C, D[:, columns], *names_of, point, rising, start + at)
