"""How often `diagnose` is right.

Linear systems, centres and conveyors are drawn at random. Each case is shown, and added to the file, as soon as it is judged: a run that is cut loses none.

The truth comes from eigenvalues of the whole, from the multipliers of the coupling theory, and from the
Floquet multipliers of the conveyor's own equations. Every stated ratio must lie within its error, none
may be stated for a centre, and at most 5 % of the conveyors may be refused.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import random
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pythonfmu import FmuBuilder
from scipy.integrate import solve_ivp

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import Diagnosis, SetupError, System, diagnose
from cosim.analysis.coupling_theory import Ideal, LinearPart, Scheme
from cosim.verification.systems import couple

#: The page that this backs, and its heading.
CLAIM = ("docs/micron_steps.md", "Which step does my system need?")

NATIVE = ROOT / "fmus" / "native"
#: Sidebands of a Floquet exponent that may be stated: a convention.
MAX_SIDEBAND = 8
#: Most refused conveyors, relative: what the benchmark demands.
MAX_REFUSED = 0.05
#: Size of a multiplier of a step up to which it is that of a stored value, 0 but for rounding; a convention.
NO_MODE = 1e-6


@dataclass(frozen=True)
class Case:
    """What was stated of a system, and what is true: all NaN where nothing was stated.

    `ratio` is the difference of the damping ratio from the truth by its error, `step_ratio` that of the
    damping ratio at the step.
    """

    kind: str
    seed: int
    stated: bool
    damping: float = math.nan
    truth: float = math.nan
    ratio: float = math.nan
    step_ratio: float = math.nan
    reason: str = ""


def linear_case(seed: int) -> Case:
    """Two masses with springs and dampers to the ground and between them, in two parts."""
    draw = random.Random(seed)
    m, n = (10 ** draw.uniform(-1.0, 1.0) for _ in "ab")
    c, k = (10 ** draw.uniform(0.0, 3.0) * draw.choice([0, 1, 1]) for _ in "ab")
    between, share = 10 ** draw.uniform(0.0, 3.0), 10 ** draw.uniform(-4.0, 0.0)
    d, e, both = (
        share * draw.uniform(0.0, 2.0) * math.sqrt(stiffness * mass)
        for stiffness, mass in ((c, m), (k, n), (between, m))
    )
    units = {
        "a": LinearPart([[0, 1], [-c / m, -d / m]], [[0], [1 / m]], np.eye(2), [0.1, 0], ["b.1"]),
        "b": LinearPart(
            [[0, 1], [-(k + between) / n, -(e + both) / n]], [[0, 0], [between / n, both / n]],
            [[between, both]], [0, 0.2], ["a.1", "a.2"], D=[[-between, -both]],
        ),
    }  # fmt: skip
    A = np.array(
        [
            [0, 1, 0, 0],
            [-(c + between) / m, -(d + both) / m, between / m, both / m],
            [0, 0, 0, 1],
            [between / n, both / n, -(k + between) / n, -(e + both) / n],
        ]
    )
    modes = np.linalg.eigvals(A)
    h = 2 * math.pi / np.abs(modes).max() / 10 ** draw.uniform(0.8, 2.3)
    algorithm = draw.choice(["jacobi", "gauss-seidel", "strang"])
    system = couple(units, ROOT / "fmus" / "LinearSystem.fmu")
    z = Ideal(units).eigenvalues(Scheme(algorithm), h)
    steps = np.log(z[np.abs(z) > NO_MODE]) / h
    return judged(
        "linear", seed, lambda: diagnose(system, step=h, algorithm=algorithm), modes, steps
    )


def conveyor_case(seed: int) -> Case:
    """A linear motor that turns a vibrating conveyor with a long rod, on its periodic orbit."""
    draw = random.Random(seed)
    J, r, m = draw.uniform(0.3, 1.0), draw.uniform(0.005, 0.015), draw.uniform(100.0, 300.0)
    c, alpha = 10 ** draw.uniform(4.5, 5.5), draw.uniform(0.0, 1000.0)
    T, zeta = 10 ** draw.uniform(-2.0, -1.0), draw.uniform(0.05, 0.4)
    nu, algorithm = draw.uniform(20.0, 60.0), draw.choice(["jacobi", "gauss-seidel", "strang"])
    B = J / (4.0 * zeta**2 * T)
    count = draw.choice([64, 128, 256])
    turn = 2 * math.pi / nu
    load = alpha * r**2 / 2 * nu
    start: dict[str, Any] = {
        "motor.A": load + B * nu, "motor.B": B, "motor.T": T, "motor.tau": load,
        "conveyor.rotor.J": J, "conveyor.crank.r": r, "conveyor.trough.m": m,
        "conveyor.trough.d": alpha, "conveyor.spring.c": c, "conveyor.w": nu,
    }  # fmt: skip
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    parts = {"motor": NATIVE / "DriveMotor.fmu", "conveyor": NATIVE / "CrankConveyor.fmu"}
    system = System(parts, wires, start)
    settle = 30.0 * max(turn, 2 * T, J / B)

    def rates(_: float, x: Any) -> Any:
        phi, w, tau = x[:3]
        slope, bend = r * np.cos(phi), -r * np.sin(phi)
        torque = c * r * np.sin(phi) * slope + alpha * slope**2 * w + m * slope * bend * w**2
        return [w, (tau - torque) / (J + m * slope**2), (load + B * (nu - w) - tau) / T]

    orbit = solve_ivp(rates, (0.0, settle), [0.0, nu, load], rtol=1e-11, atol=1e-11).y[:, -1]

    def after_half_turn(x: Any) -> Any:
        def turned(_: float, y: Any) -> Any:
            return y[0] - orbit[0] - math.pi

        turned.terminal = True  # type: ignore[attr-defined]
        run = solve_ivp(rates, (0.0, 2 * turn), x, events=turned, rtol=1e-12, atol=1e-12)
        return np.append(run.y[1:, -1], run.t[-1])

    delta = 1e-5
    columns = []
    for i in (1, 2):
        size = np.zeros(3)
        size[i] = delta * max(1.0, abs(orbit[i]))
        columns.append(
            (after_half_turn(orbit + size) - after_half_turn(orbit - size)) / 2 / size[i]
        )
    period = after_half_turn(orbit)[2]
    mu = np.linalg.eigvals(np.array(columns).T[:2])
    log = np.log(mu + 0j)
    sidebands = log.imag[:, None] + 2 * math.pi * np.arange(MAX_SIDEBAND)
    modes = ((log.real[:, None] + 1j * sidebands) / period).ravel()

    def stated() -> Diagnosis:
        return diagnose(system, step=turn / count, algorithm=algorithm, settle=settle)

    return judged("conveyor", seed, stated, modes, None)


def centre_case(seed: int, half: Path) -> Case:
    """Hunters and prey on an orbit around their centre: no damping may be stated."""
    draw = random.Random(seed)
    a, b = draw.uniform(0.5, 2.0), draw.uniform(0.5, 2.0)
    parts = {"prey": f"x1 * ({a!r} - u1)", "hunter": f"x1 * (u1 - {b!r})"}
    start: dict[str, Any] = {f"{name}.f1": rate for name, rate in parts.items()}
    start |= {"prey.x1": b * draw.uniform(0.4, 2.5), "hunter.x1": a * draw.uniform(0.4, 2.5)}
    start |= {"prey.u2": 0.0, "hunter.u2": 0.0}
    wires = ["prey.x1 -> hunter.u1", "hunter.x1 -> prey.u1"]
    system = System(dict.fromkeys(parts, half), wires, start)
    step, settle = 10 ** draw.uniform(-2.0, -0.7), draw.choice([0.0, draw.uniform(0.0, 20.0)])
    algorithm = draw.choice(["jacobi", "gauss-seidel", "strang"])

    def stated() -> Diagnosis:
        return diagnose(system, step=step, algorithm=algorithm, settle=settle)

    return judged("centre", seed, stated, np.array([1j]), None)


def judged(kind: str, seed: int, stated: Callable[[], Diagnosis], modes: Any, steps: Any) -> Case:
    """Compare what is stated with the mode next to it."""
    refused = partial(Case, kind, seed, stated=False)
    try:
        diagnosis = stated()
    except SetupError as error:
        return refused(reason=str(error))
    if not diagnosis.damped:
        return refused(reason=diagnosis.text()[:60])
    zeta = diagnosis.damping
    s = diagnosis.frequency * complex(-zeta, math.sqrt(1.0 - zeta**2))
    near = min(modes, key=lambda mode: abs(mode - s))
    truth = float(-near.real / abs(near))
    step_ratio = math.nan
    if steps is not None:
        step_damping = min(
            (-s.real / abs(s) for s in steps), key=lambda x: abs(x - diagnosis.damping_seen)
        )
        error = max(diagnosis.damping_seen_error, 1e-12)
        step_ratio = float(abs(step_damping - diagnosis.damping_seen) / error)
    ratio = float(abs(zeta - truth) / diagnosis.error)
    return Case(
        kind, seed, stated=True, damping=zeta, truth=truth, ratio=ratio, step_ratio=step_ratio
    )


def row(case: Case) -> str:
    """One line for one system, shown as soon as it is judged."""
    if not case.stated:
        return f"{case.kind:10} {case.seed:6} nothing stated: {case.reason}"
    at_step = "" if math.isnan(case.step_ratio) else f", at the step {case.step_ratio:.2g}"
    return (
        f"{case.kind:10} {case.seed:6} damping ratio {case.damping:.6g}, true {case.truth:.6g}: "
        f"{case.ratio:.2g} of its error{at_step}"
    )


def summary(kind: str, cases: list[Case]) -> str:
    """One line of the table."""
    stated = [case for case in cases if case.stated]
    outside = [case for case in stated if not case.ratio <= 1.0]
    refused = len(cases) - len(stated)
    outside_at_step = [case for case in stated if case.step_ratio > 1.0]
    worst = max((case.ratio for case in stated), default=math.nan)
    return (
        f"{kind:10} {len(cases):4} systems, {refused:4} refused, {len(outside):3} outside their "
        f"error (worst {worst:.2g} times), {len(outside_at_step):3} outside at the step"
    )


def complaints(cases: list[Case]) -> list[str]:
    """What the demands on the damping ratios leave to complain of, one line each."""
    stated = [case for case in cases if case.stated]
    lines = [
        f"{case.kind} {case.seed}: the damping ratio {case.damping:.6g} is {case.ratio:.3g} times its "
        f"error from the truth {case.truth:.6g}"
        for case in stated
        if case.kind != "centre" and not case.ratio <= 1.0
    ]
    lines += [
        f"{case.kind} {case.seed}: a damping ratio is stated, and it has none"
        for case in stated
        if case.kind == "centre"
    ]
    conveyors = [case for case in cases if case.kind == "conveyor"]
    refused = sum(not case.stated for case in conveyors)
    if refused > MAX_REFUSED * len(conveyors):
        share = 100 * refused / len(conveyors)
        lines.append(
            f"{share:.3g} % of the conveyors are refused, more than {100 * MAX_REFUSED:g} %"
        )
    return lines


def main() -> int:
    """Run the benchmark; 1 if it fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    for kind, count in (("linear", 200), ("centres", 100), ("conveyors", 100)):
        parser.add_argument(f"--{kind}", type=int, default=count)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, help="file to which each case is added as a line of JSON"
    )
    options = parser.parse_args()
    for name in ("DriveMotor", "CrankConveyor"):
        if not (NATIVE / f"{name}.fmu").is_file():
            parser.error(f"{NATIVE / name}.fmu is missing: build_fmus.py --flavour native makes it")
    seeds = {
        kind: range(options.seed, options.seed + getattr(options, kind))
        for kind in ("linear", "centres", "conveyors")
    }
    cases: dict[str, list[Case]] = {kind: [] for kind in seeds}
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "half.py", dest=folder)
        half = Path(folder) / "Half.fmu"
        judges: dict[str, Callable[[int], Case]] = {
            "linear": linear_case, "centres": partial(centre_case, half=half), "conveyors": conveyor_case
        }  # fmt: skip
        for kind, judge in judges.items():
            for seed in seeds[kind]:
                case = judge(seed)
                cases[kind].append(case)
                print(row(case), file=sys.stderr, flush=True)
                if options.out is not None:
                    with options.out.open("a", encoding="utf-8") as lines:
                        lines.write(json.dumps(asdict(case)) + "\n")
    for kind, of_kind in cases.items():
        print(summary(kind, of_kind))
    complaint_lines = complaints([case for of_kind in cases.values() for case in of_kind])
    print("\n".join(complaint_lines or ["Verdict: all demands are met."]))
    if complaint_lines:
        print(f"Verdict: {len(complaint_lines)} violations of the demands.")
    return int(bool(complaint_lines))


if __name__ == "__main__":
    sys.exit(main())
