"""Motor and conveyor in libcosim: FOLDER STEPS -> JSON rows of time [ns], tau, w, phi per step."""

import json
import sys
from pathlib import Path

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

STEP = 1_000_000

log_output_level(CosimLogLevel.ERROR)
folder, steps = Path(sys.argv[1]), int(sys.argv[2])
execution = CosimExecution.from_step_size(STEP)
motor = execution.add_local_slave(CosimLocalSlave(str(folder / "DriveMotor.fmu"), "motor"))
conveyor = execution.add_local_slave(CosimLocalSlave(str(folder / "CrankConveyor.fmu"), "conveyor"))
m = {v.name.decode(): v.reference for v in execution.slave_variables(motor)}
c = {v.name.decode(): v.reference for v in execution.slave_variables(conveyor)}
if execution.connect_real_variables(motor, m["tau"], conveyor, c["tau"]):
    sys.exit("motor.tau is not connected")
if execution.connect_real_variables(conveyor, c["w"], motor, m["w"]):
    sys.exit("conveyor.w is not connected")
observer = CosimObserver.create_last_value()
execution.add_observer(observer)

rows = []
for n in range(steps):
    if not execution.step():
        sys.exit(f"step {n} failed")
    tau = observer.last_real_values(motor, [m["tau"]])
    w_phi = observer.last_real_values(conveyor, [c["w"], c["phi"]])
    rows.append([execution.status().current_time, *tau, *w_phi])
print(json.dumps(rows))
