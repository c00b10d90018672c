"""Sweeps: many cases of one system as a table of figures, each with its error on request."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .accuracy.certify import certify
from .engine.control import Adaptive, Mesh
from .engine.settings import RunSettings, StepAndStop
from .ensemble import Array, Cases, Ensemble, Member
from .journal import digest, open_journal
from .metrics import Metric
from .prepared import PLAIN, How, Prepared
from .result import Interrupted, Result, SimulationError
from .simulation import versions
from .system import Network, System
from .worker import Chunk, Worker

if TYPE_CHECKING:
    import pandas as pd

#: What the name of a figure's error is made of.
ERROR = "{} error"
#: Share of the memory for rows that a certified chunk may take in its first run. Chosen: its runs together have 1.75 times
#: those rows, and judging them takes a few copies.
CERTIFIED_SHARE = 1.0 / 7.0


def combinations(axes: Mapping[str, Sequence[Any]]) -> dict[str, list[Any]]:
    """Cases with all combinations of the values of several names.

    Parameters
    ----------
    axes : mapping
        Values by name.

    Examples
    --------
    >>> combinations({"motor.A": [7000, 8000], "motor.T": [0.05, 0.06]})
    {'motor.A': [7000, 7000, 8000, 8000], 'motor.T': [0.05, 0.06, 0.05, 0.06]}
    """
    rows = list(product(*axes.values()))
    return {name: [row[k] for row in rows] for k, name in enumerate(axes)}


def sample(bounds: Mapping[str, tuple[float, float]], number: int, seed: int = 0) -> dict[str, Any]:
    """Cases that fill the space between bounds evenly: a Latin hypercube of scipy.stats.qmc.

    Parameters
    ----------
    bounds : mapping
        The least and the largest value by name.
    number : int
        How many cases.
    seed : int
        Where the pseudo-random numbers begin; the same seed gives the same cases.
    """
    from scipy.stats import qmc

    unit = qmc.LatinHypercube(len(bounds), rng=np.random.default_rng(seed)).random(number)
    low, high = np.array(list(bounds.values()), float).T
    return dict(zip(bounds, (low + unit * (high - low)).T))


@dataclass(frozen=True)
class Figures:
    """What a worker makes of a chunk: the numbers of metrics, and if they are `certified` their errors."""

    metrics: Mapping[str, Metric]
    certified: bool = False

    @property
    def names(self) -> list[str]:
        """The names of the figures, each with its error behind it where there is one."""
        return [
            name
            for metric in self.metrics
            for name in ([metric, ERROR.format(metric)] if self.certified else [metric])
        ]

    def __call__(
        self, worker: Worker, cases: Cases, chunk: Chunk, progress: Callable[[int], None]
    ) -> Ensemble:
        """The ensemble of a chunk with figures in place of rows."""
        if not self.certified:
            block = worker.run(cases, chunk, progress)
            values = block.evaluate(self.metrics)
            made = [{name: float(x[k]) for name, x in values.items()} for k in range(len(block))]
            return replace(block, runs=[_with(run, x) for run, x in zip(block.runs, made)])
        block = worker.run(cases, chunk)
        runs, done = _Runs(worker, cases, chunk), list[Member]()
        try:
            for run in block.runs:
                at = int(np.flatnonzero(chunk.numbers == run.number)[0])
                failed = dict[str, float](), run.reason
                figures, reason = failed if run.reason else self._certified(runs, chunk, at)
                done.append(_with(run._replace(reason=reason), figures))
                progress(len(done))
                if worker.is_late():
                    break
        except KeyboardInterrupt:
            pass
        return replace(block, runs=done)

    def _certified(self, runs: _Runs, chunk: Chunk, at: int) -> tuple[dict[str, float], str]:
        """The figures of the member at a position of a chunk and their errors, and why some have none."""
        try:
            answer = certify(
                runs.system, self.metrics, step=chunk.spans[at].step, runner=partial(runs.result, int(chunk.numbers[at])),
                **runs.settings,
            )  # fmt: skip
        except SimulationError as error:
            return {}, str(error)
        values, wrong = {}, []
        for name, estimate in answer.figures.items():
            values[name] = estimate.value
            if estimate.error is None:
                wrong.append(f"{name}: {estimate.reason}")
            else:
                values[ERROR.format(name)] = estimate.error
        return values, "; ".join(wrong)


def _with(run: Member, figures: Mapping[str, float]) -> Member:
    """A member with figures in place of rows."""
    return run._replace(rows=run.rows[:0].copy(), figures=figures)


class _Runs:
    """The members of a chunk with other steps, as a runner of `certify` asks for them."""

    def __init__(self, worker: Worker, cases: Cases, chunk: Chunk) -> None:
        self._worker, self._cases, self._chunk = worker, cases, chunk
        self.system, plan = worker.setup.network.system, worker.setup.settings
        self.settings: dict[str, Any] = {
            "start": plan.start,
            "stop": plan.stop,
            "record": plan.record,
        }
        if chunk.output_step is not None:
            self.settings["output_step"] = chunk.output_step
        self._ensembles: dict[Any, Ensemble] = {}

    def result(
        self,
        number: int,
        _: System,
        *,
        step: float | Adaptive,
        output_step: float | None = None,
        all_rows: Path | None = None,
        **__: Any,
    ) -> Result:
        """The run of a member; its rows at all communication points go to the file `all_rows`."""
        if all_rows is not None:
            self._result(number, step, None).data.tofile(all_rows)
        return self._result(number, step, output_step)

    def _result(self, number: int, step: float | Adaptive, output_step: float | None) -> Result:
        """The run of a member, with rows so far apart [s]."""
        if isinstance(step, Mesh) and step.along:  # the steps of this member
            some = np.flatnonzero(self._chunk.numbers == number)
            ensemble = self._run(self._chunk.part(some), step, output_step)
        else:
            key = repr(step), output_step
            if key not in self._ensembles:
                self._ensembles[key] = self._run(self._chunk, step, output_step)
            ensemble = self._ensembles[key]
        found = np.flatnonzero(ensemble.members == number)
        if not len(found):
            raise KeyboardInterrupt
        result, reason = ensemble.result(found[0]), ensemble.reasons[found[0]]
        if reason:
            raise SimulationError(reason, result)
        return result

    def _run(self, chunk: Chunk, step: float | Adaptive, output_step: float | None) -> Ensemble:
        """The members of a chunk with a step and rows so far apart [s]."""
        spans = [StepAndStop(step, span.stop) for span in chunk.spans]
        return self._worker.run(self._cases, chunk._replace(spans=spans, output_step=output_step))


def sweep(
    system: System,
    cases: Any,
    figures: Mapping[str, Metric],
    *,
    certified: bool = False,
    how: How = PLAIN,
    journal: Path | None = None,
    **settings: Any,
) -> pd.DataFrame:
    """Run a system for each case, and return a frame of pandas with a row for each: the case, figures, and their errors.

    Parameters
    ----------
    system : System
        What is run.
    cases : mapping or pandas frame
        Columns of start values by name, a row for each run; see `combinations` and `sample`.
    figures : mapping
        Metrics by name, such as `{"torque": Largest("motor.tau")}`.
    certified : bool
        Whether each figure gets its error, from runs with other steps, in a column behind it. The reason of a
        figure without one is in the column `reason`.
    how : How
        How many runs at a time, and where.
    journal : Path, optional
        A file that keeps what is done until the sweep ends, so that the same call goes on after any end.
    **settings
        Those of `run`, without `record`.

    Returns
    -------
    DataFrame
        A row for each case. That of a run which failed has no figures, and the `reason`; `warnings` are those of
        the FMUs.

    Raises
    ------
    SetupError
        For a system, cases or settings that cannot be run, and for the journal of other runs.
    Interrupted
        With the rows that are done, after Ctrl-C.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cosim import System, sweep
    >>> from cosim.metrics import Largest
    >>> motor = System({"motor": Path("fmus/native/DriveMotor.fmu")})
    >>> table = sweep(motor, {"motor.A": [7000, 8000]}, {"torque": Largest("motor.tau")}, stop=0.1, step=0.01)
    >>> list(table)
    ['motor.A', 'torque', 'warnings', 'reason']
    """
    wanted = Figures(figures, certified)
    columns = list(dict.fromkeys(c for metric in figures.values() for c in metric.columns))
    plan = RunSettings(**{**settings, "record": columns})
    with Prepared.open(system, plan) as prepared:
        read = Cases.of(cases, prepared.network)
        recorded = {column.name: column for column in prepared.setup.columns}
        for metric in figures.values():
            metric.check(recorded, plan.start, plan.stop)
        identity = _identity(prepared.network, plan, read, wanted)

        def is_row(number: int, row: Array, text: str) -> bool:
            return (
                number in range(read.members)
                and len(row) == len(wanted.names)
                and _is_reason_and_warnings(text)
            )

        with open_journal(journal, identity, is_row) as kept:
            rest = np.setdiff1d(np.arange(read.members), list(kept.rows))
            share = how.share * (CERTIFIED_SHARE if certified else 1.0)
            its = replace(how, evaluate=wanted, numbers=rest, share=share)
            for block in prepared.blocks(read, its) if len(rest) else ():
                values = [
                    [run.figures.get(n, math.nan) for n in wanted.names] for run in block.runs
                ]
                texts = [json.dumps([run.reason, "; ".join(run.warnings)]) for run in block.runs]
                kept.add(block.members.tolist(), np.array(values), texts)
            table = _table(read, wanted, kept.rows)
            table.attrs.update(identity)
            if len(table) < read.members:
                where = "" if journal is None else f" in {journal}; the same command goes on"
                text = f"{len(table)} of {read.members} runs{where}"
                raise Interrupted(text, table)
    return table


def _is_reason_and_warnings(text: str) -> bool:
    """Whether a text can be the reason of a member and its warnings, as one."""
    try:
        texts = json.loads(text)
    except (ValueError, RecursionError):
        return False
    return isinstance(texts, list) and [type(x) for x in texts] == [str, str]


def _table(cases: Cases, figures: Figures, rows: Mapping[int, tuple[Array, str]]) -> pd.DataFrame:
    """The runs that are done, in the order of the cases."""
    import pandas as pd

    numbers = sorted(rows)
    columns: dict[str, Any] = {
        name: column[numbers] for name, column in zip(cases.names, cases.columns)
    }
    values = np.reshape([rows[k][0] for k in numbers], (len(numbers), len(figures.names)))
    columns |= {name: values[:, k] for k, name in enumerate(figures.names)}
    texts = [json.loads(rows[k][1]) for k in numbers]
    columns |= {"warnings": [text[1] for text in texts], "reason": [text[0] for text in texts]}
    return pd.DataFrame(columns, index=numbers)


def _identity(
    network: Network, settings: RunSettings, cases: Cases, figures: Figures
) -> dict[str, Any]:
    """What makes the rows of a sweep: files, values, settings and versions."""
    content = repr([(name, column.tolist()) for name, column in zip(cases.names, cases.columns)])
    system = network.system
    return {
        "FMUs": {name: digest(fmu.path.read_bytes()) for name, fmu in network.fmus.items()},
        "wires": [str(wire) for wire in system.wires],
        "start values": repr(dict(system.start)),
        "inputs": repr({port.name: profile.provenance() for port, profile in network.inputs}),
        "changes": list(system.changes),
        "settings": repr(settings),
        "cases": digest(content.encode()),
        "figures": repr(figures),
        "versions": versions(),
    }
