"""The master against theory: ideal algorithms, orders, stability limits, energies, tolerances.

The ideal algorithms are held against classical methods, closed solutions and published figures, so
that theory and master cannot be wrong together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from cosim import ALGORITHMS, Adaptive, Prepared, Result, RunSettings, SetupError, System, run
from cosim.engine.algorithms import CouplingContext, Feedthrough, find_algorithm
from tests.coupling_theory import Ideal, LinearPart, Matrix, Scheme
from tests.linear_systems import (
    BENCHMARKS,
    SPRING_AND_MASS,
    Benchmark,
    couple,
    lagging_motor,
    states,
)

#: Largest relative difference from the ideal algorithm. Chosen: rounding of some hundred steps leaves less.
SAME = 1e-10
#: Largest difference of a measured order from theory. Chosen: the error of a higher order still adds a few hundredths.
ORDER = 0.1
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
ALL = SCHEMES | HOLDING | SUBSTEPS
MOTOR = lagging_motor(lag=0.06, inertia=0.9, slope=0.9 / 2.565e-3)


@pytest.fixture
def fmu(fmus: Path) -> Path:
    """x' = A x + B u, y = C x, z = C x + D u, which is exact."""
    return fmus / "LinearSystem.fmu"


def simulate(
    fmu: Path, units: Mapping[str, LinearPart], scheme: Scheme, stop: float,
    steps: Sequence[float | Adaptive], bond: tuple[str, str] | None = None,
) -> list[Result]:  # fmt: skip
    """Runs of the master with each of these steps, all states recorded."""
    system = couple(units, fmu, input_hold=scheme.hold, bond=bond)
    settings = RunSettings(
        stop, steps[0], algorithm=scheme.algorithm, order=list(units), input_order=scheme.input_order,
        substeps={list(units)[-1]: scheme.substeps}, record=states(units),
    )  # fmt: skip
    with Prepared.open(system, settings) as prepared:
        ensemble = prepared.map(len(steps), steps=steps)
    assert not any(ensemble.reasons)
    return [ensemble.result(k) for k in range(len(steps))]


def deviation(actual: Matrix, expected: Matrix) -> float:
    """The largest difference in a column over the largest value there."""
    assert actual.shape == expected.shape
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


def residual_order(scheme: Scheme, units: Mapping[str, LinearPart]) -> int:
    """The order of what a power bond makes.

    Held old values against new ones leave a term of first order. A symmetric schedule, which has order
    2 itself, cancels it, unless a part that takes pieces of the step has feedthrough; so do means, that
    lie in the middle for both sides.
    """
    if scheme.input_order:
        return 2
    algorithm = find_algorithm(scheme.algorithm)
    turns = [turn for stage in algorithm.stages([*units]) for turn in stage]
    pieces = {turn.part for turn in turns if turn.fraction < 1.0}
    is_symmetric = algorithm.held_order > 1 and all(units[name].D is None for name in pieces)
    return 2 if is_symmetric else 1


def require_order(errors: Sequence[float], order: float) -> None:
    """With each halving of the step, an error falls by this order."""
    slopes = [math.log2(abs(a / b)) if a * b else math.inf for a, b in pairwise(errors)]
    assert slopes == pytest.approx([order] * len(slopes), abs=ORDER)


def require_theory(fmu: Path, benchmark: Benchmark, scheme: Scheme) -> None:
    """States, and energies over a bond, are those of the ideal, and have its order over halved steps."""
    ideal, bond = Ideal(benchmark.units), None if scheme.hold else benchmark.bond
    steps = [benchmark.stop / count for count in benchmark.counts]
    results = simulate(fmu, benchmark.units, scheme, benchmark.stop, steps, bond)
    errors, residuals, scale = [], [], 1.0
    for count, h, result in zip(benchmark.counts, steps, results):
        simulated = result.data[:, 1:]
        assert deviation(simulated, ideal.states(scheme, [h] * count)) < SAME
        errors.append(deviation(simulated, ideal.exact([h] * count)))
        if bond:
            (energy,) = result.energy.values()
            predicted = ideal.energy(scheme, [h] * count, bond)
            scale = np.abs(predicted).max()
            assert [energy["given"], energy["taken"]] == pytest.approx(predicted, abs=SAME * scale)
            residuals.append(energy["residual"])
    require_order(errors, stated_order(scheme, benchmark.units))
    if bond and np.abs(residuals).max() > SAME * scale:
        require_order(residuals, residual_order(scheme, benchmark.units))


@pytest.mark.parametrize(
    ("name", "title"),
    [
        pytest.param(name, title, marks=[] if name == "drive" else [pytest.mark.slow])
        for name, benchmark in BENCHMARKS.items()
        for title in SCHEMES | (HOLDING if benchmark.feedthrough else SUBSTEPS)
    ],
)
def test_states_and_residuals_are_those_of_theory(fmu: Path, name: str, title: str) -> None:
    require_theory(fmu, BENCHMARKS[name], ALL[title])


def longest_step(ideal: Ideal, scheme: Scheme) -> float:
    """The step [s] at which the spectral radius of the ideal algorithm first reaches 1."""

    def growth(h: float) -> float:
        return ideal.radius(scheme, h) - 1.0

    h, ratio = 1e-3, 1.05  # stable with all systems, and no unstable range is as narrow
    while growth(h) < 0.0:
        h *= ratio
    return float(brentq(growth, h / ratio, h, xtol=1e-15))


@pytest.mark.parametrize("title", SCHEMES)
def test_a_bond_makes_by_how_much_the_energy_of_spring_and_mass_changes(
    fmu: Path, title: str
) -> None:
    """Under a held input the output of either is linear in time, so that the ledger's trapezoids are their works."""
    scheme, h, count = SCHEMES[title], 0.01, 200
    bond = ("spring.1", "mass.1")
    [result] = simulate(fmu, SPRING_AND_MASS, scheme, count * h, [h], bond)
    position, speed = result.data[:, 1], result.data[:, 2]
    energy = 50 * position**2 / 2 + 2.0 * speed**2 / 2
    made = -next(iter(result.energy.values()))["residual"]
    assert made == pytest.approx(energy[-1] - energy[0], abs=SAME * energy[0])
    ideal = Ideal(SPRING_AND_MASS).states(scheme, [h] * count)
    assert deviation(result.data[:, 1:], ideal) < SAME


K, M, H = 50.0, 2.0, 0.02


def velocity_verlet(s: float, v: float, _: float, __: float) -> tuple[float, float]:
    half = s + H / 2 * v
    v -= H * K / M * half
    return half + H / 2 * v, v


def adams_bashforth(s: float, v: float, s_1: float, v_1: float) -> tuple[float, float]:
    return s + H * (1.5 * v - 0.5 * v_1), v - H * K / M * (1.5 * s - 0.5 * s_1)


def adams_bashforth_then_moulton(s: float, v: float, _: float, v_1: float) -> tuple[float, float]:
    end = s + H * (1.5 * v - 0.5 * v_1)
    return end, v - H * K / M * (s + end) / 2


def trapezoids(s: float, v: float, _: float, __: float) -> tuple[float, float]:
    a = K / M * H * H / 4
    end = ((1 - a) * v - H * K / M * s) / (1 + a)
    return s + H * (v + end) / 2, end


CLASSICAL = {
    "strang": velocity_verlet,
    "jacobi, input order 1": adams_bashforth,
    "gauss-seidel, input order 1": adams_bashforth_then_moulton,
    "iterated, input order 1": trapezoids,
    "jacobi, input order 1, 3 substeps": adams_bashforth,
    "iterated, FMUs interpolate": trapezoids,
    "jacobi, FMUs extrapolate": adams_bashforth,
}


@pytest.mark.parametrize("title", CLASSICAL)
def test_between_two_integrators_each_scheme_is_a_classical_method(title: str) -> None:
    """A spring and a mass, each an integrator of what it hears; the first step has no past."""
    rows = [(0.1, 1.0)] * 2
    for _ in range(50):
        rows.append(CLASSICAL[title](*rows[-1], *rows[-2]))
    got = Ideal(SPRING_AND_MASS).states(ALL[title], [H] * 50)
    assert got == pytest.approx(np.array(rows[1:]), rel=1e-12, abs=1e-12)


def test_strang_with_moving_inputs_uses_the_line_through_the_newest_two() -> None:
    s, v, v_1 = 0.1, 1.0, 1.0
    rows = [(s, v)]
    for _ in range(50):
        half = s + H / 2 * (v + (v - v_1) / 4)
        v, v_1 = v - H * K / M * half, v
        s = half + H / 2 * (v_1 + 0.75 * (v - v_1))
        rows.append((s, v))
    got = Ideal(SPRING_AND_MASS).states(SCHEMES["strang, input order 1"], [H] * 50)
    assert got == pytest.approx(np.array(rows), rel=1e-12, abs=1e-12)


def test_exact_solutions_of_the_coupled_system() -> None:
    t = np.linspace(0.0, 1.0, 101)
    slow, fast = np.cos(2 * np.pi * t), np.cos(6 * np.pi * t)
    got = Ideal(BENCHMARKS["oscillator"].units).exact([0.01] * 100)
    assert pytest.approx(np.array([slow + fast, slow - fast]) / 2, abs=1e-12) == got[:, [0, 2]].T


PUBLISHED = [
    ("oscillator", 1.0, 0.01, "jacobi", 4.565),
    ("oscillator", 1.0, 0.005, "jacobi", 2.124),
    ("oscillator", 1.0, 0.005, "gauss-seidel", 0.3765),
    ("oscillator", 1.0, 0.0025, "jacobi, FMUs extrapolate", 0.04046),
    ("oscillator", 1.0, 0.005, "iterated", 1.877),
    ("oscillator", 1.0, 0.005, "iterated, FMUs interpolate", 0.03245),
    ("dual mass", 10.0, 1e-3, "jacobi", 1.0011e-2),
    ("dual mass", 10.0, 1e-3, "gauss-seidel", 5.384e-3),
    ("dual mass", 10.0, 1e-3, "jacobi, FMUs extrapolate", 4.727e-5),
    ("dual mass", 10.0, 1e-3, "iterated", 6.309e-3),
    ("dual mass", 10.0, 1e-3, "iterated, FMUs interpolate", 5.124e-6),
    ("quarter car", 4.0, 1e-3, "jacobi", 6.835e-3),
    ("quarter car", 4.0, 1e-3, "gauss-seidel", 6.732e-3),
    ("quarter car", 4.0, 1e-3, "jacobi, FMUs extrapolate", 4.667e-4),
    ("quarter car", 4.0, 1e-3, "iterated", 6.699e-3),
    ("quarter car", 4.0, 1e-3, "iterated, FMUs interpolate", 1.119e-4),
]


@pytest.mark.parametrize(("problem", "stop", "h", "title", "error"), PUBLISHED)
def test_errors_of_the_ideal_algorithms_are_the_published_ones(
    problem: str, stop: float, h: float, title: str, error: float
) -> None:
    ideal, sizes = Ideal(BENCHMARKS[problem].units), [h] * round(stop / h)
    largest = np.abs(ideal.states(ALL[title], sizes) - ideal.exact(sizes)).max()
    assert largest == pytest.approx(error, rel=2e-3)


def test_stability_limits_of_the_lagging_motor_are_the_closed_ones() -> None:
    """Jacobi J / B; Gauss-Seidel and Strang where H / T_M tanh(H / 2 T) = 2."""
    ideal, T, T_M = Ideal(MOTOR), 0.06, 2.565e-3
    assert longest_step(ideal, SCHEMES["jacobi"]) == pytest.approx(T_M, rel=1e-9)
    for title in ("gauss-seidel", "strang"):
        H_c = longest_step(ideal, ALL[title])
        assert H_c / T_M * math.tanh(H_c / (2 * T)) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("problem", ["dual mass", "drive"])
def test_the_ledger_of_gauss_seidel_telescopes(problem: str) -> None:
    """The first part hears old values, the second new ones: h / 2 (p_0 q_0 - p_N q_N) is left."""
    benchmark, h = BENCHMARKS[problem], 1e-3
    flow, effort = benchmark.bond
    ideal = Ideal(benchmark.units)
    supplied, taken = ideal.energy(SCHEMES["gauss-seidel"], [h] * 15, benchmark.bond)
    values = ideal.run(SCHEMES["gauss-seidel"], [h] * 15)[:, len(ideal.x0) :].T
    p, q = (values[ideal.outputs.index(name)] for name in (flow, effort))
    assert supplied - taken == pytest.approx(h / 2 * (p[0] * q[0] - p[-1] * q[-1]), rel=1e-10)


LOOP = {
    "a": LinearPart([[-1.0]], [[1.0]], [[1.0]], [1.0], ["b.1"], D=[[0.5]]),
    "b": LinearPart([[-2.0]], [[1.0]], [[1.0]], [0.0], ["a.1"], D=[[-3.0]]),
}


def loop(fmus: Path, units: dict[str, LinearPart]) -> System:
    return couple(units, fmus / "LinearSystem.fmu", input_hold=2)


def test_direct_feedthrough_in_both_directions_is_refused_by_explicit_algorithms(
    fmus: Path,
) -> None:
    for algorithm in ("jacobi", "gauss-seidel", "strang"):
        with pytest.raises(SetupError) as caught:
            run(loop(fmus, LOOP), stop=1.0, step=0.01, algorithm=algorithm)
        assert "algebraic loop: b.z[1] -> a.u[1], a.z[1] -> b.u[1]" in str(caught.value)
        assert "iterated can" in str(caught.value)


def test_direct_feedthrough_in_both_directions_is_solved_by_iteration(fmus: Path) -> None:
    """Also at the start, where the inputs must agree with the outputs that they make."""
    errors, ideal = [], Ideal(LOOP)
    for count in (50, 100, 200):
        sizes = [1.0 / count] * count
        system, record = loop(fmus, LOOP), states(LOOP)
        got = run(system, stop=1.0, step=sizes[0], algorithm="iterated", record=record).data[:, 1:]
        assert got == pytest.approx(ideal.states(Scheme("iterated", hold=2), sizes), abs=1e-9)
        errors.append(np.abs(got[-1] - ideal.exact(sizes)[-1]).max())
    assert [math.log2(a / b) for a, b in pairwise(errors)] == pytest.approx([2, 2], abs=0.1)


def test_a_loop_without_solution_is_an_error_with_its_signals(fmus: Path) -> None:
    hopeless = LOOP | {"b": LinearPart([[-2.0]], [[1.0]], [[1.0]], [5.0], ["a.1"], D=[[2.0]])}
    with pytest.raises(
        SetupError, match=r"start values of an algebraic loop were not found; still off: .*u\[1\]"
    ):
        run(loop(fmus, hopeless), stop=1.0, step=0.01, algorithm="iterated")
