"""Start values from a separate file: a parameter set (SSV), or a CSV of names and values."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path

from ..errors import SetupError
from ..series import Series
from ..system import Network, Port, Value, conversion_to, value_of_text
from ..system.start_values import checked_start
from ..units import is_common
from .ssp.files import Budget
from .ssp.parameters import parameters_of
from .ssp.plan import FlatSystem
from .ssp.rules import load_valid
from .ssp.units import definitions

COLUMNS = ("name", "value", "unit")


def read_values(path: Path, network: Network) -> dict[str, Value]:
    """The start values that an .ssv, or a .csv with the columns name, value and unit, gives a system.

    Names are dotted; those of a single part may be bare. A unit may be one defined in the file or in the
    part's FMU, or one of its display units. Without one, the value is in the variable's own unit. Raises
    SetupError with file and line for what is invalid, fits no variable, or is given twice.
    """
    if path.suffix.lower() == ".csv":
        return dict(_rows(path, network))
    if path.suffix != ".ssv":
        raise SetupError(f"{path} must be an .ssv or a .csv")
    plan = FlatSystem(Budget(0))
    for name, description in network.descriptions.items():
        plan.add_element("", name)
        plan.add_fmu(name, network.fmus[name].path, description)
    root = load_valid(path, "ssv:ParameterSet")
    given: set[str] = set()
    for parameter in parameters_of(root, "", path.name, definitions(root)).values():
        port = _given_port(network, parameter.name, parameter.where, given)
        plan.bind(port.part, parameter._replace(name=port.variable.name))
    return plan.starts()


def _given_port(network: Network, name: str, where: str, given: set[str]) -> Port:
    """The port of a name, which joins those that are `given`; raises SetupError with where the name stands."""
    try:
        port = network.port(name)
    except SetupError as error:
        raise SetupError(f"{where} fits no variable: {error}") from None
    if port.name in given:
        raise SetupError(f"{where} is given twice")
    given.add(port.name)
    return port


def _rows(path: Path, network: Network) -> Iterator[tuple[str, Value]]:
    """Name and value of each row of a CSV, read as the command line reads them."""
    table = Series.read_cells(path, may_lack=True)
    if lacking := [column for column in COLUMNS[:2] if column not in table.names]:
        raise SetupError(f"{path} has no column {lacking[0]!r}, only {', '.join(table.names)}")
    for column in {*table.names} - {*COLUMNS}:
        texts = {*table[column]} - {""}
        are_units = bool(texts) and all(map(is_common, texts))
        if (near := get_close_matches(column.lower(), COLUMNS, n=1)) or are_units:
            meant = near[0] if near else "unit"
            raise SetupError(f"{path} has a column {column!r}: {meant!r} must be spelt so")
    given: set[str] = set()
    names, values = (table[column] for column in COLUMNS[:2])
    units = table["unit"] if "unit" in table.names else [table.column("value").unit] * len(names)
    for row, (name, text, unit) in enumerate(zip(names, values, units), 2):
        where = f"{path.name}, row {row}: parameter {name}"
        port = _given_port(network, name, where, given)
        try:
            value = value_of_text(network, port, text)
            if unit and isinstance(value, int | float):
                factor, offset = conversion_to(network, port, unit, "be given")
                value = factor * value + offset if (factor, offset) != (1.0, 0.0) else value
            yield port.name, checked_start(network, port, value)[1]
        except SetupError as error:
            raise SetupError(f"{where}: {error}") from None
