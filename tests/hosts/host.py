"""A process of its own for what may crash, and an FMI host as careless as wanted."""

import functools
import importlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from ctypes import byref
from pathlib import Path
from typing import Any, Self

from fmpy import calloc, extract, fmi2, free, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy

from fmukit.declare.interface import Interface
from fmukit.fmu.reference import by_equations

ROOT = Path(__file__).resolve().parents[2]
MESSAGES: list[str] = []
FOLDERS: list[Any] = []


def in_subprocess(function: Callable[..., Any]) -> Callable[..., Any]:
    """Run a function in a process of its own and return what it returns; a crash is a failure."""

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        code = "from tests.hosts.host import answer; answer()"
        command = [sys.executable, "-X", "faulthandler", "-c", code]
        command += [function.__module__, function.__name__, json.dumps(args, default=str)]
        done = subprocess.run(
            command, check=False, cwd=ROOT, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return json.loads(done.stdout.splitlines()[-1])

    return call


def answer() -> None:
    """Call what the command line asks for and print what it returns."""
    module, name, args = sys.argv[1:]
    function = getattr(importlib.import_module(module), name)
    print(json.dumps(function.__wrapped__(*json.loads(args))))


FUNCTIONS = (
    fmi2.fmi2CallbackLoggerTYPE(
        lambda environment, name, status, category, text: MESSAGES.append(text.decode())
    ),
    fmi2.fmi2CallbackAllocateMemoryTYPE(calloc),
    fmi2.fmi2CallbackFreeMemoryTYPE(free),
)


def callbacks() -> Any:
    """A logger in C that uses the message as a printf format, as hosts in C do.

    fmpy's proxy has room for one logger in a process: it is taken anew for every unit.
    """
    functions = fmi2.fmi2CallbackFunctions(*FUNCTIONS)
    addLoggerProxy(byref(functions))
    return functions


@functools.cache
def unpacked(fmu: str) -> tuple[Any, str]:
    """The model description and the folder of an FMU."""
    FOLDERS.append(tempfile.TemporaryDirectory(prefix="unit_"))
    return read_model_description(fmu), extract(fmu, FOLDERS[-1].name)


class Unit:
    """One instance of an FMU, its variables by name; `fmi` is fmpy's slave, or its model."""

    def __init__(self, fmu: str | Path, name: str = "unit", kind: Any = fmi2.FMU2Slave) -> None:
        self.description, folder = unpacked(str(fmu))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.fmi = kind(
            guid=self.description.guid,
            unzipDirectory=folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmi.instantiate(callbacks=callbacks(), loggingOn=True)

    def _access(self, verb: str, name: str) -> tuple[Callable[..., Any], list[int]]:
        kind = self.variables[name].type.replace("Enumeration", "Integer")
        return getattr(self.fmi, verb + kind), [self.variables[name].valueReference]

    def set(self, **values: Any) -> Self:
        for name, value in values.items():
            setter, reference = self._access("set", name)
            setter(reference, [value])
        return self

    def get(self, name: str) -> Any:
        getter, reference = self._access("get", name)
        return getter(reference)[0]

    def outputs(self) -> list[Any]:
        return [self.get(name) for name, v in self.variables.items() if v.causality == "output"]

    def start(self, t: float = 0.0, **values: Any) -> Self:
        self.fmi.setupExperiment(startTime=t)
        self.set(**values)
        self.fmi.enterInitializationMode()
        self.fmi.exitInitializationMode()
        return self

    def step(self, t: float, h: float) -> Self:
        self.fmi.doStep(t, h)
        return self

    def end(self) -> Self:
        self.fmi.terminate()
        return self

    def refusal(self, call: Callable[["Unit"], Any]) -> str:
        """What is logged when a call fails, fatally for pythonfmu; empty if it does not."""
        MESSAGES.clear()
        try:
            call(self)
        except FMICallException as error:
            is_python = self.description.coSimulation.needsExecutionTool
            assert error.status == (fmi2.fmi2Fatal if is_python else fmi2.fmi2Error)
            return "\n".join(MESSAGES)
        return ""


class Equations(Unit):
    """The functions of a model as they are written, behind the calls of an FMU."""

    def __init__(self, model: Any) -> None:
        self.fmi = by_equations(model)(instance_name="unit")
        self.variables = Interface(model).by_name

    def _access(self, verb: str, name: str) -> tuple[Callable[..., Any], list[int]]:
        variable = self.variables[name]
        return getattr(self.fmi, f"{verb.lower()}_{variable.access_type.lower()}"), [
            variable.reference
        ]

    def start(self, t: float = 0.0, **values: Any) -> Self:
        self.fmi.setup_experiment(t, None, None)
        self.set(**values)
        self.fmi.enter_initialization_mode()
        self.fmi.exit_initialization_mode()
        return self

    def step(self, t: float, h: float) -> Self:
        self.fmi.do_step(t, h)
        return self
