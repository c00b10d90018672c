"""Another co-simulation master, asked for one run after the other.

Each line of standard input is a task. It names FMUs (`parts`), `wires`, `start` values, those of the wired `inputs`, `step` [s], the number of `steps`, an `ssp` of the same
system, and the outputs to `record`. The answer on standard output is JSON: `rows` of the time [s] and the
outputs, the processor time of the steps in `seconds`, and the `versions` of what ran.
masters.py runs this in an environment of the tool's own, which holds nothing of this project.
"""

import argparse
import contextlib
import ctypes
import io
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from types import SimpleNamespace
from typing import Any

#: The page that this backs, and its heading.
CLAIM = ("docs/masters.md", "Repeat it")

Task = dict[str, Any]
Rows = list[list[float]]
#: (rows, processor time of the steps [s])
Answer = tuple[Rows, float]


def split(port: str) -> tuple[str, str]:
    """motor.kloss.tau_b -> (motor, kloss.tau_b)."""
    part, _, variable = port.partition(".")
    return part, variable


def start_of(values: Mapping[str, Any], part: str) -> dict[str, Any]:
    """The start values of one part by its own names."""
    return {split(name)[1]: x for name, x in values.items() if split(name)[0] == part}


def fmpy_ssp(task: Task) -> Answer:
    """FMPy's master of SSP files: Jacobi, inputs held."""
    from fmpy.ssp.simulation import simulate_ssp

    step, steps = task["step"], task["steps"]
    # start values as FMPy reads them from a file: one list for all components
    values = [SimpleNamespace(name=name, value=x) for name, x in task["start"].items()]

    def run(number: int) -> Any:
        # half a step less, since FMPy adds up its steps and would make one more by rounding
        return simulate_ssp(
            task["ssp"],
            stop_time=(number - 0.5) * step,
            step_size=step,
            parameter_set=SimpleNamespace(parameters=values),
        )

    began = time.process_time()
    run(1)
    set_up = time.process_time() - began
    table = run(steps)
    seconds = time.process_time() - began - 2.0 * set_up
    rows = [[float(row["time"]), *(float(row[x]) for x in task["record"])] for row in table]
    return rows, seconds


def pathsim(task: Task, block: Callable[[str, str, dict[str, Any]], Any], **solver: Any) -> Answer:
    """PathSim with a block for each FMU."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import Constant, Scope

    blocks = {
        part: block(fmu, part, start_of(task["start"], part)) for part, fmu in task["parts"].items()
    }
    scope = Scope(labels=task["record"])

    def end(port: str) -> Any:
        part, variable = split(port)
        return blocks[part][variable]

    wires = [Connection(end(a), end(b)) for a, b in task["wires"]]
    wires += [Connection(end(port), scope[k]) for k, port in enumerate(task["record"])]
    # an input without a wire is 0 in PathSim, whatever its start value: a block keeps it
    sources = {
        port: Constant(x)
        for port, x in task["start"].items()
        if split(port)[1] in blocks[split(port)[0]].fmu_wrapper.input_refs
    }
    wires += [Connection(source, end(port)) for port, source in sources.items()]
    everything = [*blocks.values(), *sources.values(), scope]
    simulation = Simulation(everything, wires, dt=task["step"], log=False, **solver)
    began = time.process_time()
    simulation.run(task["step"] * task["steps"], adaptive=False)
    seconds = time.process_time() - began
    times, columns = scope.read()
    return [[float(t), *map(float, row)] for t, *row in zip(times, *columns)], seconds


def pathsim_cosimulation(task: Task) -> Answer:
    """The co-simulation side of the FMUs."""
    from pathsim_fmi.blocks import CoSimulationFMU

    return pathsim(task, lambda fmu, name, start: CoSimulationFMU(fmu, name, start, task["step"]))


def pathsim_exchange(task: Task) -> Answer:
    """The model-exchange side of the FMUs, with a Runge-Kutta method of fourth order."""
    from pathsim.solvers import RK4
    from pathsim_fmi.blocks import ModelExchangeFMU

    return pathsim(task, ModelExchangeFMU, Solver=RK4)


def cofmupy(task: Task, method: str) -> Answer:
    """CoFMuPy's default master."""
    from cofmupy.coordinator import Coordinator

    def end(port: str) -> dict[str, str]:
        part, variable = split(port)
        return {"type": "fmu", "id": part, "variable": variable, "unit": ""}

    # without a start value CoFMuPy's inputs start with 0, whatever the FMU says
    values = task["start"] | task["inputs"]
    configuration = {
        "fmus": [
            {"id": part, "path": fmu, "initialization": start_of(values, part)}
            for part, fmu in task["parts"].items()
        ],
        "connections": [{"source": end(a), "target": end(b)} for a, b in task["wires"]],
        "cosim_method": method,
        "iterative": False,
        "storages": [],
    }
    coordinator = Coordinator()
    coordinator.start(configuration)
    began = time.process_time()
    for _ in range(task["steps"]):
        coordinator.do_step(task["step"])
    seconds = time.process_time() - began
    results = coordinator.get_results()
    columns = [results[split(port)] for port in task["record"]]
    return [[float(t), *map(float, row)] for t, *row in zip(results["time"], *columns)], seconds


def ecos_simulation(
    parts: Mapping[str, str], wires: Sequence[Sequence[str]], step: float, start: Mapping[str, Any]
) -> Any:
    """A simulation of Ecos, with start values by name."""
    # which its wheel needs and does not load
    tbb = next(f.locate() for f in metadata.files("tbb") or () if f.name == "libtbb.so.12")
    ctypes.CDLL(str(tbb), ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    for name, fmu in parts.items():
        structure.add_model(name, fmu)
    for source, target in wires:
        structure.make_real_connection("::".join(split(source)), "::".join(split(target)))
    values = {"::".join(split(name)): x for name, x in start.items()}
    structure.add_parameter_set("start", values)
    return EcosSimulation(step, structure=structure)


def ecos(task: Task) -> Answer:
    """Ecos with its fixed-step algorithm: Jacobi."""
    with ecos_simulation(task["parts"], task["wires"], task["step"], task["start"]) as simulation:
        if not simulation.init(parameter_set="start"):
            sys.exit("Ecos: initialisation failed")
        ports = ["::".join(split(name)) for name in task["record"]]
        rows = [[0.0, *map(simulation.get_real, ports)]]
        began = time.process_time()
        for _ in range(task["steps"]):
            at = simulation.step()
            rows.append([at, *map(simulation.get_real, ports)])
        return rows, time.process_time() - began


def libcosim_execution(
    parts: Mapping[str, str], wires: Sequence[Sequence[str]], step: float
) -> tuple[Any, dict[str, tuple[int, int]]]:
    """An execution of libcosim, and slave and reference of each variable."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    # libcosim counts nanoseconds
    execution, ports = CosimExecution.from_step_size(round(step * 1e9)), {}
    for name, fmu in parts.items():
        slave = execution.add_local_slave(CosimLocalSlave(fmu, name))
        for variable in execution.slave_variables(slave):
            ports[f"{name}.{variable.name.decode()}"] = slave, variable.reference
    for source, target in wires:
        execution.connect_real_variables(*ports[source], *ports[target])
    return execution, ports


def libcosim(task: Task) -> Answer:
    """Run libcosim with its fixed-step algorithm: Jacobi."""
    from libcosimpy.CosimObserver import CosimObserver

    execution, ports = libcosim_execution(task["parts"], task["wires"], task["step"])
    for name, value in task["start"].items():
        kind = {bool: "boolean", int: "integer", float: "real"}[type(value)]
        if not getattr(execution, f"{kind}_initial_value")(*ports[name], value):
            sys.exit(f"libcosim: {name} is not set")
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    ends = [ports[name] for name in task["record"]]
    rows = []
    began = time.process_time()
    for n in range(task["steps"]):
        if not execution.step():
            sys.exit(f"libcosim: step {n} failed")
        at = execution.status().current_time * 1e-9
        rows.append([at, *(observer.last_real_values(s, [r])[0] for s, r in ends)])
    return rows, time.process_time() - began


TOOLS: dict[str, Callable[[Task], Answer]] = {
    "fmpy": fmpy_ssp,
    "pathsim-cs": pathsim_cosimulation,
    "pathsim-me": pathsim_exchange,
    "cofmupy-jacobi": lambda task: cofmupy(task, "jacobi"),
    "cofmupy-gauss-seidel": lambda task: cofmupy(task, "gauss_seidel"),
    "ecos": ecos,
    "libcosim": libcosim,
}
PACKAGES = ("fmpy", "pathsim", "pathsim-fmi", "cofmupy", "ecospy", "libcosimpy")


def versions() -> dict[str, str]:
    """The versions of the masters in this environment."""
    installed = {}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            installed[name] = metadata.version(name)
    return installed


def main() -> None:
    """Read tasks, one JSON value per line, and answer each with a line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tool", choices=TOOLS)
    tool = TOOLS[parser.parse_args().tool]
    for line in sys.stdin:
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                rows, seconds = tool(json.loads(line))
                answer: dict[str, Any] = {"rows": rows, "seconds": seconds}
            except (Exception, SystemExit) as failure:  # noqa: BLE001 what a master raises is its answer
                answer = {"failure": f"{type(failure).__name__}: {failure}"}
        answer["versions"] = versions()
        print("ANSWER", json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
