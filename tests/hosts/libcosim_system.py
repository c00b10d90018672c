"""A system in libcosim: JSON task [FILE] -> JSON rows, time [ns] and recorded reals per step.

FILE, an SSP or the folder of an OSP system structure, stands in for what the task says.
"""

import json
import sys
from pathlib import Path

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

log_output_level(CosimLogLevel.ERROR)
task = json.loads(sys.argv[1])
step = round(task["step"] * 1e9)
slaves, references = {}, {}
if arguments := sys.argv[2:]:
    folder = Path(arguments[0]).is_dir()
    execution = (
        CosimExecution.from_osp_config_file(arguments[0])
        if folder
        else CosimExecution.from_ssp_file(arguments[0], step)
    )
    slaves = {name: execution.slave_index_from_instance_name(name) for name in task["parts"]}
else:
    execution = CosimExecution.from_step_size(step)
    for name, fmu in task["parts"].items():
        slaves[name] = execution.add_local_slave(CosimLocalSlave(fmu, name))
for name, slave in slaves.items():
    for variable in execution.slave_variables(slave):
        references[f"{name}.{variable.name.decode()}"] = variable.reference


def port(name: str) -> tuple[int, int]:
    """Slave index and value reference of a dotted name."""
    part = max((part for part in slaves if name.startswith(f"{part}.")), key=len)
    return slaves[part], references[name]


for name, value in () if arguments else task["start"].items():
    kind = "boolean" if isinstance(value, bool) else "real"
    if not getattr(execution, f"{kind}_initial_value")(*port(name), value):
        sys.exit(f"{name} is not set")
for source, target in () if arguments else task["wires"]:
    if execution.connect_real_variables(*port(source), *port(target)):
        sys.exit(f"{target} is not connected")
observer = CosimObserver.create_last_value()
execution.add_observer(observer)

rows = []
for n in range(task["steps"]):
    if not execution.step():
        sys.exit(f"step {n} failed")
    values = [
        observer.last_real_values(slave, [reference])[0]
        for slave, reference in map(port, task["record"])
    ]
    rows.append([execution.status().current_time, *values])
print(json.dumps(rows))
