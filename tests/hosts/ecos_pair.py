"""Motor and conveyor in Ecos: FOLDER STEPS -> JSON rows of time [s], tau, w, phi from t = 0 on."""

import ctypes
import json
import sys
from pathlib import Path

ctypes.CDLL(sys.prefix + "/lib/libtbb.so.12", ctypes.RTLD_GLOBAL)

from ecospy import EcosSimulation, EcosSimulationStructure

NAMES = "motor::tau", "conveyor::w", "conveyor::phi"
STEP = 1e-3

folder, steps = Path(sys.argv[1]), int(sys.argv[2])
with EcosSimulationStructure() as structure:
    structure.add_model("motor", folder / "DriveMotor.fmu")
    structure.add_model("conveyor", folder / "CrankConveyor.fmu")
    structure.make_real_connection("motor::tau", "conveyor::tau")
    structure.make_real_connection("conveyor::w", "motor::w")
    with EcosSimulation(STEP, structure=structure) as simulation:
        if not simulation.init():
            sys.exit("initialisation failed")
        rows = []
        for n in range(steps + 1):
            time = simulation.step() if n else simulation.get_time()
            rows.append([time, *map(simulation.get_real, NAMES)])
        simulation.terminate()
print(json.dumps(rows))
