"""How often `diagnose` is right.

Linear systems, centres and conveyors are drawn at random. The truth comes from eigenvalues of the whole, from the multipliers of the coupling theory, and from the
Floquet multipliers of the conveyor's own equations. Every stated ratio must lie within its error, none
may be stated for a centre, and at most 5 % of the conveyors may be refused. `at_step` is the damping ratio of the coupled
steps, known of linear systems.
"""

from __future__ import annotations

import contextlib
import io
import math
import random
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from pythonfmu import FmuBuilder

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.coverage import Demand, Stated, Study, Trial, main
from cosim import Diagnosis, SetupError, System, diagnose
from tests.coupling_theory import Ideal, LinearPart, Scheme
from tests.linear_systems import couple
from tests.scenarios.orbit_oracle import Drive, orbit

#: The page that this backs, and its heading.
CLAIM = ("docs/micron_steps.md", "Which step does my system need?")

NATIVE = ROOT / "fmus" / "native"
#: Sidebands of a Floquet exponent that may be stated: a convention.
MAX_SIDEBAND = 8
#: Size of a multiplier of a step up to which it is that of a stored value, 0 but for rounding; a convention.
NO_MODE = 1e-6


def linear_case(seed: int) -> Trial:
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
    stated = partial(diagnose, system, step=h, algorithm=algorithm)
    return judged("linear", seed, stated, modes, steps)


def conveyor_case(seed: int) -> Trial:
    """A linear motor that turns a vibrating conveyor with a long rod, on its periodic orbit."""
    draw = random.Random(seed)
    J, r, m = draw.uniform(0.3, 1.0), draw.uniform(0.005, 0.015), draw.uniform(100.0, 300.0)
    c, alpha = 10 ** draw.uniform(4.5, 5.5), draw.uniform(0.0, 1000.0)
    T, zeta = 10 ** draw.uniform(-2.0, -1.0), draw.uniform(0.05, 0.4)
    nu, algorithm = draw.uniform(20.0, 60.0), draw.choice(["jacobi", "gauss-seidel", "strang"])
    drive = Drive(B=J / (4.0 * zeta**2 * T), T=T, J=J, m=m, r=r, c=c, d=alpha)
    turn = 2 * math.pi / nu
    start = {
        "motor.A": drive.slope * nu,
        "motor.tau": (drive.slope - drive.B) * nu,
        "conveyor.w": nu,
    }
    parts = {"motor": NATIVE / "DriveMotor.fmu", "conveyor": NATIVE / "CrankConveyor.fmu"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    system = System(parts, wires, {**drive.start, **start})
    settings = {
        "step": turn / draw.choice([64, 128, 256]), "algorithm": algorithm,
        "settle": 30.0 * max(turn, 2 * T, J / drive.B),
    }  # fmt: skip
    # all repeats after half a revolution of such a machine
    truth = orbit(drive, nu)
    log = np.log(np.linalg.eigvals(truth.transition(2)) + 0j)
    sidebands = log.imag[:, None] + 2 * math.pi * np.arange(MAX_SIDEBAND)
    modes = ((log.real[:, None] + 1j * sidebands) * truth.mean_speed / math.pi).ravel()
    return judged("conveyor", seed, partial(diagnose, system, **settings), modes)


@cache
def half() -> Path:
    """An FMU whose rates are formulas, which is built once in each process."""
    folder = tempfile.mkdtemp()
    with contextlib.redirect_stdout(io.StringIO()):
        FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "half.py", dest=folder)
    return Path(folder) / "Half.fmu"


def centre_case(seed: int) -> Trial:
    """Hunters and prey on an orbit around their centre: no damping may be stated."""
    draw = random.Random(seed)
    a, b = draw.uniform(0.5, 2.0), draw.uniform(0.5, 2.0)
    parts = {"prey": f"x1 * ({a!r} - u1)", "hunter": f"x1 * (u1 - {b!r})"}
    start: dict[str, Any] = {f"{name}.f1": rate for name, rate in parts.items()}
    start |= {"prey.x1": b * draw.uniform(0.4, 2.5), "hunter.x1": a * draw.uniform(0.4, 2.5)}
    start |= {"prey.u2": 0.0, "hunter.u2": 0.0}
    wires = ["prey.x1 -> hunter.u1", "hunter.x1 -> prey.u1"]
    system = System(dict.fromkeys(parts, half()), wires, start)
    step, settle = 10 ** draw.uniform(-2.0, -0.7), draw.choice([0.0, draw.uniform(0.0, 20.0)])
    algorithm = draw.choice(["jacobi", "gauss-seidel", "strang"])
    settings = {"step": step, "algorithm": algorithm, "settle": settle}
    return judged("centre", seed, partial(diagnose, system, **settings))


def judged(
    kind: str, seed: int, stated: Callable[[], Diagnosis], modes: Any = None, steps: Any = None
) -> Trial:
    """Compare what is stated with the mode next to it, and with that of the steps; `modes` is None without damping."""
    began = time.process_time()
    # of a damped system there is a truth, whatever is stated
    exists = None if modes is None else math.nan
    try:
        diagnosis = stated()
        words = "" if diagnosis.damped else diagnosis.text()[:60]
    except SetupError as error:
        words = str(error)
    if words:
        return Trial(kind, seed, {"damping": Stated(None, None, None, exists)}, words=words)
    seconds = time.process_time() - began
    zeta = diagnosis.damping
    truth = None
    if modes is not None:
        s = diagnosis.frequency * complex(-zeta, math.sqrt(1.0 - zeta**2))
        near = min(modes, key=lambda mode: abs(mode - s))
        truth = float(-near.real / abs(near))
    figures = {"damping": Stated.of(zeta, diagnosis.error, truth)}
    if steps is not None:
        seen = diagnosis.damping_seen
        at_step = min((-s.real / abs(s) for s in steps), key=lambda x: abs(x - seen))
        error = max(diagnosis.damping_seen_error, 1e-12)
        figures["at_step"] = Stated.of(seen, error, float(at_step))
    return Trial(kind, seed, figures, seconds)


DRAWS = {"linear": linear_case, "centre": centre_case, "conveyor": conveyor_case}
STUDY = Study(
    __doc__,
    DRAWS,
    number=100,
    demands={"linear": Demand(), "centre": Demand(), "conveyor": Demand(refused=0.05)},
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
