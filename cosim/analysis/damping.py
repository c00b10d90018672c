"""What a coupling does to the damping of a mode, from the multipliers of its steps.

A value that is held over a communication step arrives late, and a delay tau around a loop changes
the damping ratio of an oscillation that runs through it by -omega tau / 2. The multipliers of the
coupled steps show the damping that the coupling gives; from several step sizes it is continued to
steps of zero, which is the damping of the system itself. Where all parts offer model exchange and
the linearised system does not change along the motion, its eigenvalue is that damping.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..engine.settings import RunSettings
from ..engine.setup import Setup
from ..errors import FmuError, SetupError
from ..system import System, connect
from .linearize import linearize
from .multipliers import NOISE_MARGIN, Multiplier, Spectrum, step_spectrum
from .perturbation import PerturbedRuns

#: Steps of the first record: a convention; 256 steps of a quarter of the step in question are 64 of those.
FIRST_STEPS = 256
#: Steps of the longest record: a convention of this project, which limits the time for a slow mode.
MAX_STEPS = 1 << 12
#: Periods of the mode that are recorded: derived from the halves of a record, which show two each.
RECORDED_PERIODS = 4.0
#: Parts of the recorded time that one perturbation lasts: an eighth of a period of the mode.
PERTURBATIONS_IN_RECORD = 32
#: Least share of a signal's energy that makes a mode one of the coupling: a convention.
MIN_SHARE = 0.1
#: Least share of a signal's energy with which a mode is followed to other steps: a convention.
MIN_FOLLOWED_SHARE = 1e-3
#: Least part of its period for which a mode has been recorded when it is chosen: a convention.
MIN_RECORDED_PERIODS = 0.25
#: Largest share left unexplained by modes that are trusted: a convention.
MAX_RESIDUAL = 0.02
#: Largest error of a damping ratio that is stated, relative to it: a convention.
MAX_RELATIVE_ERROR = 0.1
#: Absolute error with which a damping ratio is stated, however small it is: a convention.
MAX_SMALL_ERROR = 1e-4
#: Damping ratios below are called none: the accuracy of a measured ratio.
MIN_DAMPING = 1e-6
#: Part of the allowed change of the damping that the recommended step uses up: a convention.
USED_SHARE = 0.95
#: Accuracy of the recommended step, relative: a convention, which limits the runs of its search.
STEP_ACCURACY = 0.02
#: Longest search for a step: derived from 2^5 = 32 times below the shortest step of the record.
MAX_HALVINGS = 5
#: Least growth over the record that is called a drift: a convention.
MIN_GROWTH = 0.05
#: How far the rate of a drift may be from proportional to the step, relative to it: a convention.
PROPORTIONAL = 0.1
#: Shares of the recorded time at which the linearised system must be the same.
MOMENTS = (0.0, 0.382, 1.0)
#: Largest change of an entry of the linearised system between them, relative to it: a convention.
MAX_CHANGE = 1e-6
#: The same, relative to the largest entry: a convention, for entries that are zero but for rounding.
MAX_ABSOLUTE_CHANGE = 1e-9
#: Most time constants over which a stiff motion is followed by the reference solution.
MAX_STIFFNESS = 1e5
#: The step sizes, relative to the one in question, from which the damping is continued to zero.
STEP_SHARES = (0.25, 0.5, 0.75, 1.0)
NOT_OPPOSITE = (
    "opposite perturbations have no opposite effects, as at a switch or a stop inside a part, or beside "
    "a signal so large that rounding hides them"
)


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

    `frequency_error` [rad/s], `damping_seen_error`, `delay_error` [s], `drift_error` [1/s] and
    `recommended_step_error` [s] are the errors of these figures; the last one says how much longer the
    step could be.

    `event_change` says that a perturbation changes the sequence of events, and when, or that opposite
    perturbations have no opposite effects: there are then no linear deviations, and all figures are
    NaN. Else it is empty.
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
    frequency_error: float = math.nan
    damping_seen_error: float = math.nan
    delay_error: float = math.nan
    drift_error: float = math.nan
    recommended_step_error: float = math.nan
    event_change: str = ""

    @property
    def damped(self) -> bool:
        """Whether the damping of the oscillation is known, and can be distinguished from zero."""
        return self.trusted and _is_decaying(self.frequency, self.damping, self.error)

    @property
    def trusted(self) -> bool:
        """Whether the modes explain the response and the damping at steps of zero is known."""
        return _is_certain(self.damping, self.error) and self.residual <= MAX_RESIDUAL

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
        if self.event_change:
            yield f"The damping cannot be determined: {self.event_change}."
            yield "Deviations are not small there; try another start or settling time."
            return
        if math.isnan(self.frequency):
            yield f"No oscillation shows on the wires with {self.algorithm} and steps of {self.step:.4g} s."
        elif self.damped:
            yield from self._mode()
        elif self.trusted and self.damping <= max(MIN_DAMPING, self.error):
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
        source = "from derivatives of the FMUs" if self.linear else "from runs with shorter steps"
        yield (
            f"The oscillation at {self.frequency / (2 * math.pi):.4g} Hz has a damping ratio of "
            f"{self.damping:.4g} +- {self.error:.1g}, {source}. With {self.algorithm} and steps of "
            f"{self.step:.4g} s it shows {self.damping_seen:.4g}: a loop delay of {self.delay:.3g} s."
        )
        if self.damping_seen < 0.0 < self.damping:
            yield "That is unstable: the oscillation grows by itself."
        aim = f"the damping within {100 * self.share:.3g} % of its value"
        if self.recommended_step is None:
            yield f"No step that could be tried keeps {aim}: choose another algorithm."
        elif self.recommended_step == self.step:
            yield f"This step keeps {aim}."
        else:
            yield f"Steps of {self.recommended_step:.3g} s keep {aim}."


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

    From `start` [s] the system runs for `settle` [s], then its Real wires are perturbed one after the
    other. Of the oscillations that they show well, the least damped one is followed from a quarter of
    `step` [s] to `step`, and from there to steps of zero, or to the eigenvalue found by `linearize`.
    Then the longest step is sought whose artificial damping is at most `share` of the real damping.
    `order` and `input_order` are those of `run`.

    This also works on a steady motion: the modes are then those of the deviations from that motion. If
    the motion repeats, as that of a machine that turns does, they are its Floquet exponents.

    Parameters
    ----------
    system : System
        What is examined.
    step : float
        The communication step [s].
    algorithm : str
        The coupling algorithm, one of `ALGORITHMS`.
    share : float
        The largest artificial damping, as a share of the real damping.
    start : float
        When the run begins [s].
    settle : float
        How long the system runs before it is perturbed [s].
    order : sequence of str, optional
        The order in which the parts step.
    input_order : int
        The degree of the polynomials that inputs follow within a step.

    Raises
    ------
    SetupError
        For a system that cannot be run, without a wire that carries a Real, and for settings out of range.
    """
    network = connect(system)
    settings = RunSettings(start + step, step, start, algorithm, order, input_order)
    setup = Setup.of(network, settings)
    if not 0.0 < share < math.inf:
        raise SetupError(f"share = {share!r} must be a finite number above 0")
    if not 0.0 <= settle < math.inf:
        raise SetupError(f"settle = {settle!r} s must be a finite number of at least 0")
    if not any(wire.source.type == "Real" for wire in network.wires):
        raise SetupError("a diagnosis needs a wire that carries a Real")
    runs = PerturbedRuns(setup, settle)
    try:
        return _diagnose(runs, share)
    except FmuError as failure:
        raise SetupError(str(failure)) from failure


class NonlinearDeviationsError(SetupError):
    """The deviations are not linear; the message says why, as a clause."""


class ModeTracker:
    """Follows one mode over the step: `modes` and `spectra` by the step [s] at which they were measured.

    `chosen` is the least damped oscillation that the wires show well at `step`, None without any.
    Raises NonlinearDeviationsError where the deviations at a step are not linear.
    """

    def __init__(self, runs: PerturbedRuns, step: float) -> None:
        self.runs = runs
        self.modes: dict[float, Multiplier] = {}
        self.spectra: dict[float, Spectrum] = {}
        self.span = FIRST_STEPS * step
        self.chosen = self._choose(step)

    def follow(self, h: float) -> Multiplier:
        """Measure the mode at steps of h [s]; raises FmuError."""
        if h not in self.modes:
            spectrum = self._spectrum(h)
            near = sorted(self.modes, key=lambda other: abs(other - h))[:2]
            line = np.polyfit(near, [self.modes[other].s for other in near], len(near) - 1)
            expected = complex(np.polyval(line, h))
            oscillating = [
                mode
                for mode in spectrum.modes
                if mode.share >= MIN_FOLLOWED_SHARE and mode.s.imag > 0.0 and not mode.is_shift
            ]
            if not (oscillating or spectrum.modes):
                raise SetupError(f"with steps of {h!r} s the deviations show no mode")
            candidates = oscillating or spectrum.modes
            self.spectra[h] = spectrum
            self.modes[h] = min(candidates, key=lambda mode: abs(mode.s - expected))
        return self.modes[h]

    @property
    def residual(self) -> float:
        """The largest share of deviations that a spectrum has left unexplained."""
        return max(spectrum.residual for spectrum in self.spectra.values())

    def _choose(self, h: float) -> Multiplier | None:
        """Record for long enough to see the mode."""
        steps, before = FIRST_STEPS, 0
        spectrum, mode = Spectrum((), 0.0), None
        while steps > before:
            self.span = steps * h
            spectrum = self._spectrum(h)
            mode = _least_damped(spectrum, self.span)
            wanted = 4 * steps
            if mode is not None:
                wanted = math.ceil(RECORDED_PERIODS * 2 * math.pi / (mode.frequency * h))
            before, steps = steps, min(max(steps, wanted), MAX_STEPS)
        self.spectra[h] = spectrum
        if mode is not None:
            self.modes[h] = mode
        return mode

    def _spectrum(self, h: float) -> Spectrum:
        count = min(MAX_STEPS, round(self.span / h))
        gap = max(1, count // PERTURBATIONS_IN_RECORD)
        deviations = self.runs.record(h, count, gap)
        if deviations.event_change:
            raise NonlinearDeviationsError(deviations.event_change)
        if NOISE_MARGIN * deviations.noise >= 1.0:
            raise NonlinearDeviationsError(NOT_OPPOSITE)
        return step_spectrum(deviations)


class Eigenmode(NamedTuple):
    """Natural frequency [rad/s] and damping ratio of a mode of the system itself, with their errors.

    The error is relative for the frequency and absolute for the damping.
    """

    frequency: float
    damping: float
    error: float


class DampingModel:
    """A mode's frequency and damping ratio over the step, continued to steps of zero.

    Both follow the cubic through the four shortest steps, or the parabola through the eigenmode of the
    system at zero and the two shortest. The error at zero is the difference from the parabola through
    the three shortest, plus what the extrapolation makes of the errors of the multipliers.
    """

    def __init__(self, modes: Mapping[float, Multiplier], eigenmode: Eigenmode | None) -> None:
        self.modes = modes
        steps = np.array(sorted(modes)[:4])
        if eigenmode is not None:
            self.frequency, self.damping, self.error = eigenmode
            self.frequency_error = eigenmode.error * eigenmode.frequency
            steps = np.array([0.0, *steps[:2]])
            ratios = [eigenmode.damping, *(modes[h].damping for h in steps[1:].tolist())]
            self.curve = np.linalg.solve(np.vander(steps), ratios)
            return
        measured = [modes[h] for h in steps.tolist()]
        errors = np.array([mode.error for mode in measured])
        ratios = [mode.damping for mode in measured]
        self.curve = np.linalg.solve(np.vander(steps), ratios)
        self.damping, self.error = _continued(steps, np.array(ratios), errors)
        frequencies = np.array([mode.frequency for mode in measured])
        self.frequency, self.frequency_error = _continued(steps, frequencies, errors * frequencies)

    def change(self, mode: Multiplier) -> float:
        """The largest difference of a mode's damping ratio from that at zero, within the errors."""
        return abs(mode.damping - self.damping) + self.error + mode.error

    def longest_step(self, share: float) -> float:
        """The step [s] at which the curve leaves the share of the damping."""
        allowed = share * abs(self.damping)
        roots = np.concatenate([np.roots([*self.curve[:-1], side]) for side in (-allowed, allowed)])
        is_real = np.abs(roots.imag) <= math.sqrt(np.finfo(float).eps) * np.abs(roots)
        return float(roots.real[is_real & (roots.real > 0.0)].min(initial=math.inf))


def _continued(
    steps: NDArray[np.float64], values: NDArray[np.float64], errors: NDArray[np.float64]
) -> tuple[float, float]:
    """The polynomial through values at steps, continued to zero, and its error."""
    limits = [
        float(np.linalg.solve(np.vander(steps[:n]), values[:n])[-1])
        for n in (len(steps) - 1, len(steps))
    ]
    weights = np.abs(np.linalg.inv(np.vander(steps))[-1])
    return limits[-1], abs(limits[1] - limits[0]) + float(weights @ errors)


def _diagnose(runs: PerturbedRuns, share: float) -> Diagnosis:
    step, algorithm = runs.step, runs.settings.algorithm
    nan = math.nan
    unknown = Diagnosis(algorithm, step, share, nan, nan, nan, nan, nan, None, 0.0, nan)
    try:
        tracker = ModeTracker(runs, min(STEP_SHARES) * step)
        if tracker.chosen is None:
            return replace(unknown, residual=tracker.residual)
        for part in STEP_SHARES[1:]:
            tracker.follow(part * step)
    except NonlinearDeviationsError as change:
        return replace(unknown, event_change=str(change))
    model = DampingModel(tracker.modes, None)
    eigenmode = _eigenmode(tracker, model)
    if eigenmode is not None:
        model = DampingModel(tracker.modes, eigenmode)
    recommended = _recommended_step(tracker, model, share)
    refined = DampingModel(tracker.modes, eigenmode)
    if refined.error < model.error:
        # The search has measured shorter steps, from which less is continued.
        model = refined
        recommended = _recommended_step(tracker, model, share)
    mode = tracker.modes[step]
    delay = -2 * (mode.damping - model.damping) / model.frequency
    delay_error = 2 * (mode.error + model.error) / model.frequency
    delay_error += abs(delay) * model.frequency_error / model.frequency
    drift, drift_error = _growth_without_oscillation(tracker, step)
    return Diagnosis(
        algorithm=algorithm, step=step, share=share, frequency=model.frequency,
        damping=model.damping, error=model.error, damping_seen=mode.damping, delay=delay,
        recommended_step=recommended, drift=drift, residual=tracker.residual,
        linear=eigenmode is not None, frequency_error=model.frequency_error,
        damping_seen_error=mode.error, delay_error=delay_error, drift_error=drift_error,
        recommended_step_error=math.nan if recommended is None else STEP_ACCURACY * recommended,
    )  # fmt: skip


def _recommended_step(tracker: ModeTracker, model: DampingModel, share: float) -> float | None:
    """The longest step [s], up to the one in question, that was seen to keep the damping within a share.

    Bisection by Brent's method between a step that keeps it and one that does not. None if the damping
    is not known, or no step that could be tried keeps it.
    """
    step = tracker.runs.step
    if not (
        _is_decaying(model.frequency, model.damping, model.error)
        and _is_certain(model.damping, model.error)
        and tracker.residual <= MAX_RESIDUAL
    ):
        return None
    allowed = share * abs(model.damping)
    if model.change(tracker.modes[step]) <= allowed:
        return step
    aim = USED_SHARE * allowed

    def excess(h: float) -> float:
        return model.change(tracker.follow(h)) - aim

    try:
        unused = USED_SHARE * (aim - model.error) / abs(model.damping)
        low = min(model.longest_step(max(unused, share / 4)), step / 2)
        for _ in range(MAX_HALVINGS):
            if excess(low) <= 0.0:
                break
            low /= 2
        else:
            return None
        tried = [h for h in tracker.modes if h > low and excess(h) > 0.0]
        high = min(tried, default=step)
        brentq(excess, low, high, rtol=STEP_ACCURACY, xtol=STEP_ACCURACY * low)
    except (SetupError, FmuError):
        pass
    short_enough = [
        h for h, mode in tracker.modes.items() if h <= step and model.change(mode) <= allowed
    ]
    return max(short_enough, default=None)


def _eigenmode(tracker: ModeTracker, model: DampingModel) -> Eigenmode | None:
    """The eigenvalue of the coupled system itself next to a mode, from model exchange.

    None if a part does not offer model exchange, if the linear system changes during the record, so
    that the eigenvalues at an instant are not those of the motion, if no eigenvalue is near, or if the
    motion is too stiff to be followed that far.
    """
    runs = tracker.runs
    system, start = runs.setup.network.system, runs.settings.start
    times = [runs.settle + share * tracker.span for share in MOMENTS]
    try:
        fastest = np.abs(linearize(system, start=start).eigenvalues).max(initial=0.0)
        if fastest * times[-1] > MAX_STIFFNESS:
            return None
        first, *later = (linearize(system, start=start, at=at) for at in times)
    except SetupError:
        return None
    tolerance = MAX_CHANGE * np.abs(first.A) + MAX_ABSOLUTE_CHANGE * np.abs(first.A).max()
    if any((np.abs(linear.A - first.A) > tolerance).any() for linear in later):
        return None
    damping = min(max(model.damping, -1.0), 1.0)
    expected = model.frequency * complex(-damping, math.sqrt(1.0 - damping**2))
    s, *later_values = (
        complex(min(linear.eigenvalues, key=lambda s: abs(s - expected), default=math.nan))
        for linear in (first, *later)
    )
    if not abs(s - expected) <= (MAX_RELATIVE_ERROR + model.error) * abs(s):
        return None
    difference = max(abs(value - s) for value in later_values) / abs(s)
    return Eigenmode(abs(s), -s.real / abs(s), difference + MAX_ABSOLUTE_CHANGE)


def _least_damped(spectrum: Spectrum, span: float) -> Multiplier | None:
    """The least damped oscillation that the deviations show well."""
    visible = (
        mode
        for mode in spectrum.modes
        if mode.share >= MIN_SHARE
        and not mode.is_shift
        and mode.s.imag * span > 2 * math.pi * MIN_RECORDED_PERIODS
    )
    return min(visible, key=lambda mode: mode.damping, default=None)


def _is_decaying(frequency: float, damping: float, error: float) -> bool:
    """Whether it is an oscillation whose damping can be distinguished from zero."""
    return frequency > 0.0 and max(MIN_DAMPING, error) < damping < 1.0


def _is_certain(damping: float, error: float) -> bool:
    """Whether the damping at steps of zero is known."""
    return error <= max(MAX_RELATIVE_ERROR * abs(damping), MAX_SMALL_ERROR)


def _growth_without_oscillation(tracker: ModeTracker, step: float) -> tuple[float, float]:
    """The rate [1/s] at which a motion without oscillation grows if the step makes it grow, and its error.

    The growth that a step makes is proportional to the step, so that half of the step shows half of it.
    """
    full, half = (
        max(
            (mode.s.real for mode in tracker.spectra[h].modes if not mode.s.imag and mode.share),
            default=0.0,
        )
        for h in (step, step / 2)
    )
    difference = abs(full - 2 * half)
    grows = difference <= PROPORTIONAL * full and full * tracker.span >= MIN_GROWTH
    return (full, difference) if grows else (0.0, 0.0)
