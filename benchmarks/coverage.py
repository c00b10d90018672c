"""Do stated errors hold? Draw a case, ask, compare with the truth, and count.

A *study* is a table of kinds. The function of a kind takes a seed, or several if the study asks `at_once`, and returns the
`Trial` of each: what was stated of a drawn case, and what is true. `main` asks for them in child processes, shows each as soon as it is judged, keeps them
as lines of JSON with --out, where those already kept are not asked for again, and prints per kind and figure how many
cases have the figure (exist), the share of the stated intervals that hold the truth (within), how many do not (missed)
and of these how many by more than three half-widths (by 3) and how many with a word of it (told), the worst of error
over half-width (worst), how many are not stated (refused) or stated where there is nothing (invented), and the medians
of the half-width over the truth and of the processor time. It fails where a demand of the study is not met.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

#: Trials that are listed with how to ask for them again: a convention, which limits the output.
LISTED = 10
#: Characters of an answer's words in the line of a trial: a convention, which limits the output.
WORDS = 160
#: A stated interval that is off by more half-widths than this is counted by itself. Convention.
FAR = 3.0
HEADINGS = (
    "kind", "figure", "exist", "within", "missed", "by 3", "told", "worst", "refused", "invented", "half-width", "time",
)  # fmt: skip


class Stated(NamedTuple):
    """A figure of a case: value and ends of its interval, None where nothing is stated, and the truth, None for none."""

    value: float | None
    low: float | None
    high: float | None
    truth: float | None

    @classmethod
    def of(cls, value: float | None, error: float | None, truth: float | None) -> Stated:
        """A figure with a symmetric error, None where there is none."""
        if value is None or error is None:
            return cls(None, None, None, truth)
        return cls(value, value - error, value + error, truth)

    def error_ratio(self) -> float | None:
        """Distance from the truth over the half-width on its side, infinite without a truth; None if nothing is stated."""
        if self.value is None or self.low is None or self.high is None:
            return None
        if self.truth is None:
            return math.inf
        off = abs(self.value - self.truth)
        half = self.high - self.value if self.truth > self.value else self.value - self.low
        if half > 0.0:
            return off / half
        return math.inf if off else 0.0

    def relative_width(self) -> float:
        """Half of the interval over the truth, nan without one of both."""
        if not self.truth or self.low is None or self.high is None:
            return math.nan
        return abs((self.high - self.low) / 2 / self.truth)


class Trial(NamedTuple):
    """What was stated of a case, and what is true."""

    kind: str
    seed: int
    figures: Mapping[str, Stated]
    seconds: float = math.nan
    #: What the answer says instead of a figure, or beside one.
    words: str = ""
    #: What the case is, and how it can be asked for again.
    case: str = ""


class Demand(NamedTuple):
    """What a study requires of a kind: the least share within, and the largest that is refused."""

    within: float = 1.0
    refused: float = 1.0


class Study(NamedTuple):
    """Kinds with the function of each, how many of a kind are drawn, how many at once, and what is demanded of each."""

    about: str
    kinds: Mapping[str, Callable[[Any], Trial | list[Trial]]]
    number: int
    demands: Mapping[str, Demand]
    at_once: int = 1


def rng_of(seed: int, *more: int) -> np.random.Generator:
    """The random numbers of a trial: of the study's seed and of the number of the trial in it."""
    return np.random.default_rng([*divmod(seed, 1000), *more])


def line(trial: Trial) -> str:
    """A trial in a line."""
    ratios = {name: r for name, f in trial.figures.items() if (r := f.error_ratio()) is not None}
    pieces = [shorten(trial.words, WORDS)] if trial.words else []
    if ratios:
        name = max(ratios, key=ratios.__getitem__)
        pieces.insert(0, f"worst {ratios[name]:.2g} of its error ({name})")
    return f"{trial.kind} {trial.seed}: {'; '.join(pieces)}"


def frame_of(trials: Sequence[Trial]) -> pd.DataFrame:
    """Every figure of every trial in a row; the ratio of its error is nan where nothing is stated."""
    rows = [
        (t, t.kind, name, f, f.truth is not None, f.error_ratio(), f.relative_width(), t.seconds)
        for t in trials
        for name, f in t.figures.items()
    ]
    x = pd.DataFrame(
        rows, columns=["trial", "kind", "figure", "stated", "exist", "ratio", "width", "seconds"]
    )
    x["ratio"] = x["ratio"].astype(float)
    x["within"], x["missed"] = x["exist"] & (x["ratio"] <= 1.0), x["exist"] & (x["ratio"] > 1.0)
    x["far"] = x["missed"] & (x["ratio"] > FAR)
    x["told"] = x["missed"] & np.array([bool(t.words) for t in x["trial"]], bool)
    x["refused"], x["invented"] = x["exist"] & x["ratio"].isna(), ~x["exist"] & x["ratio"].notna()
    return x


def table(trials: Sequence[Trial]) -> Iterator[str]:
    """The counts of each kind and figure, as a table of Markdown."""
    yield f"| {' | '.join(HEADINGS)} |"
    yield "|---" * len(HEADINGS) + "|"
    for names, x in frame_of(trials).groupby(["kind", "figure"], sort=False):
        n, known = x.sum(numeric_only=True), x[x["exist"]]
        share = f"{n['within'] / (n['within'] + n['missed']):.1%}" if known["ratio"].any() else "-"
        counts = [f"{n[name]:.0f}" for name in ("missed", "far", "told")]
        medians = known["width"].median(), x["seconds"].median()
        cells = [
            *names, f"{n['exist']:.0f}", share.replace("%", " %"), *counts, f"{known['ratio'].max():.2g}",
            f"{n['refused']:.0f}", f"{n['invented']:.0f}", f"{medians[0]:.2g}", f"{medians[1]:.2g} s",
        ]  # fmt: skip
        yield f"| {' | '.join(cells)} |"


def complaints(trials: Sequence[Trial], demands: Mapping[str, Demand]) -> Iterator[str]:
    """What the demands leave to complain of."""
    sums = frame_of(trials).groupby("kind").sum(numeric_only=True)
    for kind, demand in demands.items():
        if kind not in sums.index:
            continue
        n = sums.loc[kind]
        if n["invented"]:
            yield f"{kind}: a figure is stated where there is none"
        if n["within"] < demand.within * (n["within"] + n["missed"]):
            yield f"{kind}: fewer than {demand.within:.1%} of the intervals hold the truth"
        if n["refused"] > demand.refused * n["exist"]:
            yield f"{kind}: more than {demand.refused:.1%} are refused"


def worst(trials: Sequence[Trial]) -> Iterator[str]:
    """The trials furthest outside what is stated, and how to ask for them again."""
    x = frame_of(trials)
    for _, at in x[x["ratio"] > 1.0].sort_values("ratio", ascending=False)[:LISTED].iterrows():
        f, trial = at["stated"], at["trial"]
        stated = f"{f.value:.9g} in {f.low:.9g} to {f.high:.9g}"
        yield f"{trial.kind} {trial.seed}: {at['figure']} = {stated}, true: {f.truth}\n    {trial.case}"


def kept(path: Path | None) -> list[Trial]:
    """The trials that a file holds."""
    if path is None or not path.exists():
        return []
    entries = [json.loads(text) for text in path.read_text(encoding="utf-8").splitlines()]
    return [
        Trial(**{**x, "figures": {name: Stated(*f) for name, f in x["figures"].items()}})
        for x in entries
    ]


def _ask(task: tuple[Callable[[Any], Trial | list[Trial]], Any]) -> list[Trial]:
    ask, seeds = task
    answer = ask(seeds)
    return [answer] if isinstance(answer, Trial) else answer


def main(study: Study) -> int:
    """Ask, show and count; returns 1 where a demand is not met."""
    parser = argparse.ArgumentParser(description=study.about)
    parser.add_argument("--number", type=int, default=study.number, help="of cases of each kind")
    parser.add_argument("--kinds", default=",".join(study.kinds), help="separated by commas")
    parser.add_argument("--jobs", type=int, default=2, help="child processes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--out", type=Path, help="file of the trials; those it holds are not repeated"
    )
    options = parser.parse_args()
    unknown = {*options.kinds.split(",")} - {*study.kinds}
    if unknown:
        parser.error(f"no kind {', '.join(sorted(unknown))}: there are {', '.join(study.kinds)}")
    seeds = range(1000 * options.seed, 1000 * options.seed + options.number)
    wanted = {(kind, seed) for kind in options.kinds.split(",") for seed in seeds}
    trials = [trial for trial in kept(options.out) if (trial.kind, trial.seed) in wanted]
    present = {(trial.kind, trial.seed) for trial in trials}
    tasks: list[tuple[Callable[[Any], Trial | list[Trial]], Any]] = []
    for kind in options.kinds.split(","):
        missing, size = [x for x in seeds if (kind, x) not in present], study.at_once
        blocks = [missing[k : k + size] for k in range(0, len(missing), size)]
        tasks += [(study.kinds[kind], block) for block in (missing if size == 1 else blocks)]
    try:
        with ProcessPoolExecutor(options.jobs) as pool:
            for some in pool.map(_ask, tasks):
                trials += some
                for trial in some:
                    print(line(trial), file=sys.stderr, flush=True)
                    if options.out:
                        options.out.parent.mkdir(parents=True, exist_ok=True)
                        with options.out.open("a", encoding="utf-8") as file:
                            file.write(json.dumps(trial._asdict()) + "\n")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    print("\n".join([*table(trials), *worst(trials)]))
    complained = [*complaints(trials, {k: study.demands[k] for k in options.kinds.split(",")})]
    print("\n".join(complained or ["All demands are met."]))
    return int(bool(complained))
