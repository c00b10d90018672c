"""Start values from a file of their own: a parameter set (SSV), or a CSV of names and values."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

from ..errors import SetupError
from ..system import READ, Network, Value
from .ssp.files import Room, parse
from .ssp.parameters import Parameter, parameters_of
from .ssp.plan import Node, Plan, dotted
from .ssp.units import Unit, definitions


def read_values(path: Path, network: Network) -> dict[str, Value]:
    """The start values that an .ssv, or a .csv with the columns name, value and unit, gives a system.

    Names are dotted; those of a single part may be bare. A unit may be one of the file, of the
    part's FMU, or a display unit there; without one, the value is in the variable's own. Raises
    SetupError with file and line for what is invalid, fits no variable, or is given twice.
    """
    plan = Plan(Room(0))
    for name, description in network.descriptions.items():
        plan.add_element("", name)
        plan.add_fmu(name, Path(network.system.parts[name]), description)
    whole = "" if len(plan.fmus) > 1 else next(iter(plan.fmus))
    given: set[Node] = set()
    if path.suffix not in READERS:
        raise SetupError(f"{path} must be an .ssv or a .csv")
    for parameter in READERS[path.suffix](path, plan, whole):
        nodes = _meant(plan, whole, parameter.name)
        if not nodes:
            raise SetupError(f"{parameter.where} fits no variable")
        if given.intersection(nodes):
            raise SetupError(f"{parameter.where} is given twice")
        given.update(nodes)
        plan.bind(nodes[0][0], parameter._replace(name=nodes[0][1]))
    return {dotted(node): value for node, value in plan.start.items()}


def _meant(plan: Plan, whole: str, name: str) -> list[Node]:
    """The variable of a name, in a single part without the part's name too."""
    return [*dict.fromkeys((*plan.named(whole, name), *plan.named("", name)))]


def _set(path: Path, plan: Plan, whole: str) -> Iterator[Parameter]:
    root = parse(path, "ssv:ParameterSet")
    yield from parameters_of(root, "", path.name, definitions(root, path.name)).values()


def _rows(path: Path, plan: Plan, whole: str) -> Iterator[Parameter]:
    """Rows of a CSV, in the type of what they name."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True)
            rows = list(table)
    except (OSError, ValueError, csv.Error) as error:
        raise SetupError(f"{path} cannot be read as a table: {error}") from error
    if lacking := {"name", "value"} - set(table.fieldnames or ()):
        raise SetupError(f"{path} has no column {' and no '.join(sorted(lacking))}")
    for line, row in enumerate(rows, 2):
        name, text = row["name"] or "", row["value"] or ""
        where = f"{path.name}, line {line}: parameter {name}"
        kind = next((str(plan.variables[n].type) for n in _meant(plan, whole, name)), "String")
        if kind == "Enumeration" and text.lstrip("-").isdecimal():
            kind = "Integer"
        try:
            value = READ[kind](text)
        except (KeyError, ValueError):
            raise SetupError(f"{where} = {text!r} must be of type {kind}") from None
        unit = (row.get("unit") or "").strip()
        yield Parameter(where, name, kind, value, Unit(unit) if unit else None)


READERS = {".ssv": _set, ".csv": _rows}
