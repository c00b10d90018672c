"""A system in Ecos: JSON task -> JSON rows, the time [s] and the recorded reals from t = 0 on."""

import ctypes
import json
import sys

ctypes.CDLL(sys.prefix + "/lib/libtbb.so.12", ctypes.RTLD_GLOBAL)

from ecospy import EcosSimulation, EcosSimulationStructure


def port(name: str) -> str:
    """motor.kloss.tau_b -> motor::kloss.tau_b."""
    return name.replace(".", "::", 1)


task = json.loads(sys.argv[1])
with EcosSimulationStructure() as structure:
    for name, fmu in task["parts"].items():
        structure.add_model(name, fmu)
    for source, target in task["wires"]:
        structure.make_real_connection(port(source), port(target))
    structure.add_parameter_set("start", {port(k): v for k, v in task["start"].items()})
    with EcosSimulation(task["step"], structure=structure) as simulation:
        if not simulation.init(parameter_set="start"):
            sys.exit("initialisation failed")
        rows = []
        for n in range(task["steps"] + 1):
            time = simulation.step() if n else simulation.get_time()
            rows.append([time, *(simulation.get_real(port(name)) for name in task["record"])])
        simulation.terminate()
print(json.dumps(rows))
