"""The master against theory: ideal algorithms, orders, stability limits, energies, tolerances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from cosim.engine.algorithms import ALGORITHMS, CouplingContext, Feedthrough, find_algorithm
from cosim.engine.control import Adaptive
from cosim.engine.settings import RunSettings
from cosim.errors import SetupError
from cosim.prepared import Prepared
from cosim.result import Result
from tests.coupling_theory import Ideal, LinearPart, Matrix, Scheme
from tests.linear_systems import (
    BENCHMARKS,
    DUAL_MASS,
    FIRST_INERTIA,
    SECOND_INERTIA,
    SHAFT_STIFFNESS,
    SPRING_AND_MASS,
    UNDAMPED,
    Benchmark,
    couple,
    lagging_motor,
    states,
)

#: Largest relative difference from the ideal algorithm. Chosen: rounding of some hundred steps leaves less.
SAME = 1e-10
#: Largest difference of a measured order from theory. Chosen: the error of a higher order still adds a few hundredths.
ORDER = 0.1
#: How far below and above the stability limit runs are made, over this. Chosen: growth and decay both show, and
#: between them the growth rate is straight.
MARGIN = 0.02
#: First step of the search for a stability limit [s]. Chosen: all systems are stable with it.
FIRST_STEP = 1e-3
#: Ratio of a step of that search to the one before. Chosen: a narrower unstable range would be passed over.
STEP_RATIO = 1.05
#: Accuracy of the limit [s]. Chosen: near the rounding of a step of some ms.
LIMIT_ACCURACY = 1e-15

SCHEMES = {name: Scheme(name) for name in ALGORITHMS}
SCHEMES |= {f"{name}, input order 1": Scheme(name, input_order=1) for name in ALGORITHMS}
HOLDING = {
    "jacobi, FMUs extrapolate": Scheme("jacobi", hold=1),
    "iterated, FMUs interpolate": Scheme("iterated", hold=2),
}
SUBSTEPS = {
    "jacobi, input order 1, 3 substeps": Scheme("jacobi", input_order=1, substeps=3),
    "iterated, input order 1, 3 substeps": Scheme("iterated", input_order=1, substeps=3),
}
EXPLICIT = {
    name: scheme
    for name, scheme in SCHEMES.items()
    if not find_algorithm(scheme.algorithm).is_implicit
}
MOTOR = lagging_motor(lag=0.06, inertia=0.9, slope=0.9 / 2.565e-3)


class SchemeCheck(NamedTuple):
    """How far a scheme is off its ideal, relative, and what else theory says of a quantity."""

    system: str
    scheme: str
    match: float
    quantity: str
    measured: float
    theory: float
    passed: bool


def verify(fmu: Path) -> Iterator[SchemeCheck]:
    """Run all checks with an FMU of x' = A x + B u, y = C x, z = C x + D u that is exact."""
    for name, benchmark in BENCHMARKS.items():
        more = HOLDING if benchmark.feedthrough else SUBSTEPS
        for title, scheme in (SCHEMES | more).items():
            yield from orders(fmu, name, benchmark, title, scheme)
    for title, scheme in EXPLICIT.items():
        yield limit(fmu, "lagging motor", MOTOR, title, scheme)
    for title in ("jacobi", "gauss-seidel"):
        yield limit(fmu, "dual mass", DUAL_MASS, title, SCHEMES[title])
    for title, scheme in SCHEMES.items():
        yield spring_energy(fmu, title, scheme)
    for title in ALGORITHMS:
        yield shaft_energy(fmu, title, SCHEMES[title])
    quarter_car = BENCHMARKS["quarter car"]
    yield tolerance(
        fmu, "quarter car", quarter_car, "strang", "doubling", tolerances=(1e-3, 1e-4, 1e-5)
    )
    yield tolerance(
        fmu, "undamped drive", UNDAMPED, "jacobi", "energy", tolerances=(1e-1, 3e-2, 1e-2)
    )


def simulate(
    fmu: Path,
    units: Mapping[str, LinearPart],
    scheme: Scheme,
    stop: float,
    steps: Sequence[float | Adaptive],
    *,
    bond: tuple[str, str] | None = None,
) -> list[Result]:
    """Runs of the master with each of these steps, all states recorded; raises SetupError for one that fails."""
    system = couple(units, fmu, input_hold=scheme.hold, bond=bond)
    settings = RunSettings(
        stop, steps[0], algorithm=scheme.algorithm, order=list(units), input_order=scheme.input_order,
        substeps={list(units)[-1]: scheme.substeps}, record=states(units),
    )  # fmt: skip
    with Prepared.open(system, settings) as prepared:
        ensemble = prepared.map(len(steps), steps=steps)
    for reason in filter(None, ensemble.reasons):
        raise SetupError(reason)
    return [ensemble.result(k) for k in range(len(steps))]


def deviation(actual: Matrix, expected: Matrix) -> float:
    """The largest difference in a column over the largest value there."""
    if actual.shape != expected.shape:
        return math.inf
    return float((np.abs(actual - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())


def stated_order(scheme: Scheme, units: Mapping[str, LinearPart]) -> int:
    """The order of the states that the algorithm states; FMUs that move their inputs have order 2."""
    if scheme.hold:
        return 2
    feedthroughs = [
        Feedthrough(name, name, frozenset({source.partition(".")[0]}), is_wired=True)
        for name, unit in units.items()
        if unit.D is not None
        for source in unit.u
        if isinstance(source, str)
    ]
    context = CouplingContext([*units], feedthroughs, scheme.input_order)
    return find_algorithm(scheme.algorithm).convergence_order(context)


def bond_residual_order(scheme: Scheme, units: Mapping[str, LinearPart]) -> int:
    """The order of what a power bond makes.

    Held old values against new ones leave a term of first order. A symmetric schedule, which has order
    2 itself, cancels it, unless a part that takes pieces of the step has feedthrough; so do means, that
    lie in the middle for both sides.
    """
    if scheme.input_order:
        return 2
    algorithm = find_algorithm(scheme.algorithm)
    pieces = {
        turn.part for stage in algorithm.stages([*units]) for turn in stage if turn.fraction < 1.0
    }
    is_symmetric = algorithm.held_order > 1 and all(units[name].D is None for name in pieces)
    return 2 if is_symmetric else 1


def worst_order(errors: Sequence[float], theory: float) -> float:
    """The binary logarithm of the quotient of neighbours that is farthest from theory."""
    slopes = np.array([math.log2(abs(a / b)) if a * b else math.inf for a, b in pairwise(errors)])
    return float(slopes[np.abs(slopes - theory).argmax()])


def orders(
    fmu: Path, name: str, benchmark: Benchmark, title: str, scheme: Scheme
) -> Iterator[SchemeCheck]:
    """States, and energies over a bond, against the ideal and its order over halved steps."""
    ideal = Ideal(benchmark.units)
    bond = None if scheme.hold else benchmark.bond
    matches, errors, booked, residuals, shares = [], [], [], [], []
    ideal_shares: list[float] = []
    steps = [benchmark.stop / count for count in benchmark.counts]
    results = simulate(fmu, benchmark.units, scheme, benchmark.stop, steps, bond=bond)
    for count, h, result in zip(benchmark.counts, steps, results):
        simulated = result.data[:, 1:]
        matches.append(deviation(simulated, ideal.states(scheme, [h] * count)))
        errors.append(deviation(simulated, ideal.exact([h] * count)))
        if bond:
            energy = next(iter(result.energy.values()))
            predicted = ideal.energy(scheme, [h] * count, bond)
            ledger = np.array([energy["given"], energy["taken"]])
            booked.append(float(np.abs(ledger - predicted).max() / np.abs(predicted).max()))
            residuals.append(energy["residual"])
            ideal_shares.append(float((predicted[0] - predicted[1]) / np.abs(predicted).max()))
            shares.append(float(energy["residual"] / np.abs(predicted).max()))
    theory = stated_order(scheme, benchmark.units)
    yield judge(
        name,
        title,
        matches,
        "order of the states",
        worst_order(errors, theory),
        theory=theory,
        within=ORDER,
    )
    if bond and max(map(abs, ideal_shares)) < SAME:
        largest = max(shares, key=abs)
        yield judge(name, title, booked, "residual of the energy", largest, theory=0.0, within=SAME)
    elif bond:
        theory = bond_residual_order(scheme, benchmark.units)
        measured_slope = worst_order(residuals, theory)
        yield judge(
            name,
            title,
            booked,
            "order of the residual",
            measured_slope,
            theory=theory,
            within=ORDER,
        )


def judge(
    system: str,
    scheme: str,
    matches: Sequence[float],
    quantity: str,
    measured: float,
    *,
    theory: float,
    within: float,
) -> SchemeCheck:
    """The row, passed if all runs match the ideal and the measured value is within this of theory."""
    match = float(np.max(matches))
    passed = match < SAME and abs(measured - theory) <= within
    return SchemeCheck(system, scheme, match, quantity, measured, theory, passed)


def longest_step(ideal: Ideal, scheme: Scheme) -> float:
    """The step [s] at which the spectral radius of the ideal algorithm first reaches 1."""

    def growth(h: float) -> float:
        return ideal.radius(scheme, h) - 1.0

    h = FIRST_STEP
    while growth(h) < 0.0:
        h *= STEP_RATIO
    return float(brentq(growth, h / STEP_RATIO, h, xtol=LIMIT_ACCURACY))


def limit(
    fmu: Path, name: str, units: Mapping[str, LinearPart], title: str, scheme: Scheme
) -> SchemeCheck:
    """Where the master turns unstable, from its growth below and above the ideal's limit."""
    ideal = Ideal(units)
    theory = longest_step(ideal, scheme)
    matches, growth = [], []
    for h in (theory * (1 - MARGIN), theory * (1 + MARGIN)):
        count = math.ceil(4.0 / abs(math.log(ideal.radius(scheme, h))))
        simulated = simulate(fmu, units, scheme, count * h, [h])[0].data[:, 1:]
        matches.append(deviation(simulated, ideal.states(scheme, [h] * count)))
        size = np.log(np.linalg.norm(simulated / np.abs(simulated).max(axis=0), axis=1))[
            count // 4 :
        ]
        growth.append(float(np.polynomial.polynomial.polyfit(range(len(size)), size, 1)[1]))
    below, above = growth
    measured = theory * (1 - MARGIN * (above + below) / (above - below))
    row = judge(
        name, title, matches, "stability limit [s]", measured, theory=theory, within=MARGIN * theory
    )
    return row._replace(passed=row.passed and below < 0.0 < above)


def spring_energy(fmu: Path, title: str, scheme: Scheme) -> SchemeCheck:
    """A spring drives a mass: what the bond makes is what their energy changes by, exactly.

    Spring and mass only exchange energy, and under a held input the output of either is linear in
    time, so that the ledger's trapezoids are their works.
    """
    h, count = 0.01, 200
    ideal = Ideal(SPRING_AND_MASS)
    [result] = simulate(fmu, SPRING_AND_MASS, scheme, count * h, [h], bond=("spring.1", "mass.1"))
    position, speed = result.data[:, 1], result.data[:, 2]
    energy = 50 * position**2 / 2 + 2.0 * speed**2 / 2
    created = -next(iter(result.energy.values()))["residual"] / energy[0]
    change = float(energy[-1] / energy[0]) - 1.0
    match = deviation(result.data[:, 1:], ideal.states(scheme, [h] * count))
    return judge(
        "spring and mass",
        title,
        [match],
        "energy made / initial energy",
        created,
        theory=change,
        within=SAME,
    )


def shaft_energy(fmu: Path, title: str, scheme: Scheme) -> SchemeCheck:
    """Two inertias: what the bond makes is what their energy changes by, up to second order.

    The shaft's torque bends within a step; the trapezoids miss h^2 / 12 times its curvature.
    """
    ideal = Ideal(UNDAMPED.units)
    matches, gaps = [], []
    steps = [UNDAMPED.stop / count for count in UNDAMPED.counts]
    results = simulate(fmu, UNDAMPED.units, scheme, UNDAMPED.stop, steps, bond=UNDAMPED.bond)
    for count, h, result in zip(UNDAMPED.counts, steps, results):
        matches.append(deviation(result.data[:, 1:], ideal.states(scheme, [h] * count)))
        twist, w_1, w_2 = result.data[:, 1:].T
        energy = (SHAFT_STIFFNESS * twist**2 + FIRST_INERTIA * w_1**2 + SECOND_INERTIA * w_2**2) / 2
        created = -next(iter(result.energy.values()))["residual"]
        gaps.append(float(energy[-1] - energy[0]) - created)
    measured = worst_order(gaps, 2)
    quantity = "order of the energy not booked"
    return judge("undamped drive", title, matches, quantity, measured, theory=2, within=ORDER)


def tolerance(
    fmu: Path,
    name: str,
    benchmark: Benchmark,
    title: str,
    control: str,
    *,
    tolerances: Sequence[float],
) -> SchemeCheck:
    """The largest error of adaptive runs is proportional to the tolerance.

    By energy that holds where the power that the bond makes keeps its sign, as it does under Jacobi
    for a torque and a speed that swing a quarter of a period apart.
    """
    ideal, scheme = Ideal(benchmark.units), SCHEMES[title]
    pieces = 2 if control == "doubling" else 1
    matches, errors = [], []
    steps = [Adaptive(allowed, control=control) for allowed in tolerances]
    for result in simulate(
        fmu, benchmark.units, scheme, benchmark.stop, steps, bond=benchmark.bond
    ):
        simulated, sizes = result.data[:, 1:], np.diff(result["time"])
        predicted = ideal.states(scheme, np.repeat(sizes / pieces, pieces).tolist())[::pieces]
        matches.append(deviation(simulated, predicted))
        errors.append(deviation(simulated, ideal.exact(sizes.tolist())))
    exponent = math.log(errors[0] / errors[-1], tolerances[0] / tolerances[-1])
    quantity = "exponent of the tolerance"
    return judge(
        name, f"{title}, adaptive by {control}", matches, quantity, exponent, theory=1, within=ORDER
    )
