"""The verification suite passes, and what it takes for truth is true.

Its ideal algorithms are held against classical methods, closed solutions and published figures, so
that suite and master cannot be wrong together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim.engine.initialise
from cosim import ALGORITHMS, SetupError, System, run
from tests.cosim import verification as checks
from tests.cosim.verification import (
    HOLDING,
    MOTOR,
    SCHEMES,
    SUBSTEPS,
    orders,
    simulate,
)
from tests.coupling_theory import Ideal, LinearPart, Scheme
from tests.linear_systems import BENCHMARKS, SPRING_AND_MASS, couple, states

ALL = SCHEMES | HOLDING | SUBSTEPS


def test_states_and_residuals_have_the_orders_of_their_algorithms(fmus: Path) -> None:
    """The part of the suite that says most, on one system with feedthrough."""
    drive = BENCHMARKS["drive"]
    for title, scheme in (SCHEMES | HOLDING).items():
        rows = list(checks.orders(fmus / "LinearSystem.fmu", "drive", drive, title, scheme))
        assert rows and [row for row in rows if not row.passed] == []


@pytest.mark.slow
def test_every_check_of_the_suite_passes(fmus: Path) -> None:
    rows = list(checks.verify(fmus / "LinearSystem.fmu"))
    assert [row for row in rows if not row.passed] == []
    covered = {(row.system, ALL[row.scheme].algorithm) for row in rows if row.scheme in ALL}
    assert covered >= set(product(BENCHMARKS, ALGORITHMS))
    assert {row.quantity for row in rows} == {
        "order of the states",
        "order of the residual",
        "residual of the energy",
        "stability limit [s]",
        "energy made / initial energy",
        "order of the energy not booked",
        "exponent of the tolerance",
    }


def wrong_sign(patch: pytest.MonkeyPatch) -> None:
    def connected(network: Any, parts: Any, start: float) -> Any:
        slots = connect(network, parts, start)
        for link in parts["load"].links:
            link.factor = -link.factor
        return slots

    connect = cosim.engine.initialise._connect
    patch.setattr(cosim.engine.initialise, "_connect", connected)


def ledger_of_the_wrong_sign(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(cosim.engine.initialise, "watts_per_product", lambda *_: -1.0)


MUTANTS: dict[Callable[[pytest.MonkeyPatch], None], tuple[bool, bool]] = {
    wrong_sign: (False, False),
    ledger_of_the_wrong_sign: (True, False),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_suite_detects_a_wrong_master(
    fmus: Path, monkeypatch: pytest.MonkeyPatch, mutant: Callable[[pytest.MonkeyPatch], None]
) -> None:
    """Of states and ledger, those are called wrong that are."""
    benchmark = replace(BENCHMARKS["drive"], steps=10)
    mutant(monkeypatch)
    rows = orders(fmus / "LinearSystem.fmu", "drive", benchmark, "strang", SCHEMES["strang"])
    assert tuple(row.match < checks.SAME for row in rows) == MUTANTS[mutant]


K, M, H = 50.0, 2.0, 0.02


def euler(s: float, v: float, _: float, __: float) -> tuple[float, float]:
    return s + H * v, v - H * K / M * s


def semi_implicit_euler(s: float, v: float, _: float, __: float) -> tuple[float, float]:
    s += H * v
    return s, v - H * K / M * s


def velocity_verlet(s: float, v: float, _: float, __: float) -> tuple[float, float]:
    half = s + H / 2 * v
    v -= H * K / M * half
    return half + H / 2 * v, v


def implicit_euler(s: float, v: float, _: float, __: float) -> tuple[float, float]:
    v = (v - H * K / M * s) / (1 + H * H * K / M)
    return s + H * v, v


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
    "jacobi": euler,
    "gauss-seidel": semi_implicit_euler,
    "strang": velocity_verlet,
    "iterated": implicit_euler,
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
    assert checks.longest_step(ideal, SCHEMES["jacobi"]) == pytest.approx(T_M, rel=1e-9)
    for title in ("gauss-seidel", "strang"):
        H_c = checks.longest_step(ideal, ALL[title])
        assert H_c / T_M * math.tanh(H_c / (2 * T)) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("problem", ["dual mass", "drive"])
def test_the_ledger_of_gauss_seidel_telescopes(fmus: Path, problem: str) -> None:
    """The first part hears old values, the second new ones: h / 2 (p_0 q_0 - p_N q_N) is left."""
    benchmark, h = BENCHMARKS[problem], 1e-3
    flow, effort = benchmark.bond
    ideal = Ideal(benchmark.units)
    supplied, taken = ideal.energy(SCHEMES["gauss-seidel"], [h] * 15, benchmark.bond)
    values = ideal.run(SCHEMES["gauss-seidel"], [h] * 15)
    first = len(ideal.x0)
    p, q = (values[:, first + ideal.outputs.index(name)] for name in (flow, effort))
    left = h / 2 * (p[0] * q[0] - p[-1] * q[-1])
    assert supplied - taken == pytest.approx(left, rel=1e-10)
    fmu = fmus / "LinearSystem.fmu"
    scheme = SCHEMES["gauss-seidel"]
    [result] = simulate(fmu, benchmark.units, scheme, 15 * h, [h], bond=benchmark.bond)
    assert next(iter(result.energy.values()))["residual"] == pytest.approx(left, rel=1e-10)


def test_the_ledger_of_jacobi_is_the_cross_product(fmus: Path) -> None:
    """Either part hears old values: h / 2 (p_n+1 q_n - q_n+1 p_n) is left of every step."""
    benchmark, h = BENCHMARKS["drive"], 1e-4
    system = couple(benchmark.units, fmus / "LinearSystem.fmu", bond=benchmark.bond)
    record = ["shaft.z[1]", "load.y[2]"]
    result = run(system, stop=0.02, step=h, algorithm="jacobi", record=record)
    p, q = result.data[:, 1:].T
    left = h / 2 * (p[1:] * q[:-1] - q[1:] * p[:-1]).sum()
    assert next(iter(result.energy.values()))["residual"] == pytest.approx(left, rel=1e-10)


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
