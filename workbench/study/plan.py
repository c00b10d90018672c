"""A study file becomes the table of its runs; every key and value is checked here."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from cosim import SetupError

from .. import question
from ..command import parts
from ..options import KINDS, Option, declared, unknown
from ..question import ALONE, Project
from .sampling import METHODS, Distribution, Sampling, between, log_between, normal, truncated

Value = float | int | str | bool
KEYS = ("scenario", "timeout", "figures", "fixed", "grid", "sampling", "tolerances")
TOLERANCES = (
    "{ nominal, uniform }, { nominal, normal }, { nominal, normal, within } or { from, to }"
)
RANGE = "a list of values or { from, to, number }"


@dataclass(frozen=True)
class Study:
    """What a study file says; `content` is the file as it was parsed, `timeout` is in s.

    `where` is the module of the question or its file, `module` is its page.
    """

    path: Path
    content: Mapping[str, Any]
    project: Project
    where: str
    module: ModuleType
    fixed: Mapping[str, Value]
    grid: Mapping[str, Sequence[Value]]
    sampling: Sampling | None
    tolerances: Mapping[str, Distribution]
    timeout: float | None
    figures: Sequence[str]

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.path.stem

    @property
    def scenario(self) -> str:
        """The question, or the file that holds it."""
        return str(self.content["scenario"])

    @property
    def varied(self) -> list[str]:
        """The inputs that vary: those of the grid, then the sampled ones."""
        return [*self.grid, *self.tolerances]

    def samples(self) -> list[tuple[float, ...]]:
        """The sampled values, the same at each point of the grid; one empty row without any."""
        if self.sampling is None:
            return [()]
        cube = self.sampling.cube(len(self.tolerances))
        columns = [d.quantiles(shares) for d, shares in zip(self.tolerances.values(), cube.T)]
        return [tuple(row) for row in np.column_stack(columns).tolist()]

    def runs(self) -> list[tuple[Value, ...]]:
        """The values of the varied inputs, run by run: the samples at one grid point, at the next."""
        samples = self.samples()
        points = itertools.product(*self.grid.values())
        return [(*point, *sample) for point in points for sample in samples]

    def cases(self) -> list[tuple[dict[str, Value], dict[str, Value]]]:
        """What each run is given: options of the question, and start values."""
        return [self._case({**self.fixed, **dict(zip(self.varied, run))}) for run in self.runs()]

    def _case(self, given: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
        options = {name: value for name, value in given.items() if "." not in name}
        return options, {name: value for name, value in given.items() if "." in name}


def load(path: Path, project: Project = ALONE) -> Study:
    """Read and check a study file of a question of the project or in a file beside it.

    Raises SetupError with file, key, value and what was expected.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SetupError(f"{path} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SetupError(f"{path} is no TOML file: {error}") from None
    try:
        return _study(path, content, project)
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from error.__cause__


def _study(path: Path, content: dict[str, Any], project: Project) -> Study:
    _known("", content, KEYS)
    if not isinstance(content.get("scenario"), str):
        raise SetupError(f"scenario = {_shown(content.get('scenario'))} must be the name of one")
    try:
        where = question.find(project.home, content["scenario"], path.parent)
    except SetupError as error:
        raise SetupError(f"scenario = {error}") from None
    module = question.load(where)
    tables = {key: _table(content, key) for key in ("fixed", "grid", "sampling", "tolerances")}
    inputs = _Inputs(module)
    fixed = {name: inputs.value("fixed", name, x) for name, x in tables["fixed"].items()}
    grid = {name: _values(inputs, name, x) for name, x in tables["grid"].items()}
    tolerances = {name: _tolerance(inputs, name, x) for name, x in tables["tolerances"].items()}
    _distinct(fixed, grid, tolerances)
    if not grid and not tolerances:
        raise SetupError("nothing varies: it needs a table [grid] or [tolerances]")
    sampling = _sampling(tables["sampling"], tolerances) if "sampling" in content else None
    if tolerances and sampling is None:
        raise SetupError("[tolerances] need a table [sampling] with method, number and seed")
    timeout = content.get("timeout")
    if timeout is not None and not (_is_number(timeout) and timeout > 0.0):
        raise SetupError(f"timeout = {_shown(timeout)} must be a number above 0 [s]")
    figures = content.get("figures", [])
    if not isinstance(figures, list) or not all(isinstance(name, str) for name in figures):
        raise SetupError(f"figures = {_shown(figures)} must be a list of names")
    return Study(
        path, content, project, where, module, fixed, grid, sampling, tolerances, timeout, figures
    )


class _Inputs:
    """Checks names and values of inputs: options of the question, and start values with a dot."""

    def __init__(self, module: ModuleType) -> None:
        self._name = question.name(module)
        self._options = declared(module.Options)
        self._parts = parts(module)
        self._own = getattr(module, "OWN", ())

    def option(self, table: str, name: str) -> Option | None:
        """The option of this name, None for a start value."""
        if name in self._options:
            return self._options[name]
        key = _key(table, name)
        if "." not in name:
            raise unknown(name, self._options, f"{key}: {self._name}")
        part = name.partition(".")[0]
        if part not in self._parts:
            there = (
                f"part {part!r}, only {', '.join(self._parts)}" if self._parts else "start values"
            )
            raise SetupError(f"{key}: {self._name} has no {there}")
        if name in self._own:
            raise SetupError(f"{key}: {self._name} sets it on its own")
        return None

    def value(self, table: str, name: str, value: object) -> Value:
        """One value of an input, of its type and in its unit."""
        if isinstance(value, dict) and name not in self._options:
            first = next(iter(value), "…")
            raise SetupError(f'{table}.{name}: write a start value in quotes, "{name}.{first}" = …')
        option, key = self.option(table, name), _key(table, name)
        if option is not None:
            read: Value = option.read(value, key)
            return read
        if isinstance(value, float) and not math.isfinite(value):
            raise SetupError(f"{key} = {value} must be finite")
        if not isinstance(value, float | int | str | bool):
            raise SetupError(f"{key} = {_shown(value)} must be a start value")
        return value


def _values(inputs: _Inputs, name: str, spec: object) -> list[Value]:
    """The values of one axis of the grid."""
    key = _key("grid", name)
    if isinstance(spec, dict) and "from" in spec:
        _known(key, spec, ("from", "to", "number", "spacing"))
        option = inputs.option("grid", name)
        low, high = _ends(key, spec, option)
        number = spec.get("number")
        if type(number) is not int or number < 2:
            raise SetupError(f"{key}.number = {_shown(number)} must be a whole number above 1")
        even = np.geomspace if _log(key, spec, low) else np.linspace
        given: list[Any] = even(low, high, number).tolist()
        if option is not None and option.kind is int:
            given = [int(x) if x.is_integer() else x for x in given]
    elif isinstance(spec, list):
        given = spec
    else:
        inputs.value("grid", name, spec)
        raise SetupError(f"{key} = {_shown(spec)} must be {RANGE}")
    values = [inputs.value("grid", name, x) for x in given]
    if not values:
        raise SetupError(f"{key} = [] must name at least one value")
    twice = [x for x in values if values.count(x) > 1]
    if twice:
        raise SetupError(f"{key} names {_shown(twice[0])} twice")
    return values


def _tolerance(inputs: _Inputs, name: str, spec: object) -> Distribution:
    key = _key("tolerances", name)
    if not isinstance(spec, dict) or not {"nominal", "from"} & set(spec):
        inputs.value("tolerances", name, spec)
        raise SetupError(f"{key} = {_shown(spec)} must be {TOLERANCES}")
    option = inputs.option("tolerances", name)
    if option is not None and (option.kind is not float or option.many):
        expected = "a list" if option.many else KINDS[option.kind]
        raise SetupError(f"{key}: the option takes {expected}; vary it in [grid]")
    if "from" in spec:
        _known(key, spec, ("from", "to", "spacing"))
        low, high = _ends(key, spec, option)
        return log_between(low, high) if _log(key, spec, low) else between(low, high)
    _known(key, spec, ("nominal", "uniform", "normal", "within"))
    nominal = _number(f"{key}.nominal", spec["nominal"], option)
    if ("uniform" in spec) == ("normal" in spec) or ("uniform" in spec and "within" in spec):
        raise SetupError(f"{key} = {_shown(spec)} must be {TOLERANCES}")
    if "uniform" in spec:
        half = _width(f"{key}.uniform", spec["uniform"], nominal, option)
        return between(nominal - half, nominal + half)
    deviation = _width(f"{key}.normal", spec["normal"], nominal, option)
    if "within" in spec:
        within = _width(f"{key}.within", spec["within"], nominal, option)
        return truncated(nominal, deviation, within)
    return normal(nominal, deviation)


def _sampling(table: dict[str, Any], tolerances: Mapping[str, Distribution]) -> Sampling:
    _known("sampling", table, ("method", "number", "seed"))
    if not tolerances:
        raise SetupError("[sampling] needs a table [tolerances] that says what is sampled")
    method = table.get("method")
    if not isinstance(method, str) or method not in METHODS:
        known = ", ".join(METHODS)
        raise SetupError(f"sampling.method = {_shown(method)} must be one of {known}")
    for key, least in (("number", 2), ("seed", 0)):
        if type(table.get(key)) is not int or table[key] < least:
            raise SetupError(
                f"sampling.{key} = {_shown(table.get(key))} must be a whole number, at least {least}"
            )
    sampling = Sampling(method, table["number"], table["seed"])
    expected = sampling.problem()
    if expected:
        raise SetupError(f"sampling.number = {sampling.number} must be {expected}")
    return sampling


def _distinct(*tables: Mapping[str, object]) -> None:
    seen: set[str] = set()
    for name in itertools.chain(*tables):
        if name in seen:
            raise SetupError(f"{name!r} stands in two of [fixed], [grid] and [tolerances]")
        seen.add(name)


def _known(key: str, table: Mapping[str, object], known: Sequence[str]) -> None:
    for name in table:
        if name not in known:
            where = f"{key}: " if key else ""
            raise SetupError(f"{where}unknown key {name!r}, expected {', '.join(known)}")


def _table(content: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise SetupError(f"{key} = {_shown(table)} must be a table [{key}]")
    return table


def _ends(key: str, spec: Mapping[str, object], option: Option | None) -> tuple[float, float]:
    low, high = (_number(f"{key}.{end}", spec.get(end), option) for end in ("from", "to"))
    if not low < high:
        raise SetupError(f"{key}.to = {high:g} must be above from = {low:g}")
    return low, high


def _log(key: str, spec: Mapping[str, object], low: float) -> bool:
    spacing = spec.get("spacing", "linear")
    if spacing not in ("linear", "log"):
        raise SetupError(f"{key}.spacing = {_shown(spacing)} must be 'linear' or 'log'")
    if spacing == "log" and not low > 0.0:
        raise SetupError(f"{key}.from = {_shown(spec['from'])} must be above 0 with spacing 'log'")
    return spacing == "log"


def _width(key: str, value: object, nominal: float, option: Option | None) -> float:
    """A width above 0: a number in the unit of the nominal value, or a share of it, "5 %"."""
    expected = 'a number above 0, or a share of the nominal value such as "5 %"'
    width: Any = value
    if isinstance(value, str) and value.strip().endswith("%"):
        try:
            width = float(value.strip()[:-1]) / 100.0 * abs(nominal)
        except ValueError:
            raise SetupError(f"{key} = {value!r} must be {expected}") from None
    elif isinstance(value, str) and option is not None and value.strip()[-1:].isalpha():
        width = option.number(value, key)
    if not _is_number(width) or not width > 0.0:
        of_zero = " (the nominal value is 0)" if width == 0.0 and nominal == 0.0 else ""
        raise SetupError(f"{key} = {_shown(value)} must be {expected}{of_zero}")
    return float(width)


def _number(key: str, value: Any, option: Option | None = None) -> float:
    if isinstance(value, str) and option is not None and option.unit:
        return option.number(value, key)
    if not _is_number(value):
        raise SetupError(f"{key} = {_shown(value)} must be a finite number")
    return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _key(table: str, name: str) -> str:
    return f'{table}."{name}"' if "." in name else f"{table}.{name}"


def _shown(value: object) -> str:
    return "nothing" if value is None else repr(value)
