"""What the referee says of the results of other masters, and whether it is true: part of `masters.py --referee`.

Each result is judged by `cosim.referee` and, apart from that, by an integration of the whole system that knows
neither FMI nor the referee (`masters_truth.py`). A judgement is right if, for every signal, the verdict is the one that
the integration gives, and the difference that the referee states is the true one within the error that it states.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.masters_systems import Case, exchanged
from benchmarks.masters_truth import integrate, monolith
from cosim import RefereeReport, SetupError, referee
from cosim.accuracy.referee import TOLERANCE, Verdict

Array = NDArray[np.float64]
#: Share of the rows that must be beyond the tolerance for a signal to differ: a convention of the referee, 1 % of the
#: run. Where fewer rows are, but some, both verdicts are accepted.
LASTING = 0.01
#: Rounding of a difference, as a share of the largest value: derived, since the referee and the integration each
#: subtract values of double precision that are printed in full.
ROUNDING = 1e-12
#: Differences above this many ranges are called "grows": a convention of this benchmark.
LARGEST_SHARE = 10.0


@dataclass(frozen=True)
class Judgement:
    """What the referee said of a run of a master.

    Attributes
    ----------
    system, master : str
        Keys of the benchmark.
    step : float
        The communication step [s].
    verdict : str
        That of the referee; empty where the master gave no result.
    deviation, error : float
        Of the signal that is off most, as shares of its range.
    cause : str
        The cause that explains this signal, as a clause.
    reduction : float
        How many times smaller the difference is with it.
    wrong : tuple of str
        What the integration contradicts, a clause for each signal.
    margin : float
        The largest difference between the referee's statement and the truth over what is allowed.
    seconds : float
        Processor time of the referee [s].
    failure : str
        Why there is no result.
    """

    system: str
    master: str
    step: float
    verdict: str = ""
    deviation: float = 0.0
    error: float = 0.0
    cause: str = ""
    reduction: float = 0.0
    wrong: tuple[str, ...] = ()
    margin: float = 0.0
    seconds: float = 0.0
    failure: str = ""


def judge(key: str, case: Case, master: str, step: float, rows: Array) -> Judgement:
    """Judge the rows that a master wrote, and the judgement.

    Parameters
    ----------
    key, case
        The system.
    master : str
        Who ran it.
    step : float
        The communication step [s], which the referee is not told.
    rows : array of shape (rows, 1 + signals)
        Times [s] and the exchanged signals.
    """
    names = exchanged(case.system)
    frame = pd.DataFrame(rows, columns=["time", *names])
    began = time.process_time()
    try:
        report = referee(case.system, frame, stop=case.stop)
    except SetupError as refusal:
        return Judgement(key, master, step, failure=f"refused: {refusal}")
    seconds = time.process_time() - began
    worst = max(report.signals, key=lambda signal: signal.deviation / signal.scale)
    cause = report.explained(worst.name)
    wrong, margin = contradictions(key, case, report)
    return Judgement(
        key, master, step, str(report.verdict), worst.deviation / worst.scale, worst.error / worst.scale,
        cause.text if cause else "", cause.reduction if cause else 0.0, wrong, margin, seconds,
    )  # fmt: skip


def contradictions(key: str, case: Case, report: RefereeReport) -> tuple[tuple[str, ...], float]:
    """What the integration contradicts in a report, and the largest difference over what is allowed."""
    truth, doubts = integrate(monolith(key), case.system.start, report.signals[0].t)
    wrong, margins = [], [0.0]
    for signal in report.signals:
        true, doubt = truth[signal.name], doubts[signal.name]
        error = np.abs(signal.values - true)
        allowed = signal.errors + doubt + ROUNDING * np.abs(signal.values)
        ratios = np.abs(np.abs(signal.values - signal.reference) - error) / allowed
        margins.append(float(np.nanmax(ratios)))
        if margins[-1] > 1.0:
            wrong.append(
                f"the difference of {signal.name} is {margins[-1]:.2g} times its error off"
            )
        if signal.verdict not in allowed_verdicts(error, true):
            wrong.append(f"{signal.name} {signal.verdict}")
    return tuple(wrong), max(margins)


def allowed_verdicts(error: Array, true: Array) -> set[Verdict]:
    """The verdicts that are right for a signal that is off by this much."""
    beyond = np.count_nonzero(~(error <= TOLERANCE * np.ptp(true))) / len(error)
    if beyond == 0.0:
        return {Verdict.AGREES}
    return {Verdict.DIFFERS} if beyond > LASTING else {Verdict.AGREES, Verdict.DIFFERS}


def table(judgements: Sequence[Judgement], titles: Mapping[str, str]) -> str:
    """Masters by systems: for each step what the referee says, and how far the worst signal is off."""
    systems = list(dict.fromkeys(judgement.system for judgement in judgements))
    steps = sorted({judgement.step for judgement in judgements})
    printed = ", ".join(f"{1e3 * step:g}" for step in steps)
    lines = [
        f"| master, steps of {printed} ms | {' | '.join(systems)} |",
        "|---" * (len(systems) + 1) + "|",
    ]
    for master in dict.fromkeys(judgement.master for judgement in judgements):
        cells = [
            ", ".join(
                cell(judgement)
                for step in steps
                for judgement in judgements
                if (judgement.system, judgement.master, judgement.step) == (system, master, step)
            )
            for system in systems
        ]
        lines.append(f"| {titles[master]} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(judgement: Judgement) -> str:
    """How far the worst signal is off, in bold where the verdict is that the result differs."""
    if judgement.failure:
        return "fails"
    share = f"{100 * judgement.deviation:.2g} %" if judgement.deviation < LARGEST_SHARE else "grows"
    return f"**{share}**" if judgement.verdict == Verdict.DIFFERS else share


def summary(judgements: Sequence[Judgement]) -> str:
    """How many results were judged, how many judgements are right, and how many causes were named."""
    judged = [judgement for judgement in judgements if not judgement.failure]
    differing = [judgement for judgement in judged if judgement.verdict == Verdict.DIFFERS]
    named = [judgement for judgement in differing if judgement.cause]
    contradicted = [judgement for judgement in judged if judgement.wrong]
    worst = max((judgement.margin for judgement in judged), default=0.0)
    lines = [
        f"{len(judged)} results judged, {len(judged) - len(contradicted)} judgements confirmed by the integration; "
        f"{len(differing)} differ, a cause is named for {len(named)} of them",
        f"largest difference between a statement and the integration: {worst:.2g} of the stated error",
    ]
    lines += [
        f"{j.system}, {j.master}, {1e3 * j.step:g} ms: {'; '.join(j.wrong)}" for j in contradicted
    ]
    return "\n".join(lines)
