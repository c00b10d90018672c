"""From nothing to a changed motor and its new resonance, line by line.

All you need is Python 3.11 or newer. In the folder of the project, this sets everything up and runs it:

    python3 -m venv .venv && .venv/bin/pip install -q uv && .venv/bin/uv run --no-dev python examples/tutorial.py

Then start `.venv/bin/python` there and enter the lines yourself. The comments `# prints:` show what
you should see.
"""

# %% The parts: two FMUs, made from components/drive_motor and components/crank_conveyor

import argparse
import cmath
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from fmpy import read_model_description
from scipy.optimize import brentq

from cosim import System, certify, run
from cosim.metrics import Largest, harmonics
from scenarios.conveyor.first_order import SETS, Machine

argparse.ArgumentParser(description=__doc__).parse_args()
build = [sys.executable, "build_fmus.py", "drive_motor", "crank_conveyor"]
subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
motor = Path("fmus/DriveMotor.fmu")
conveyor = Path("fmus/CrankConveyor.fmu")

for variable in read_model_description(motor).modelVariables:
    if variable.causality in ("input", "output"):
        print(f"{variable.causality} {variable.name} [{variable.unit}]: {variable.description}")
# prints: input w [rad/s]: Speed of the shaft
# prints: output tau [N.m]: Torque on the shaft, in the sense of +w
# prints: output tau_static [N.m]: Torque of the static characteristic
# prints: output P [W]: Mechanical power given to the shaft

# %% The motor without a load: its speed jumps from 40 to 39 rad/s, and its torque follows with the lag T

motor_run = run(System({"motor": motor}, start={"motor.w": 39.0}), stop=1.0, step=1e-3)
for t in (0.0, 0.0625, 1.0):
    print(f"{t:.4f} s: {motor_run['motor.tau'][round(t / 1e-3)]:.1f} N m")
# prints: 0.0000 s: 8.0 N m
# prints: 0.0625 s: 133.7 N m
# prints: 1.0000 s: 207.8 N m

# %% Motor and conveyor, coupled by torque and speed

WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
drive = System({"motor": motor, "conveyor": conveyor}, WIRES)
result = run(drive, stop=2.0, step=1e-3)
torque = result["motor.tau"][1000:]
print(f"torque of the motor: {torque.min():.0f} to {torque.max():.0f} {result.units['motor.tau']}")
# prints: torque of the motor: -96 to 114 N.m

# The load needs 8 N m on average; the rest is ripple. Is it real, or an artefact of the coupling?

certified = certify(drive, {"peak": Largest("motor.tau", begin=1.0)}, stop=2.0, step=2.5e-4)
print(certified.figures["peak"])
# prints: 114.04235 +- 0.00045 N.m

Path("results").mkdir(exist_ok=True)
result.plot(["motor.tau", "conveyor.w"], Path("results/tutorial.png"))

# %% The resonance: the speed at which the motor's ripple lags the load's ripple by 90 degrees


def lag(machine: Machine, speed: float) -> float:
    """Lag [deg] of the motor's torque ripple at this mean speed [rad/s], in steady state."""
    step = 2 * math.pi / speed / 128
    system = System({"motor": motor, "conveyor": conveyor}, WIRES, machine.start(speed))
    end = run(system, stop=24 * 128 * step, step=step)
    phi = end["conveyor.phi"]
    settled = phi >= phi[-1] - 6 * 2 * math.pi
    ripple = harmonics(phi[settled], end["motor.tau"][settled])[1]
    return math.degrees(cmath.phase(machine.load_ripple(speed) / ripple)) % 360.0


stiff = SETS["A"]
for speed in (36.0, 40.0, 44.0):
    print(f"{speed} rad/s: the motor's ripple lags by {lag(stiff, speed):.0f} degrees")
# prints: 36.0 rad/s: the motor's ripple lags by 44 degrees
# prints: 40.0 rad/s: the motor's ripple lags by 90 degrees
# prints: 44.0 rad/s: the motor's ripple lags by 133 degrees

resonance = brentq(lambda speed: lag(stiff, speed) - 90.0, 36.0, 44.0, xtol=0.01)
print(f"90 degrees at {resonance:.1f} rad/s; the formula says {stiff.nu_res:.1f}")
# prints: 90 degrees at 40.0 rad/s; the formula says 40.0

# %% Another motor: twice the lag

slow = replace(stiff, T=0.125)
resonance = brentq(lambda speed: lag(slow, speed) - 90.0, 25.0, 32.0, xtol=0.01)
print(f"T = {slow.T} s: 90 degrees at {resonance:.1f} rad/s; the formula says {slow.nu_res:.1f}")
# prints: T = 0.125 s: 90 degrees at 28.3 rad/s; the formula says 28.3

# The resonance fell with the square root of the lag, from 40 to 28.3 rad/s. To sweep all speeds at
# once and get a picture: .venv/bin/scenarios run resonance
