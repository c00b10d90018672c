"""Write a System as one FMU that contains and steps the others, built by fmu_manipulation_toolbox."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from fmpy.validation import validate_fmu

from ..engine.algorithms import REGISTRY, Turn
from ..errors import SetupError
from ..system import Network, Port, System, connect_for_export, feedthrough, require_fmi2

if TYPE_CHECKING:
    from fmu_manipulation_toolbox.container import FMUContainer

TOOL = "fmu_manipulation_toolbox"


def write_container(
    system: System,
    path: Path,
    *,
    step: float,
    algorithm: str = "jacobi",
    order: Sequence[str] | None = None,
    start: float = 0.0,
    stop: float = 1.0,
) -> None:
    """Write an FMI 2.0 co-simulation FMU with the system's FMUs inside.

    Its variables are all outputs and parameters of the parts and the inputs that no wire drives, by
    their dotted names; Enumerations are Integers. At `start` itself, a part that a later one drives shows
    its outputs for its own input values.

    Parameters
    ----------
    system : System
        What is written.
    path : Path
        The FMU.
    step : float
        The step of its parts [s]; a host must step it by multiples of this.
    algorithm : str
        How it steps them: "jacobi" or "gauss-seidel".
    order : sequence of str, optional
        The stepping order, which is also the order in which parts are started; by default as declared.
    start : float
        The start time of its default experiment [s].
    stop : float
        The stop time of its default experiment [s].

    Raises
    ------
    SetupError
        What `connect` raises, and for what the container cannot do: factors, offsets and unit conversions
        on wires, strings with blanks as start values, and start values that would have to pass through a
        part before the part that drives it has started. Nothing is written then.
    """
    from fmu_manipulation_toolbox.container import FMUContainer, FMUContainerError
    from fmu_manipulation_toolbox.operations import FMUError

    network = connect_for_export(system, "a container")
    require_fmi2(network.descriptions, "a container takes")
    sequence = list(order) if order is not None else list(system.parts)
    if sorted(sequence) != sorted(system.parts):
        raise SetupError(f"order {sequence} must name each of {', '.join(system.parts)} once")
    is_sequential = _is_sequential(algorithm, sequence)
    if not 0.0 < step < float("inf"):
        raise SetupError(f"step = {step!r} s must be above 0")
    path = path.resolve()
    with TemporaryDirectory(dir=path.parent, prefix=f".{path.stem}_") as folder:
        container_path = Path(folder) / "Container.fmu"
        try:
            container = FMUContainer(re.sub(r"\W", "_", f"C_{path.stem}"), Path(folder))
            container.start_time, container.stop_time = start, stop
            _fill(container, network, sequence)
            with _each_message_once(TOOL):
                _require_order(container, network, sequence)
                container.make_fmu(container_path, step_size=step, sequential=is_sequential)
        except (FMUContainerError, FMUError) as error:
            raise SetupError(f"{path.name}: {error}") from error
        problems = validate_fmu(str(container_path))
        if problems:
            raise SetupError(f"{path.name} is not valid: {problems[0]}")
        container_path.replace(path)


def _is_sequential(algorithm: str, parts: Sequence[str]) -> bool:
    """Whether an algorithm steps the parts one after the other, and not side by side.

    Raises
    ------
    SetupError
        For one that is unknown, or that a container cannot do: with other steps than whole ones, or implicit.
    """
    side_by_side = [tuple(Turn(part) for part in parts)]
    in_turn = [(Turn(part),) for part in parts]
    schedules = {
        name: explicit.stages(parts)
        for name, explicit in REGISTRY.items()
        if not explicit.is_implicit
    }
    possible = [name for name, stages in schedules.items() if stages in (side_by_side, in_turn)]
    if algorithm not in possible:
        raise SetupError(f"algorithm {algorithm!r} must be one of {', '.join(possible)}")
    return len(schedules[algorithm]) > 1


@contextmanager
def _each_message_once(name: str) -> Iterator[None]:
    """Let a logger say each of its messages once."""
    logger, messages = logging.getLogger(name), set[str]()

    def is_new(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        if text in messages:
            return False
        messages.add(text)
        return True

    logger.addFilter(is_new)
    try:
        yield
    finally:
        logger.removeFilter(is_new)


def _fill(container: FMUContainer, network: Network, sequence: Sequence[str]) -> None:
    driven = {wire.target.name for wire in network.wires}
    for part in sequence:
        fmu = network.fmus[part].path.resolve()
        inside = container.get_fmu(str(fmu), _file(part))
        for variable in network.descriptions[part].modelVariables:
            port = Port(part, variable)
            if variable.causality == "output":
                embedded = inside.ports[variable.name]
                embedded.initial = embedded.start_value = None
                container.add_output(_file(part), variable.name, port.name)
            elif variable.causality in ("parameter", "input") and port.name not in driven:
                container.add_input(port.name, _file(part), variable.name)
    for wire in network.wires:
        source, target, *scale = wire
        if scale != [1.0, 0.0]:
            raise SetupError(
                f"{source} -> {target}: a container cannot scale, shift or convert units"
            )
        ends = (_file(source.part), source.variable.name, _file(target.part), target.variable.name)
        container.add_link(*ends)
    for link in container.links.values():
        link.name = f"wired.{link.name}"
    for port, value in network.start:
        container.add_start_value(_file(port.part), port.variable.name, port.xml_text(value))
    for ends in container.start_values:  # of inputs, which it would set over what the host has set
        ends.port = copy(ends.port)
        ends.port.causality = "local"


def _file(part: str) -> str:
    return f"{part}.fmu"


def _require_order(container: FMUContainer, network: Network, sequence: Sequence[str]) -> None:
    """A part must be started after what drives an input of it with direct feedthrough."""
    ranks = {_file(part): rank for rank, part in enumerate(sequence)}
    started = [sequence[rank] for rank in container.initialization_order(ranks)]
    for first in network.wires:
        part, entry = first.target.part, first.target.variable.name
        if started.index(first.source.part) < started.index(part):
            continue
        acting = feedthrough(network.descriptions[part])
        for then in (wire for wire in network.wires if wire.source.part == part):
            if entry in acting.get(then.source.variable.name, ()):
                raise SetupError(
                    f"{then.source} has direct feedthrough from {first.target}, but a container "
                    f"starts {part} before {first.source.part}: choose another order"
                )
