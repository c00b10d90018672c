"""What a coupling does to the damping of a mode, measured on the running system.

A value that is held over a communication step arrives late, and a delay tau around a loop changes
the damping ratio of an oscillation that runs through it by -omega tau / 2. Two runs, one of them
with a small kick, differ by the free response of the coupled system. Its modes at several steps
separate the artificial damping from the real damping. Where all parts offer model exchange and the
linearised system does not change along the motion, its eigenvalue gives the real damping.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..engine.changes import discrete_changes
from ..engine.control import Adaptive
from ..engine.driver import Driver, RowReader
from ..engine.initialise import initialise
from ..engine.part import Part
from ..engine.recorder import Recorder
from ..engine.settings import RunSettings
from ..engine.sources import InputSource
from ..errors import FmuError, SetupError
from ..requirements import setup_problems
from ..system import Network, System, connect
from ..system.graph import stepping_order
from .free_response import SIGNIFICANT, Array, Fit, Mode, fit
from .linearize import linearize

KICK = 1e-3
FEWEST_STEPS, MOST_STEPS = 256, 1 << 12
FEWEST_ROWS, MEMORY = 32, 4
PERIODS, SEEN, TRIED = 4.0, 0.25, 0.125
NOTICEABLE, VISIBLE, ABOVE_NOISE = 0.1, 1e-3, 100.0
ALMOST, AT_ONCE = 0.9, 32
PROPORTIONAL, LEAST_GROWTH = 0.1, 0.05
SPREAD = 3.0
UNEXPLAINED, UNCERTAIN, NEGLIGIBLE, UNDAMPED = 0.02, 0.1, 1e-4, 1e-6
MOMENTS, STEADY, EXACT, STIFF = (0.0, 0.382, 1.0), 1e-6, 1e-9, 1e5


@dataclass(frozen=True)
class Diagnosis:
    """What an algorithm with communication steps of `step` [s] does to a mode of a system.

    `frequency` is its natural frequency [rad/s]. `damping` is the damping ratio of the system itself,
    with its `error`: from the eigenvalue of the linear system if `linear`, else extrapolated to steps
    of zero. `damping_seen` is the damping ratio at `step`. `delay` [s] is the delay around the loop
    that causes the difference, -2 (damping_seen - damping) / frequency. All of these are NaN if no
    oscillation was seen.

    `recommended_step` [s] kept the difference within `share` of the damping when it was tried; it is
    None if no step did. `drift` is the rate [1/s] at which the coupling makes a motion without
    oscillation grow. `residual` is the rms share of the response that the modes do not explain.
    """

    algorithm: str
    step: float
    share: float
    frequency: float
    damping: float
    error: float
    damping_seen: float
    delay: float
    recommended_step: float | None
    drift: float
    residual: float
    linear: bool = False

    @property
    def damped(self) -> bool:
        """Whether the damping of the oscillation is known, and can be distinguished from zero."""
        return self.trusted and _decays(self)

    @property
    def trusted(self) -> bool:
        """Whether the modes explain the response and the damping at steps of zero is known."""
        return _certain(self) and self.residual <= UNEXPLAINED

    def __str__(self) -> str:
        """The diagnosis in plain words."""
        return self.text()

    def _repr_html_(self) -> str:
        """The diagnosis in plain words, for notebooks."""
        return f"<p>{html.escape(self.text())}</p>"

    def text(self) -> str:
        """The diagnosis in plain words."""
        return " ".join(self._sentences())

    def _sentences(self) -> Iterator[str]:
        if math.isnan(self.frequency):
            yield f"No oscillation shows on the wires with {self.algorithm} and steps of {self.step:.4g} s."
        elif self.damped:
            yield from self._mode()
        elif self.trusted and self.damping <= max(UNDAMPED, self.error):
            yield "The oscillation has no damping to speak of: the system itself does not damp it."
            return
        else:
            yield (
                "The damping cannot be determined: it still changes with the step, or with how long the "
                "motion is observed, as it does where there is next to none; try a shorter step."
            )
            return
        if self.drift:
            yield (
                f"A motion that does not oscillate grows at {self.drift:.3g} 1/s, in proportion to "
                "the step: a held angle or position drives it. Couple by speed instead."
            )

    def _mode(self) -> Iterator[str]:
        way = "from derivatives of the FMUs" if self.linear else "from runs with shorter steps"
        yield (
            f"The oscillation at {self.frequency / (2 * math.pi):.4g} Hz has a damping ratio of "
            f"{self.damping:.4g} +- {self.error:.1g}, {way}. With {self.algorithm} and steps of "
            f"{self.step:.4g} s it shows {self.damping_seen:.4g}: a loop delay of {self.delay:.3g} s."
        )
        if self.damping_seen < 0.0 < self.damping:
            yield "That is unstable: the oscillation grows by itself."
        kept = f"the damping within {100 * self.share:.3g} % of its value"
        if self.recommended_step is None:
            yield f"No step that could be tried keeps {kept}: choose another algorithm."
        elif self.recommended_step == self.step:
            yield f"This step keeps {kept}."
        else:
            yield f"Steps of {self.recommended_step:.3g} s keep {kept}."


def diagnose(
    system: System,
    *,
    step: float,
    algorithm: str = "strang",
    share: float = 0.05,
    start: float = 0.0,
    settle: float = 0.0,
    order: Sequence[str] | None = None,
    input_order: int = 0,
) -> Diagnosis:
    """Measure the loop delay of an algorithm on a system, and find the step that keeps it small.

    From `start` [s] the system runs for `settle` [s], then all its Real wires are kicked. Of the
    oscillations that they show well, the least damped one is followed from `step` [s] to three quarters,
    a half and a quarter of it, and from there to zero, or to the eigenvalue found by `linearize`. Then
    shorter steps are tried until the artificial damping is at most `share` of the real damping. `order`
    and `input_order` are those of `run`.

    This also works on a steady motion, as long as the kick is small compared with it: the modes are
    then those of the deviations from that motion. Raises SetupError for a system that cannot be run.
    """
    network = connect(system)
    settings = RunSettings(start + step, step, start, algorithm, order, input_order)
    for problem in setup_problems(network, settings):
        raise SetupError(problem)
    if not 0.0 < share < math.inf:
        raise SetupError(f"share = {share!r} must be a finite number above 0")
    if not 0.0 <= settle < math.inf:
        raise SetupError(f"settle = {settle!r} s must be a finite number of at least 0")
    if not any(wire.source.type == "Real" for wire in network.wires):
        raise SetupError("a diagnosis needs a wire that carries a Real")
    try:
        return _diagnose(Bench(network, settings, stepping_order(network, order), settle), share)
    except FmuError as failure:
        raise SetupError(str(failure)) from failure


@dataclass(frozen=True)
class Bench:
    """A system whose free response is measured again and again, from a kick after `settle` [s]."""

    network: Network
    settings: RunSettings
    sequence: Sequence[str]
    settle: float

    @property
    def step(self) -> float:
        """The step in question [s]; the kick lasts as long."""
        assert not isinstance(self.settings.step, Adaptive)
        return self.settings.step

    def modes(self, h: float, span: float) -> Fit:
        """The modes at steps of h [s], from what is seen for `span` [s]; raises FmuError."""
        count = min(MOST_STEPS, round(span / h))
        calm, kicked = (self._run(h, count, kick) for kick in (0.0, KICK))
        rows = min(len(calm), len(kicked))
        memory = MEMORY * len(self.sequence) * (1 + self.settings.input_order)
        response = (kicked[:rows] - calm[:rows])[memory:]
        if len(response) < FEWEST_ROWS:
            raise SetupError(f"with steps of {h!r} s a part fails soon after the kick")
        return fit(response, h, calm[memory:rows])

    def _run(self, h: float, count: int, kick: float) -> Array:
        """The outputs from the end of the kick on, shape (times, outputs); to where a part fails."""
        real = (wire.source for wire in self.network.wires if wire.source.type == "Real")
        ports = list({port.name: port for port in real}.values())
        settled = round(self.settle / h)
        begin = settled + max(1, round(self.step / h))
        end = begin + count

        recorder = Recorder([port.name for port in ports], {})

        def go(first: int, last: int) -> int:
            plan = replace(self.settings, start=began + first * h, stop=began + last * h, step=h)
            made = discrete_changes(self.network, named, plan.start, plan.stop)
            for _ in Driver(parts, plan, RowReader(parts, ports), recorder, made).steps():
                pass
            return recorder.count

        began = self.settings.start
        with ExitStack() as stack:
            whole = replace(self.settings, stop=began + end * h)
            named = initialise(self.network, whole, self.sequence, stack)
            parts = [named[name] for name in self.sequence]
            if settled:
                go(0, settled)
            with _kicked(parts, kick):
                before = go(settled, begin)
            with suppress(FmuError):
                go(begin, end)
        return np.array(recorder.rows).reshape(recorder.count, -1)[before:, 1:]


@contextmanager
def _kicked(parts: Sequence[Part], kick: float) -> Iterator[None]:
    """Offset every wired Real input by `kick` times the size of its source."""
    links = [link for part in parts for link in part.links if link.real]
    links = [link for link in links if not isinstance(link.signal, InputSource)]
    before = [link.offset for link in links]
    for link in links:
        link.offset += link.factor * kick * (1.0 + abs(link.source.value))
    try:
        yield
    finally:
        for link, offset in zip(links, before):
            link.offset = offset


def _diagnose(bench: Bench, share: float) -> Diagnosis:
    step, algorithm = bench.step, bench.settings.algorithm
    found, span = _watch(bench, step / 4)
    first = _chosen(found, span)
    if first is None:
        how, nan = (algorithm, step, share), math.nan
        return Diagnosis(*how, nan, nan, nan, nan, nan, None, 0.0, found.residual)
    fits, modes = {step / 4: found}, {step / 4: first}

    def follow(h: float) -> None:
        fits[h] = bench.modes(h, span)
        modes[h] = _nearest(fits[h], modes, h)

    for part in (0.5, 0.75, 1.0):
        follow(part * step)
    law = Law(modes, fits)
    own = _own(bench, law, span)
    law = Law(modes, fits, own)
    recommended = step if _decays(law) else None
    while recommended is not None and not law.keeps(recommended, share):
        shorter = law.step(share)
        if shorter > ALMOST * recommended:
            shorter = recommended / 2
        recommended = max(shorter, min(modes) / AT_ONCE)
        if recommended * MOST_STEPS * law.frequency < 2 * math.pi * TRIED:
            recommended = None
        else:
            follow(recommended)
            further = Law(modes, fits, own)
            if further.error > law.error and not _certain(further):
                recommended = None
            else:
                law = further
    seen = modes[step].damping
    return Diagnosis(
        algorithm=algorithm, step=step, share=share, frequency=law.frequency,
        damping=law.damping, error=law.error, damping_seen=seen,
        delay=-2 * (seen - law.damping) / law.frequency, recommended_step=recommended,
        drift=_drift(fits, step, span), residual=max(found.residual for found in fits.values()),
        linear=own is not None,
    )  # fmt: skip


def _own(bench: Bench, law: Law, span: float) -> Own | None:
    """The eigenvalue of the coupled system itself next to a mode, from model exchange.

    None if a part does not offer model exchange, if the linear system changes within `span` [s] of the
    motion, so that the eigenvalues at an instant are not those of the motion, if no eigenvalue is near,
    or if the motion is too stiff to be followed that far.
    """
    system, start = bench.network.system, bench.settings.start
    times = [bench.settle + share * span for share in MOMENTS]
    try:
        fastest = np.abs(linearize(system, start=start).eigenvalues).max(initial=0.0)
        if fastest * times[-1] > STIFF:
            return None
        first, *later = (linearize(system, start=start, at=at) for at in times)
    except SetupError:
        return None
    near = STEADY * np.abs(first.A) + EXACT * np.abs(first.A).max()
    if any((np.abs(found.A - first.A) > near).any() for found in later):
        return None
    expected = law.frequency * complex(-law.damping, math.sqrt(max(0.0, 1.0 - law.damping**2)))
    s, *others = (
        complex(min(found.eigenvalues, key=lambda s: abs(s - expected), default=math.nan))
        for found in (first, *later)
    )
    if not abs(s - expected) <= (UNCERTAIN + law.error) * abs(s):
        return None
    moved = max(abs(other - s) for other in others) / abs(s)
    return Own(abs(s), -s.real / abs(s), moved + EXACT)


class Own(NamedTuple):
    """Natural frequency [rad/s] and damping ratio of a mode; `error` is relative for the frequency and
    absolute for the damping.
    """

    frequency: float
    damping: float
    error: float


class Law:
    """A mode's damping ratio over the step: the cubic through the four shortest steps, or the parabola
    through the system's own value at zero and the two shortest.

    The error of the value at zero is the larger of the differences from the line and from the parabola
    through the shortest steps, plus what the extrapolation makes of SPREAD times the residuals, of what
    a fit neglects per radian, and of how far a mode moves when it is observed for a shorter time, as
    modes of a system that changes along its motion do.
    """

    def __init__(
        self, modes: Mapping[float, Mode], fits: Mapping[float, Fit], own: Own | None = None
    ) -> None:
        self.modes, self.fits = modes, fits
        steps = sorted(modes)[:4] if own is None else [0.0, *sorted(modes)[:2]]
        powers = np.vander(steps)
        ratios = [own.damping if own and not h else modes[h].damping for h in steps]
        self.curve = np.linalg.solve(powers, ratios)
        if own is not None:
            self.frequency, self.damping, self.error = own
            return
        self.damping = float(self.curve[-1])
        self.frequency = float(np.linalg.solve(powers, [modes[h].frequency for h in steps])[-1])
        lower = [np.linalg.solve(np.vander(steps[:n]), ratios[:n])[-1] for n in (2, 3)]
        unknown = [self._unknown(h) for h in steps]
        self.error = max(abs(self.damping - float(value)) for value in lower)
        self.error += float(np.abs(np.linalg.inv(powers)[-1]) @ unknown)

    def _unknown(self, h: float) -> float:
        """What may be wrong with a damping ratio that was seen at a step [s]."""
        neglected = SIGNIFICANT / (self.frequency * h)
        return SPREAD * self.fits[h].residual + neglected + self.modes[h].moved

    def keeps(self, h: float, share: float) -> bool:
        """Whether a step that was tried keeps the damping within its share for certain."""
        off = abs(self.modes[h].damping - self.damping) + self.error + self._unknown(h)
        return off <= share * abs(self.damping)

    def step(self, share: float) -> float:
        """The step at which the damping all but leaves its share."""
        allowed = ALMOST * share * abs(self.damping)
        roots = np.concatenate([np.roots([*self.curve[:-1], side]) for side in (-allowed, allowed)])
        real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
        return float(real.min(initial=math.inf))


def _decays(found: Diagnosis | Law) -> bool:
    """Whether it is an oscillation whose damping can be distinguished from zero."""
    return found.frequency > 0.0 and max(UNDAMPED, found.error) < found.damping < 1.0


def _certain(found: Diagnosis | Law) -> bool:
    """Whether the damping at steps of zero is known."""
    return found.error <= max(UNCERTAIN * abs(found.damping), NEGLIGIBLE)


def _watch(bench: Bench, h: float) -> tuple[Fit, float]:
    """The modes at a step [s], and the time [s] that shows PERIODS of the one of interest."""
    count = FEWEST_STEPS
    while True:
        found = bench.modes(h, count * h)
        mode = _chosen(found, count * h)
        wanted = 4 * count
        if mode is not None:
            wanted = math.ceil(PERIODS * 2 * math.pi / (mode.frequency * h))
        if wanted <= count or count == MOST_STEPS:
            return found, count * h
        count = min(wanted, MOST_STEPS)


def _chosen(found: Fit, span: float) -> Mode | None:
    """The least damped oscillation that the response shows well."""
    noticed = (mode for mode in found.modes if mode.share >= NOTICEABLE and not mode.shift)
    shown = (mode for mode in noticed if mode.s.imag * span > 2 * math.pi * SEEN)
    return min(shown, key=lambda mode: mode.damping, default=None)


def _nearest(found: Fit, modes: Mapping[float, Mode], h: float) -> Mode:
    """The mode that was seen at other steps, where the line through the nearest two expects it."""
    steps = sorted(modes, key=lambda other: abs(other - h))[:2]
    expected = complex(
        np.polyval(np.polyfit(steps, [modes[n].s for n in steps], len(steps) - 1), h)
    )
    shown = [mode for mode in found.modes if mode.share >= VISIBLE and mode.s.imag > 0.0]
    return min(shown or found.modes, key=lambda mode: abs(mode.s - expected))


def _drift(fits: Mapping[float, Fit], step: float, span: float) -> float:
    """The rate [1/s] at which a motion without oscillation grows, if the step is what makes it."""

    def clear(mode: Mode, found: Fit) -> bool:
        return mode.share >= (ABOVE_NOISE * found.residual) ** 2

    whole, half = (
        max((m.s.real for m in fits[h].modes if not m.s.imag and clear(m, fits[h])), default=0.0)
        for h in (step, step / 2)
    )
    made = abs(whole - 2 * half) <= PROPORTIONAL * whole
    return whole if made and whole * span >= LEAST_GROWTH else 0.0
