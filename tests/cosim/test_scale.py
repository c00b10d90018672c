"""The cost of describing, checking, connecting and starting a system grows with its size, no faster.

Counted are the interpreter's own operations, which no other load of the machine changes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest

from cosim import System, describe, run, write_ssp
from cosim.engine.settings import RunSettings
from cosim.engine.setup import setup_problems
from cosim.formats.ssp.files import ROOT_SSD
from cosim.formats.ssp.rules import load_valid
from cosim.system import connect
from cosim.system.graph import stepping_order
from tests.conftest import described, rewritten
from tests.cosim.foreign import pack

LARGER = 2.1


def operations(work: Callable[[], Any]) -> int:
    """How many operations the interpreter takes for this work."""
    count = 0

    def trace(frame: Any, event: str, _: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes = True
        count += event == "opcode"
        return trace

    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(None)
    return count


def ring(folder: Path, count: int) -> System:
    """Pairs of motor and conveyor that are wired to and fro, in one subsystem."""
    parts: dict[str, Path] = {}
    wires: list[str] = []
    for k in range(count):
        motor, conveyor = f"line.m{k}", f"line.c{k}"
        parts |= {motor: folder / "DriveMotor.fmu", conveyor: folder / "CrankConveyor.fmu"}
        wires += [f"{motor}.tau -> {conveyor}.tau", f"{conveyor}.w -> {motor}.w"]
    return System(parts, wires, {f"line.c{k}.w": 40.0 for k in range(count)})


def checked(system: System) -> None:
    network = connect(system)
    list(describe.info(network))
    settings = RunSettings(1.0, 1e-3, algorithm="jacobi")
    list(setup_problems(network, settings)), list(describe.notes(network, settings))


def started(system: System) -> None:
    run(system, stop=1e-3, step=1e-3)


@pytest.mark.parametrize("work", [checked, started])
def test_twice_the_parts_cost_twice(work: Callable[[System], None], fmus: Path) -> None:
    small, large = (ring(fmus / "native", count) for count in (20, 40))
    work(large)
    assert operations(lambda: work(large)) < LARGER * operations(lambda: work(small))


def test_rules_of_twice_the_wires_cost_twice(fmus: Path, tmp_path: Path) -> None:
    def reading(count: int) -> Callable[[], object]:
        package = tmp_path / f"{count}.ssp"
        write_ssp(ring(fmus / "native", count), package)
        with ZipFile(package) as archive:
            structure = Path(archive.extract(ROOT_SSD, tmp_path / str(count)))
        return lambda: load_valid(structure, "ssd:SystemStructureDescription")

    small, large = reading(50), reading(100)
    assert operations(large) < LARGER * operations(small)


def test_twice_the_variables_cost_twice(tmp_path: Path) -> None:
    """With outputs, inputs and what has a start value among them."""

    def wide(count: int) -> System:
        lines = "".join(
            f'<ScalarVariable name="v{k}" valueReference="{1000 + k}" causality="parameter" '
            f'variability="fixed"><Real start="0" unit="m"/></ScalarVariable>'
            for k in range(count)
        )
        edit = described(("</ModelVariables>", f"{lines}</ModelVariables>"))
        fmu = rewritten(pack(tmp_path / "a.fmu"), tmp_path / f"a{count}.fmu", edit)
        start: dict[str, Any] = {f"a.v{k}": 1.0 for k in range(count)}
        start |= {f"a.{kind}_in": 1 for kind in ("integer", "boolean", "enumeration")}
        return System({"a": fmu}, start=start | {"a.u": 0.0, "a.string_in": ""})

    small, large = wide(1000), wide(2000)
    assert operations(lambda: checked(large)) < LARGER * operations(lambda: checked(small))


def test_parts_step_after_what_they_receive(fmus: Path) -> None:
    """Parts in a ring step as declared, and parts in a chain that is declared from its end, not."""
    system = ring(fmus / "native", 3)
    assert stepping_order(connect(system), None) == list(system.parts)
    start = {f"line.m{k}.w": 40.0 for k in range(3)}
    chains = System(dict(reversed(system.parts.items())), system.wires[::2], start)
    order = [f"line.{kind}{k}" for k in (2, 1, 0) for kind in "mc"]
    assert stepping_order(connect(chains), None) == order
