"""Does the operating speed sit on the electromechanical resonance of the drive?

Motor and conveyor are coupled at each speed of a sweep until their orbit is steady; the ripple of
order 2 of speed and torque is compared with first-order theory, and the speed where the torque
ripple lags 90 degrees behind the load ripple with formula (22).
"""

from __future__ import annotations

import cmath
import math
import time
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.optimize import brentq, minimize_scalar

import cosim
from cosim import Estimate, Result
from cosim.result import partial

from . import conveyor_show, fmus, options, plots, pool
from .answer import Answer, Figure, Show, Table, finish, parameters, question, stream
from .coupled import largest
from .orders import HIGHEST, last_revolutions, mean_speed, order
from .theory import SETS, Machine, longest_step

PARTS = fmus.DRIVE
SKIP, EVALUATE = 16, 8
NODES, MARGIN = 7, 0.1
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
RECORD = ("motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod")
TABLE = "resonance.csv"
UNITS = {
    "nu": "rad/s", "w2": "rad/s", "w2_phase": "deg", "tau2": "N.m", "tau2_phase": "deg",
    "w2_theory": "rad/s", "w2_phase_theory": "deg", "tau2_theory": "N.m",
    "tau2_phase_theory": "deg", "lag": "deg", "w_mean": "rad/s", "f_rod_peak": "N",
}  # fmt: skip
SPEED = ("motor.A", "motor.characteristic")
NAMES = ("nu_90", "nu_peak_tau", "nu_peak_w")
MEANING = {
    "nu_90": ("speed where the torque lags its load by 90 deg", ""),
    "nu_peak_tau": ("speed of the largest torque ripple", "torque ripple there, order 2"),
    "nu_peak_w": ("speed of the largest speed ripple", "speed ripple there, order 2"),
}
PEAKS = {"nu_peak_tau": ("tau2_peak", "N.m"), "nu_peak_w": ("w2_peak", "rad/s")}
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")


class Case(NamedTuple):
    """One run: machine, nominal mean speed nu [rad/s], steps per revolution, algorithm, start values."""

    machine: Machine
    nu: float
    steps_per_rev: int
    algorithm: str
    start: options.Start


class Point(NamedTuple):
    """One speed of the sweep: SI units, phases and lag in degrees."""

    nu: float
    w2: float
    w2_phase: float
    tau2: float
    tau2_phase: float
    w2_theory: float
    w2_phase_theory: float
    tau2_theory: float
    tau2_phase_theory: float
    lag: float
    w_mean: float
    f_rod_peak: float


class Found(NamedTuple):
    """A speed between the points of the sweep [rad/s], the curve's value there, coupling errors."""

    nu: Estimate
    value: Estimate


def simulate(case: Case) -> Point:
    """Run one speed until the orbit is steady and evaluate its last revolutions."""
    machine, nu, *_ = case
    result = steady(case, EVALUATE, RECORD)
    t, tau, phi, w, f_rod = result.data.T
    late = last_revolutions(phi, EVALUATE)
    speed, torque = (order(phi[late], x[late], 2) for x in (w, tau))
    return Point(
        nu,
        *polar(speed),
        *polar(torque),
        *polar(machine.speed_ripple(nu)),
        *polar(machine.torque_ripple(nu)),
        lag=polar(machine.load_ripple(nu) / torque)[1] % 360.0,
        w_mean=mean_speed(t, phi, EVALUATE),
        f_rod_peak=largest(t[late], np.abs(f_rod[late]))[0],
    )


def steady(case: Case, revolutions: int, record: Sequence[str]) -> Result:
    """Some revolutions after the orbit has become steady, and those before."""
    machine, nu, steps_per_rev, algorithm, start = case
    h = 2 * math.pi / (nu * steps_per_rev)
    steps = (SKIP + revolutions) * steps_per_rev
    system = fmus.conveyor_drive(machine.start(nu) | start)
    return cosim.run(system, stop=steps * h, step=h, algorithm=algorithm, record=record)


def polar(z: complex) -> tuple[float, float]:
    """Amplitude, and phase in degrees."""
    return abs(z), math.degrees(cmath.phase(z))


def check_steps(machine: Machine, algorithm: str, steps_per_rev: int, nu: float) -> None:
    """Raise SetupError for too few steps per revolution to fit orders or to stay stable at nu."""
    if steps_per_rev <= 2 * HIGHEST:
        raise cosim.SetupError(
            f"{steps_per_rev} steps per revolution must be more than {2 * HIGHEST}, "
            f"to tell orders up to {HIGHEST}"
        )
    limit = 2 * math.pi / (nu * longest_step(machine, algorithm))
    if steps_per_rev <= limit:
        raise cosim.SetupError(
            f"{steps_per_rev} steps per revolution are unstable with {algorithm} at {nu:g} rad/s: "
            f"its limit there is {limit:.2f} (a step of {longest_step(machine, algorithm):.3g} s)"
        )


def sweep(cases: Sequence[Case], jobs: int, table: Path | None) -> list[Point]:
    """Run the cases; rows go to NAME.partial.csv one by one."""
    points: list[Point] = []
    with stream(table, Point._fields) as keep:
        try:
            for point in pool.each(simulate, cases, jobs, "sweep"):
                keep([point])
                points.append(point)
        except KeyboardInterrupt:
            kept = f" in {partial(table)}" if table else ""
            raise KeyboardInterrupt(f"{len(points)} of {len(cases)} speeds{kept}") from None
    return points


class Feature(NamedTuple):
    """What to look for: the interval of the sweep that holds it, and how a curve tells it."""

    name: str
    interval: tuple[float, float]
    value: Callable[[Point], float]
    locate: Callable[[Chebyshev], float]


AMPLITUDES: dict[str, Callable[[Point], float]] = {
    "nu_peak_tau": lambda point: point.tau2,
    "nu_peak_w": lambda point: point.w2,
}


def features(points: Sequence[Point]) -> list[Feature]:
    """The 90 degree crossing and the two amplitude peaks, as far as the sweep holds them."""
    found: list[Feature] = []
    for left, right in pairwise(points):
        if left.lag < 90.0 <= right.lag:
            interval = (left.nu, right.nu)
            found.append(Feature("nu_90", interval, lambda p: p.lag, crossing))
            break
    for name, value in AMPLITUDES.items():
        top = max(range(len(points)), key=lambda i: value(points[i]))
        if 0 < top < len(points) - 1:
            interval = (points[top - 1].nu, points[top + 1].nu)
            found.append(Feature(name, interval, value, peak))
    return found


def crossing(curve: Chebyshev) -> float:
    """Where the lag passes 90 degrees; with coarser steps that may be just beyond the interval."""
    low, high = (float(end) for end in curve.domain)
    margin = MARGIN * (high - low)
    return float(brentq(lambda nu: float(curve(nu)) - 90.0, low - margin, high + margin))


def peak(curve: Chebyshev) -> float:
    """Where the amplitude is largest."""
    low, high = (float(end) for end in curve.domain)
    top = minimize_scalar(
        lambda nu: -float(curve(nu)), bounds=(low, high), method="bounded", options={"xatol": 1e-9}
    )
    return float(top.x)


def chebyshev_nodes(low: float, high: float) -> list[float]:
    """NODES speeds inside the interval, placed for a polynomial through them."""
    places: list[float] = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES).tolist()
    return [(low + high) / 2 + (high - low) / 2 * place for place in places]


def refine(wanted: Sequence[Feature], like: Case, jobs: int) -> dict[str, Found]:
    """Locate each feature on a polynomial through further runs like one, at N, N/2 and N/4 steps.

    Where N/4 steps are not stable, the coupling error stays unknown.
    """
    numbers = coarser(like, min((f.interval[0] for f in wanted), default=math.inf))
    nodes = {f.name: chebyshev_nodes(*f.interval) for f in wanted}
    cases = [
        like._replace(nu=nu, steps_per_rev=n)
        for n in numbers
        for f in wanted
        for nu in nodes[f.name]
    ]
    points = iter(list(pool.each(simulate, cases, jobs, "refine")))
    located: dict[str, list[tuple[float, float]]] = {f.name: [] for f in wanted}
    for _ in numbers:
        for f in wanted:
            values = [f.value(next(points)) for _ in range(NODES)]
            curve = Chebyshev.fit(nodes[f.name], values, NODES - 1, domain=list(f.interval))
            nu = f.locate(curve)
            located[f.name].append((nu, float(curve(nu))))
    order = cosim.ORDERS[like.algorithm]
    return {
        name: Found(*(certified(values, order) for values in zip(*places)))
        for name, places in located.items()
    }


def coarser(like: Case, slowest: float) -> list[int]:
    """N, N/2 and N/4 steps per revolution; N alone where N/4 are not stable at the slowest speed."""
    N = like.steps_per_rev
    try:
        check_steps(like.machine, like.algorithm, N // 4, slowest)
    except cosim.SetupError:
        return [N]
    return [N, N // 2, N // 4]


def certified(values: Sequence[float], order: float) -> Estimate:
    """The estimate of a figure from runs at N, N/2, N/4 steps, or at N alone."""
    if len(values) == 1:
        return Estimate(values[0], None, math.nan)
    return cosim.estimate(values, order)


def rod_force(point: Point, like: Case, jobs: int) -> Estimate:
    """The largest rod force at the speed of a point; it hears the held torque without delay and
    converges with order 1 [N]."""
    numbers = coarser(like, point.nu)[1:]
    cases = [like._replace(nu=point.nu, steps_per_rev=n) for n in numbers]
    values = [again.f_rod_peak for again in pool.each(simulate, cases, jobs, "rod force")]
    return certified([point.f_rod_peak, *values], 1.0)


def verdict(
    machine: Machine,
    points: Sequence[Point],
    found: dict[str, Found],
    forces: Mapping[str, Estimate],
) -> str:
    """The answer in plain words."""
    lines = []
    lines.append(
        f"Formula (22) puts the resonance at {machine.nu_res:.3f} rad/s "
        f"({machine.nu_res * 30 / math.pi:.0f} rpm), damping ratio {machine.zeta:.4g}."
    )
    if "nu_90" in found:
        at = found["nu_90"]
        away = at.nu.value / machine.nu_res - 1
        lines.append(
            f"There the torque ripple lags the load ripple by 90 degrees: found at "
            f"{at.nu.text('rad/s')}, {away:+.3%} from the formula."
        )
    else:
        lines.append("The sweep holds no speed where the torque ripple lags by 90 degrees.")
    for name, what, unit in (
        ("nu_peak_tau", "torque", "N.m"),
        ("nu_peak_w", "speed", "rad/s"),
    ):
        if name in found:
            at = found[name]
            lines.append(
                f"The {what} ripple is largest at {at.nu.text('rad/s')}, "
                f"{at.nu.value / machine.nu_res - 1:+.1%} from the formula: {at.value.text(unit)}."
            )
        else:
            lines.append(f"The {what} ripple has no peak inside the sweep.")
    lines.append(
        "These speeds differ because (22) marks a phase, which neither damping nor the load "
        "moves; the amplitudes peak where the drive's gain times the load ripple, which falls "
        f"towards sqrt(c/m) = {math.sqrt(machine.c / machine.m):.1f} rad/s, is largest."
    )
    near, hardest = nearest(machine, points), strongest(points)
    lines.append(
        f"At {near.nu:g} rad/s the torque swings by {near.tau2:.4g} N.m to either side and the rod "
        f"carries up to {forces['near'].text('N')}; over the sweep the rod carries at most "
        f"{forces['largest'].text('N')}, at {hardest.nu:g} rad/s."
    )
    lines.append(
        "The errors stated are those of the coupling, from runs with a half and a quarter of the steps."
    )
    return "\n".join(lines)


def nearest(machine: Machine, points: Sequence[Point]) -> Point:
    """The point of the sweep beside formula (22)."""
    return min(points, key=lambda p: abs(p.nu - machine.nu_res))


def strongest(points: Sequence[Point]) -> Point:
    """The point of the sweep with the largest rod force."""
    return max(points, key=lambda p: p.f_rod_peak)


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--set", dest="name", choices=SETS, default="A", help="parameter set")
    add("--algorithm", choices=ALGORITHMS, default="strang", help="coupling algorithm")
    add("--steps-per-rev", type=int, default=512, help="communication steps per revolution")
    add(
        "--speeds",
        default=SUPPRESS,
        help="from:to:number or a,b,c [rad/s]; the speeds of the set by default",
    )
    add(
        "--jobs",
        type=int,
        default=SUPPRESS,
        help="parallel processes, by default all cores with Python FMUs and 1 with native ones",
    )
    add(
        "--out",
        type=Path,
        default=SUPPRESS,
        help="folder of the results, results/resonance/SET by default",
    )
    options.add_start(parser, "conveyor.spring.c=7e5")


def answer(
    name: str = "A",
    algorithm: str = "strang",
    steps_per_rev: int = 512,
    speeds: str | None = None,
    start: Sequence[str] = (),
    jobs: int = 1,
    out: Path | None = None,
) -> Answer:
    """Sweep and refine; rows of the sweep are kept in `out` on the way.

    Raises cosim.SetupError for settings that cannot give an answer.
    """
    began = time.perf_counter()
    changes = options.start_values(start, SPEED)
    nus = options.numbers("speeds", speeds or SPEEDS[name])
    for nu in nus:
        options.positive("speed", nu, "rad/s")
    options.at_least("jobs", jobs, 1)
    machine = fmus.followed(SETS[name], changes)
    check_steps(machine, algorithm, steps_per_rev, nus[0])
    cases = [Case(machine, nu, steps_per_rev, algorithm, changes) for nu in nus]
    points = sweep(cases, jobs, out and out / TABLE)
    found = refine(features(points), cases[0], jobs)
    forces = {
        "near": rod_force(nearest(machine, points), cases[0], jobs),
        "largest": rod_force(strongest(points), cases[0], jobs),
    }
    system = fmus.conveyor_drive(machine.start(machine.nu_res) | changes)
    return Answer(
        scenario="resonance",
        question=question(__doc__),
        verdict=verdict(machine, points, found, forces),
        figures=figures(machine, found, forces["largest"]),
        parameters=parameters(system),
        tables={TABLE: Table.of_rows(points, UNITS)},
        provenance=fmus.provenance(system, algorithm, f"{steps_per_rev} steps per revolution"),
        stem="resonance",
        facts={
            "nu_res": machine.nu_res,
            **{key: found[key].nu.value if key in found else None for key in NAMES},
            "coupling_error": {key: at.nu.error for key, at in found.items()},
            "coupling_order": {key: at.nu.order for key, at in found.items()},
            "peak": {key: at.value.value for key, at in found.items() if key != "nu_90"},
            "peak_error": {key: at.value.error for key, at in found.items() if key != "nu_90"},
            "set": name,
            "steps_per_rev": steps_per_rev,
            "revolutions": {"skipped": SKIP, "evaluated": EVALUATE},
            "wall_time": time.perf_counter() - began,
        },
        files={"resonance.png": lambda path: plots.resonance(path, name, machine, points, found)},
        show=lambda: show(cases, points, found),
    )


def show(cases: Sequence[Case], points: Sequence[Point], found: Mapping[str, Found]) -> Show:
    """The sweep against theory, and one revolution nearest to the resonance."""
    machine = cases[0].machine
    near = min(cases, key=lambda case: abs(case.nu - machine.nu_res))
    record = (*RECORD, "conveyor.x", "conveyor.tau_load")
    course, motion = conveyor_show.revolution(near.nu, steady(near, 1, record))
    return Show([conveyor_show.ripple(machine, points, found), course], [motion])


def figures(machine: Machine, found: Mapping[str, Found], force: Estimate) -> dict[str, Figure]:
    """Resonance by formula and as found, the peaks, the largest rod force of the sweep."""
    told = {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, meaning="resonance by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, meaning="damping ratio by formula"),
    }
    for name, at in found.items():
        place, height = MEANING[name]
        told[name] = Figure.of(at.nu, "rad/s", place)
        if name in PEAKS:
            peak, unit = PEAKS[name]
            told[peak] = Figure.of(at.value, unit, height)
    told["f_rod_peak"] = Figure.of(force, "N", "largest rod force of the sweep")
    return told


def run(name: str = "A", jobs: int | None = None, out: Path | None = None, **settings: Any) -> None:
    """Write the answer and print the verdict; native runs are done sooner than workers start."""
    if jobs is None:
        jobs = 1 if fmus.flavour() == "native" else pool.available_cores()
    folder = out or Path("results") / "resonance" / name
    finish(answer(name, jobs=jobs, out=folder, **settings), folder)
