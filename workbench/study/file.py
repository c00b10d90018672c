"""A study file becomes the table of its runs; every key and value is checked here."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.stats.distributions import rv_frozen

from cosim import SetupError
from cosim.units import read_quantity

from ..find import Find
from ..formula import Formula
from ..options import TYPE_NAMES, Option, declared, quoted
from ..plan import LEAST, Plan, Sampling, Value, input_of
from ..project import NO_PROJECT, Project
from ..question import Question

Spec = Mapping[str, Any]
KEYS = (
    "scenario", "timeout", "figures", "judgements", "fixed", "grid", "linked", "sampling", "tolerances", "limits", "find",
)  # fmt: skip
TOLERANCES = (
    "{ nominal, uniform }, { nominal, normal }, { nominal, normal, within } or { from, to }"
)
RANGE = "a list of values or { from, to, number }"
WIDTH = 'a number above 0, or a share of the nominal value such as "5 %"'
SALIB = 'SALib: pip install "drive-fmus[studies]"'
METHODS = ("lhs", "sobol", "saltelli")
#: Runs of a study at most; chosen: about a day of runs of 0.1 s.
MAX_RUNS = 1 << 20
TIMEOUT = Option("timeout", float, unit="s", bounds={"above": 0.0, "at most": 1e6})
JUDGEMENTS = Option("judgements", bool)
NUMBER = Option("number", int, default=0, bounds={"at least": 2, "at most": MAX_RUNS})
WHICH = Option("which", str, default="first", choices=("first", "all"))
FIND = '{ over, from, to, figure, level }, and perhaps which = "all"'
SPACING = Option("spacing", str, choices=("linear", "log"))
SAMPLING = {
    "method": Option("method", str, default="", choices=METHODS),
    "number": NUMBER,
    "seed": Option("seed", int, default=0, bounds={"at least": 0}),
}


@dataclass(frozen=True, kw_only=True)
class Study(Plan):
    """The plan of a study file, whose `content` is the file as it was parsed; `timeout` is in s.

    `figures` are to be drawn and analysed, by default all; with `judgements` these are figures as well.
    """

    path: Path
    content: Spec
    project: Project
    timeout: float | None
    figures: Sequence[str]
    judgements: bool

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.path.stem

    @property
    def scenario(self) -> str:
        """The question, or the file that holds it."""
        return str(self.content["scenario"])


def load(path: Path, project: Project = NO_PROJECT) -> Study:
    """Read and check a study file, for a question of the project or in a file next to it.

    Raises SetupError with file, key, value and what was expected.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise SetupError(f"{path} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        line = re.search(r"line \d+", str(error))
        raise SetupError(
            f"{path} is not a TOML file{f': {line[0]}' if line else ''}: write KEY = VALUE, each key once in its "
            "table, and texts in quotes"
        ) from None
    try:
        return _study(path, content, project)
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from error.__cause__


def _study(path: Path, content: Spec, project: Project) -> Study:
    check_keys("", content, KEYS)
    scenario, figures = content.get("scenario"), content.get("figures", [])
    if not isinstance(scenario, str):
        raise SetupError(f"scenario = {quoted(scenario)} must be the name of a question")
    try:
        project.locate(scenario, path.parent)
    except SetupError as error:
        raise SetupError(f"scenario = {error}") from None
    tables = {key: content.get(key, {}) for key in KEYS[4:]}
    for key, table in tables.items():
        if not isinstance(table, dict):
            raise SetupError(f"{key} = {quoted(table)} must be a table [{key}]")
    if not isinstance(figures, list) or not all(isinstance(name, str) for name in figures):
        raise SetupError(f"figures = {quoted(figures)} must be a list of names")
    _require_distinct("figures", figures)
    question = project.load(scenario, path.parent)
    read, units = _inputs(question, tables)
    if not read["grid"] and not read["tolerances"] and not tables["find"]:
        raise SetupError("nothing varies: a study needs a table [grid], [tolerances] or [find]")
    if bool(read["tolerances"]) != ("sampling" in content):
        raise SetupError("[tolerances] and [sampling] must be given together")
    sampling = _sampling(tables["sampling"]) if "sampling" in content else None
    samples = sampling.number * sampling.group(len(read["tolerances"])) if sampling else 1
    count = prod(map(len, read["grid"].values())) * samples
    if count > MAX_RUNS:
        raise SetupError(f"{count} runs are more than {MAX_RUNS}")
    some = {**read["fixed"], **{name: values[0] for name, values in read["grid"].items()}}
    numbers = {name for name, x in some.items() if isinstance(x, int | float)}
    for name, formula in read["linked"].items():
        for unknown in sorted(formula.names - numbers - read["tolerances"].keys()):
            raise SetupError(
                f"{_key('linked', name)} names {unknown}, which is no number of [fixed], [grid] or [tolerances]"
            )
    limits = {name: _limit(name, raw) for name, raw in tables["limits"].items()}
    find = {name: read_find(question, name, spec) for name, spec in tables["find"].items()}
    timeout = TIMEOUT.read(content.get("timeout"))
    return Study(
        path=path,
        content=content,
        project=project,
        question=question,
        sampling=sampling,
        timeout=timeout,
        figures=figures,
        **read,
        limits=limits,
        find=find,
        judgements=JUDGEMENTS.read(content.get("judgements", False)),
        units=units,
    )


def _inputs(
    question: type[Question], tables: Mapping[str, Spec]
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """What is fixed, of a grid and sampled, by table and name, and the units of start values that state one."""
    readers: dict[str, Callable[[Option, Any, str], Any]] = {
        "fixed": lambda option, raw, key: option.read(raw, key),
        "grid": _values,
        "linked": _linked,
        "tolerances": _tolerance,
    }
    read: dict[str, dict[str, Any]] = {table: {} for table in readers}
    units: dict[str, str] = {}
    for table, reader in readers.items():
        for name, spec in tables[table].items():
            option = _input(question, table, name, spec)
            if "." in name and (unit := _stated_unit(spec)):
                option, units[name] = replace(option, unit=unit), unit
            read[table][name] = reader(option, spec, _key(table, name))
    return read, units


def _stated_unit(spec: object) -> str:
    """The unit in which a range or a nominal value is given; "" where it states none."""
    given = [spec.get(key) for key in ("from", "to", "nominal")] if isinstance(spec, dict) else []
    return next((stated.unit for stated in map(read_quantity, given) if stated and stated.unit), "")


def read_find(question: type[Question], name: str, spec: Any) -> Find:
    """What is sought, from {over, from, to, figure, level, which}."""
    key = f"find.{name}"
    if not name.isidentifier() or not isinstance(spec, dict):
        raise SetupError(f"{key} = {quoted(spec)} must be {FIND}")
    check_keys(f"{key}: ", spec, ("over", "from", "to", "figure", "level", "which"))
    over = Option("over", str, default="").read(spec.get("over"), f"{key}.over")
    option = input_of(question, over, f"{key}.over")
    low, high, _ = _ends(option, spec, key)
    if not low > 0.0:
        raise SetupError(f"{key}.from = {low:g} must be above 0")
    figure = Option("figure", str).read(spec.get("figure", ""), f"{key}.figure")
    which = WHICH.read(spec.get("which", "first"), f"{key}.which")
    level = spec.get("level")
    if not isinstance(level, str):
        level = Option("level", float).read(level, f"{key}.level")
    return Find(over, low, high, figure, level, which, option.unit)


def _limit(name: str, raw: Any) -> float | str:
    """The limit of a figure; its unit is known when a run has the figure."""
    written = read_quantity(raw)
    if isinstance(raw, bool) or not (isinstance(raw, int | float) or (written and written.unit)):
        raise SetupError(
            f'limits.{name} = {quoted(raw)} must be a number, or a text with a unit such as "62.5N.m"'
        )
    value: float | str = Option(name, float).read(raw, f"limits.{name}") if written is None else raw
    return value


def _input(question: type[Question], table: str, name: str, spec: Any) -> Option:
    """Return what checks the values of an input."""
    key = _key(table, name)
    is_value = not isinstance(spec, dict) or {"from", "nominal"} & set(spec)
    if name not in declared(question) and "." not in name and not is_value:
        form = f'"{name}.{next(iter(spec), "…")}" = …'
        raise SetupError(f"{key}: write a start value in quotes, {form}")
    return input_of(question, name, key)


def _values(option: Option, spec: Any, key: str) -> list[Value]:
    """The values of one axis of the grid."""
    if isinstance(spec, dict):
        check_keys(f"{key}: ", spec, ("from", "to", "number", "spacing"))
        low, high, log = _ends(option, spec, key)
        number = NUMBER.read(spec.get("number"), f"{key}.number")
        spec = (np.geomspace if log else np.linspace)(low, high, number).tolist()
        if option.kind is int:
            spec = [int(x) if x.is_integer() else x for x in spec]
    if not isinstance(spec, list):
        raise SetupError(f"{key} = {quoted(spec)} must be {RANGE}")
    values = [option.read(x, key) for x in spec]
    if not values:
        raise SetupError(f"{key} = [] must contain at least one value")
    _require_distinct(key, values)
    return values


def _linked(_option: Option, spec: Any, key: str) -> Formula:
    """The formula of an input."""
    try:
        return Formula.read(spec if isinstance(spec, str) else "")
    except SetupError as error:
        raise SetupError(
            f"{key} = {quoted(spec)} must be a formula of other inputs: {error}"
        ) from error


def _require_distinct(key: str, values: Sequence[Value]) -> None:
    """Refuse a value that a list names twice."""
    for x, times in Counter(values).items():
        if times > 1:
            raise SetupError(f"{key} contains {quoted(x)} twice")


def _tolerance(option: Option, spec: Any, key: str) -> rv_frozen:
    """The distribution of a sampled input, all of which its option takes if it has ends."""
    distribution = _distribution(option, spec, key)
    for end in ends(distribution):
        option.read(end, f"an end of {key}")
    return distribution


def ends(distribution: rv_frozen) -> list[float]:
    """The least and the largest sample of a distribution; none if it has no ends."""
    if not np.isfinite(np.array(distribution.support())).all():
        return []
    return [float(x) for x in distribution.ppf([LEAST, 1.0 - LEAST])]


def _distribution(option: Option, spec: Any, key: str) -> rv_frozen:
    """A distribution of scipy.stats from {from, to} or {nominal, uniform or normal}; SetupError for any other form."""
    if option.kind is not float or option.many:
        expected = "a list" if option.many else TYPE_NAMES[option.kind]
        raise SetupError(f"{key}: the option takes {expected}; vary it in [grid]")
    form = sorted(spec) if isinstance(spec, dict) else []
    if form in (["from", "to"], ["from", "spacing", "to"]):
        low, high, log = _ends(option, spec, key)
        return stats.loguniform(low, high) if log else stats.uniform(low, high - low)
    if form not in (["nominal", "uniform"], ["nominal", "normal"], ["nominal", "normal", "within"]):
        raise SetupError(f"{key} = {quoted(spec)} must be {TOLERANCES}")
    nominal = _free(option).read(spec["nominal"], f"{key}.nominal")
    width, *within = (_width(option, spec[name], nominal, f"{key}.{name}") for name in form[1:])
    if "uniform" in form:
        return stats.uniform(nominal - width, 2.0 * width)
    if not within:
        return stats.norm(nominal, width)
    cut = within[0] / width
    return stats.truncnorm(-cut, cut, nominal, width)


def _free(option: Option) -> Option:
    """What reads a finite number in the unit of an input, whatever its bounds."""
    return Option(option.name, float, default=0.0, unit=option.unit)


def _ends(option: Option, spec: Spec, key: str) -> tuple[float, float, bool]:
    """Both ends of a range, and whether it goes by decades."""
    low, high = (_free(option).read(spec.get(end), f"{key}.{end}") for end in ("from", "to"))
    if not low < high:
        raise SetupError(f"{key}.to = {high:g} must be above from = {low:g}")
    log = SPACING.read(spec.get("spacing"), f"{key}.spacing") == "log"
    if log and not low > 0.0:
        raise SetupError(f"{key}.from = {quoted(spec['from'])} must be above 0 with spacing 'log'")
    return low, high, log


def _width(option: Option, raw: object, nominal: float, key: str) -> float:
    """A width above 0: a number in the unit of the nominal value, or a share of it, "5 %"."""
    written = read_quantity(raw)
    width = -1.0
    if written and written.unit == "%":
        width = written.number / 100.0 * abs(nominal)
    elif not isinstance(raw, str) or (written and written.unit):
        width = _free(option).read(raw, key)
    if not width > 0.0:
        of_zero = " (the nominal value is 0)" if width == 0.0 == nominal else ""
        raise SetupError(f"{key} = {quoted(raw)} must be {WIDTH}{of_zero}")
    return width


def _sampling(table: Spec) -> Sampling:
    check_keys("sampling: ", table, SAMPLING)
    settings = {
        key: option.read(table.get(key), f"sampling.{key}") for key, option in SAMPLING.items()
    }
    number, method = settings["number"], settings["method"]
    if method == "saltelli" and not find_spec("SALib"):
        raise SetupError(f"sampling.method = {method!r} needs the package {SALIB}")
    if method != "lhs" and number & (number - 1):
        below = 1 << (number.bit_length() - 1)
        raise SetupError(
            f"sampling.number = {number} must be a power of 2 with {method!r}, for example "
            f"{below} or {2 * below}"
        )
    return Sampling(**settings)


def check_keys(prefix: str, table: Spec, expected: Iterable[str]) -> None:
    """Raise SetupError if a table has a key that is not expected."""
    for name in table:
        if name not in expected:
            raise SetupError(f"{prefix}unknown key {name!r}, expected {', '.join(expected)}")


def _key(table: str, name: str) -> str:
    return f'{table}."{name}"' if "." in name else f"{table}.{name}"
