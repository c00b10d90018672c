"""Some fifty wrong equations and rules, each of which a test must notice.

They are wrong signs, factors, wires, errors and answers, set one at a time. A mutant is set in a copy of the project, and the tests that should notice it run there until one fails. Where
code has moved, the words say how to set it again. Exit status 1 if a mutant survives, or cannot be set.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree, ignore_patterns
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest

#: The page that this backs, and its heading.
CLAIM = ("CONTRIBUTING.md", "Contributing")

ROOT = Path(__file__).resolve().parents[1]


class Mutant(NamedTuple):
    """Words for what is wrong, the file, its text and the wrong text, and tests that should fail."""

    words: str
    file: str
    right: str
    wrong: str
    tests: str


PHYSICS = "tests/components/test_physics.py"
PARTS = "tests/components/test_drive_parts.py"
IRON = "tests/components/test_iron_drive.py"
FLIGHT = "tests/components/test_iron_flight.py"
ORIENTATOR = "tests/components/test_gravity_orientator.py"
LOOP = "tests/cosim/test_loop.py tests/cosim/test_cosim.py tests/cosim/test_verification.py"
ALGORITHMS = (
    "tests/cosim/test_algorithms.py tests/cosim/test_stepping.py tests/cosim/test_verification.py"
)
TRUTH = "tests/scenarios/test_truth.py"
JUDGEMENTS = "tests/workbench/test_judgement.py"
STUDIES = "tests/workbench/test_studies.py"
FIGURE = "tests/workbench/test_figure.py"
SHARES = "tests/workbench/test_shares.py"
REMEDIES = "tests/workbench/test_remedies.py"
FIND = "tests/workbench/test_find.py"
ORBIT = "tests/scenarios/test_orbit.py"
TRACE = "tests/fmukit/test_jet.py tests/fmukit/test_ops.py tests/fmukit/test_exchange.py"

MUTANTS = (
    Mutant("DriveMotor: the slope of the characteristic has the wrong sign",
           "components/drive_motor/model.py", "return p.A - p.B * w", "return p.A + p.B * w", PARTS),
    Mutant("DriveMotor: Kloss' formula without its factor 2",
           "components/drive_motor/model.py", "return 2.0 * p.kloss.tau_b", "return p.kloss.tau_b", PHYSICS),
    Mutant("CrankConveyor: the spring drives the crank instead of opposing it",
           "components/crank_conveyor/model.py", "M_c = c * position * dx + d", "M_c = -c * position * dx + d",
           PHYSICS),
    Mutant("CrankConveyor: the reduced inertia has half of the trough's",
           "components/crank_conveyor/model.py", "p.rotor.J + m * dx * dx", "p.rotor.J + m * dx * dx / 2", PHYSICS),
    Mutant("CrankConveyor: theta' w^2 / 2 is taken twice",
           "components/crank_conveyor/model.py", "M_c + m * dx * ddx", "M_c + 2 * m * dx * ddx", PHYSICS),
    Mutant("CrankConveyor: the finite rod's second derivative lacks its last term",
           "components/crank_conveyor/model.py", " - (s * c) ** 2 / R**3\n", "\n", PHYSICS),
    Mutant("DCMotor: the induced voltage has the sign of a generator",
           "components/DC_motor/model.py", "(u.v - p.k * u.w - p.R * x.i) / p.L",
           "(u.v + p.k * u.w - p.R * x.i) / p.L", PARTS),
    Mutant("Gearbox: the torque of side b is not divided by the ratio",
           "components/gearbox/model.py", "(u.tau_a + u.tau_b / p.i", "(u.tau_a + u.tau_b", PARTS),
    Mutant("ShaftLink: the shaft pushes both sides the same way (wire of the torque crossed)",
           "components/shaft_link/model.py", "tau_a=-(spring + damping)", "tau_a=spring + damping", PARTS),
    Mutant("SpeedController: the integrator winds up although the torque is limited (sign of tracking)",
           "components/speed_controller/model.py", "rise + (tau - free)", "rise - (tau - free)", PARTS),
    Mutant("SlottedLink: the load's mass is left out of the reduced inertia",
           "components/slotted_link/model.py", "(p.trough.m + p.load.m) * x.first", "p.trough.m * x.first", PHYSICS),
    Mutant("UnbalanceExciter: the rotor pulls with sin(phi) instead of cos(phi)",
           "components/unbalance_exciter/model.py", "x.w * x.w * cos(x.phi)", "x.w * x.w * sin(x.phi)",
           PHYSICS),
    Mutant("IronDrive: friction in the guide acts along the motion",
           "components/iron_drive/dynamics.py", "p.friction.K_up if up > 0 else p.friction.K_down",
           "p.friction.K_down if up > 0 else p.friction.K_up", IRON),
    Mutant("IronDrive: B_1 has J' instead of J' / 2",
           "components/iron_drive/dynamics.py", "at.J_1 / 2 + K", "at.J_1 + K", IRON),
    Mutant("IronDrive: the chain hanging between sprocket and iron weighs nothing",
           "components/iron_drive/dynamics.py", "T_iron + rho * at.H.value * (p.g", "T_iron + 0 * rho * (p.g", IRON),
    Mutant("IronDrive: in flight the cam's shaft lacks the geared inertia of the rotor",
           "components/iron_drive/flight.py", "p.reducer.J * p.reducer.i_g * p.reducer.i_g + p.cam.J",
           "p.reducer.J * p.reducer.i_g + p.cam.J", FLIGHT),
    Mutant("GravityOrientator: the product's centrifugal force acts at the chute's radius",
           "components/gravity_orientator/loads.py", "w * w * (R - d / 2)", "w * w * R", ORIENTATOR),
    Mutant("GravityOrientator: inertia torque J' w^2 / 2 of stage joint drives",
           "components/gravity_orientator/stages.py", " - at.half_dJ * x.w1 * x.w1", " + at.half_dJ * x.w1 * x.w1",
           ORIENTATOR),
    Mutant("GravityOrientator: the mass matrix of stage turning loses its coupling",
           "components/gravity_orientator/stages.py", "m * z1 * z2, p.cup.J", "0 * m * z1 * z2, p.cup.J", ORIENTATOR),
    Mutant("Gauss-Seidel steps its parts side by side, as Jacobi does",
           "cosim/engine/algorithms/gauss_seidel.py", "[(Turn(part),) for part in parts]",
           "[tuple(Turn(part) for part in parts)]", ALGORITHMS),
    Mutant("Strang: the second halves are not in reverse",
           "cosim/engine/algorithms/strang.py", "for part in reversed(first)]", "for part in first]",
           f"{ALGORITHMS} tests/cosim/test_linearize.py"),
    Mutant("Iterated takes the mean of both ends of the step: another method of another order",
           "cosim/engine/algorithms/iterated.py", "end_weight = 1.0", "end_weight = 0.5", ALGORITHMS),
    Mutant("loop.c: a wire with a unit loses its offset",
           "cosim/engine/loop.c", "*cells = op->factor * *source + op->offset;", "*cells = op->factor * *source;",
           LOOP),
    Mutant("loop.c: the energy of a bond is the rectangle instead of the trapezoid",
           "cosim/engine/loop.c", "size * 0.5 * (before + *source * *op->last)", "size * (before)", LOOP),
    Mutant("ops.py: the derivative of a quotient adds where it subtracts",
           "fmukit/trace/ops.py", "plus(da, -times(n, db) if", "plus(da, times(n, db) if", TRACE),
    Mutant("first-order theory: the trough's inertia adds to the spring instead of opposing it",
           "scenarios/conveyor/first_order.py", "(self.c - self.m * nu**2 + 1j", "(self.c + self.m * nu**2 + 1j", TRUTH),
    Mutant("resonance: the lag is the sum of both phases, not their difference",
           "scenarios/conveyor/orbit.py", "(phase - x) % 360.0", "(phase + x) % 360.0", TRUTH),
    Mutant("orbit: a mean over time is one over the crank angle",
           "workbench/orbits.py", "x = x * TURN / (turns.of(self.batch.method.rate) * turns.periods[..., None])", "pass",
           f"{TRUTH} {ORBIT}"),
    Mutant("packing line: the ripple of a power is its amplitude instead of its mean square",
           "scenarios/packing_line/power.py", "math.sqrt(rms**2 - mean**2)", "math.sqrt(2.0 * (rms**2 - mean**2))", TRUTH),
    Mutant("conveyor: the limit of the torque ripple is twice as large",
           "scenarios/conveyor/options.py", "self.limit / 100 *", "self.limit / 50 *", TRUTH),
    Mutant("iron_cycle: a safe speed is called one to avoid",
           "scenarios/iron/questions/iron_cycle.py", 'yes=f"{at} is safe"', 'yes=f"Avoid {at}"', TRUTH),
    Mutant("conveyor: a peak of the rod force between angles is cut off instead of rounded up",
           "workbench/orbits.py", "lift = np.where(is_turn, -(rise**2)", "lift = np.where(is_turn, (rise**2)",
           ORBIT),
    Mutant("sommerfeld: the supply of the jump is that of the speed after it",
           "scenarios/exciter/questions/sommerfeld.py", 'up, down = r[0], f["supply_up"], f["supply_down"]',
           'down, up = r[0], f["supply_up"], f["supply_down"]', TRUTH),
    Mutant("judgement: what may be on either side of its bound is a no",
           "workbench/judgement.py", "if any(room + error < 0.0 for", "if any(room - error < 0.0 for", JUDGEMENTS),
    Mutant("judgement: the error of a bound is dropped",
           "workbench/judgement.py", "(figure.error + bound.error) / scale", "figure.error / scale", JUDGEMENTS),
    Mutant("study: a uniform tolerance reaches half as far up",
           "workbench/study/file.py", "stats.uniform(nominal - width, 2.0 * width)", "stats.uniform(nominal - width, width)",
           STUDIES),
    Mutant("study: the last point of a grid is left out",
           "workbench/study/file.py", "(low, high, number).tolist()", "(low, high, number + 1).tolist()[:-1]", STUDIES),
    Mutant("study: a share is as sure as if the limit lay in no error",
           "workbench/study/words.py", "interval(count, number, more) if is_sample", "interval(count, number) if is_sample", SHARES),
    Mutant("figure: a number in another unit keeps the error of the first",
           "workbench/figure.py", "abs(factor) * figure.error", "figure.error", FIGURE),
    Mutant("figure: figures go to the ends of their errors one by one, never together",
           "workbench/figure.py", "np.concatenate([one, -one, np.array([*product(*signs)])])", "np.concatenate([one, -one])",
           f"{FIGURE} tests/workbench/test_numbers.py"),
    Mutant("limit: a difference of runs counts a tenth where no order is confirmed",
           "cosim/accuracy/limit.py", "UNCONFIRMED_FACTOR = 3.0", "UNCONFIRMED_FACTOR = 0.3",
           "tests/cosim/test_limit.py tests/cosim/test_certify.py"),
    Mutant("master: a jump of an input within a step is no break",
           "cosim/engine/controllers.py", "                breaks.append(broken)", "                pass",
           "tests/cosim/test_columns.py tests/cosim/test_inputs.py"),
    Mutant("referee: a delay is sought in the other sense of time",
           "cosim/accuracy/referee/causes.py", "signal.values - np.interp(t - delay, t, x)",
           "signal.values - np.interp(t + delay, t, x)", "tests/cosim/test_referee.py"),
    Mutant("judgement: how far a claim is from turning has the same sign where one does not want it",
           "workbench/judgement.py", "(room if self.is_wanted else -room), error", "room, error",
           f"{JUDGEMENTS} {REMEDIES}"),
    Mutant("certify: what the rows between leave open is that of every second row, never of every third",
           "cosim/accuracy/judge.py", "np.maximum(third / (3.0**q - 1.0), second / (2.0**q - 1.0))",
           "second / (2.0**q - 1.0)", "tests/cosim/test_certify.py"),
    Mutant("find: the grid is never halved",
           "workbench/find.py", "is_settled = number > FIRST and", "is_settled = number >= FIRST or", FIND),
    Mutant("find: a plateau at the level is a crossing",
           "workbench/find.py", "(runs == STRETCH).any()", "(runs > STRETCH).any()", FIND),
    Mutant("orbits: a search that begins on the orbit reads its multipliers off rounding",
           "workbench/steady.py", "DISPLACEMENT = 1e-4", "DISPLACEMENT = 0.0", ORBIT),
    Mutant("orbits: what even angles cannot tell is no error",
           "workbench/orbits.py", "turns.settling_error(of_both) + missed[:, 1]", "turns.settling_error(of_both)", ORBIT),
    Mutant("branches: a step counts wherever the search back leads",
           "workbench/branches.py", "if self.is_same(back, w.states):", "if True:",
           f"tests/workbench/test_branches.py {ORBIT}"),
    Mutant("remedies: values are rounded to the side where the judgement is not yet turned",
           "workbench/remedies.py", "upward = side if x.is_upper else -side", "upward = -side if x.is_upper else side", REMEDIES),
    Mutant("study: runs whose limit lies in their error count for neither side",
           "workbench/study/words.py", "near = rows & ~above & (y + error > limit)", "near = rows & ~above & (y > limit)", SHARES),
    Mutant("formula: a remainder has the sign of what is divided",
           "workbench/formula.py", "np.fmod(np.fmod(x, y) + y, y)", "np.fmod(x, y)", "tests/workbench/test_live_parts.py"),
    Mutant("nameplate: the inertia of the rotor grows by the ratio of the gear, not by its square",
           "scenarios/motor.py", "plate.inertia * plate.ratio**2", "plate.inertia * plate.ratio", "tests/scenarios/test_motor.py"),
    Mutant("live page: the ripple of a turn is half of its amplitude",
           "workbench/live/js/readers.js", "const scale = 2 / (", "const scale = 1 / (", "tests/workbench/test_live.py"),
)  # fmt: skip


def is_noticed(mutant: Mutant, folder: Path) -> bool:
    """Whether a test fails with the mutant set in a copy of the project."""
    copytree(
        ROOT, folder, ignore=ignore_patterns(".git", ".venv", "results", "__pycache__", ".*_cache")
    )
    path = folder / mutant.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutant.right) != 1:
        raise LookupError(f"{mutant.file} has {mutant.right!r} {text.count(mutant.right)} times")
    path.write_text(text.replace(mutant.right, mutant.wrong), encoding="utf-8")
    tests = mutant.tests.split()
    if gone := [name for name in tests if not (folder / name).is_file()]:
        raise LookupError(f"no tests {', '.join(gone)}")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-rf", "-n0", *tests],
        cwd=folder, check=False, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )  # fmt: skip
    for line in done.stdout.splitlines():
        if line.startswith(("FAILED", "ERROR")):
            print(f"    {line}")
    if done.returncode not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise LookupError(f"pytest ended with {done.returncode}")
    return done.returncode == pytest.ExitCode.TESTS_FAILED


def main() -> int:
    """Set the mutants that are asked for; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", type=int, nargs="*", help="which (default: all)")
    parser.add_argument("--list", action="store_true", help="print their words only")
    options = parser.parse_args()
    alive = 0
    for number in options.number or range(1, len(MUTANTS) + 1):
        mutant = MUTANTS[number - 1]
        print(f"{number:2} {mutant.words} ({mutant.file})", flush=True)
        if options.list:
            continue
        with TemporaryDirectory() as folder:
            try:
                noticed = is_noticed(mutant, Path(folder) / "project")
            except LookupError as error:
                print(f"    cannot be set: {error}")
                noticed = False
        print("    noticed" if noticed else "    NOT NOTICED", flush=True)
        alive += not noticed
    return min(1, alive)


if __name__ == "__main__":
    sys.exit(main())
