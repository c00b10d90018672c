"""A figure: a number with its unit and one error, whatever the error's causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim import SetupError
from cosim.json_values import without_infinities
from cosim.rounding import LEAST_POWER, has_digit, unit_suffix, with_error

if TYPE_CHECKING:
    from cosim.dense import Array

#: Smallest error of a value over its size: some thousand roundings of double precision.
ROUNDING = 1e-12
#: Significant digits of a value with its error, a convention of this project: more are never of use.
MOST_DIGITS = 6
#: Significant digits of a figure in a sentence, a convention of this project; tables have MOST_DIGITS.
SENTENCE_DIGITS = 4
#: Significant digits of a difference in percent in a sentence, a convention of this project.
SHARE_DIGITS = 3
#: Shares of errors at which a function of figures is looked at: even ones, and such as come ever closer to the end, since
#: a pole may lie just before it. Chosen: a pole or a peak between two of them is higher at one of them than at the end.
ON_THE_WAY = sorted({k / 16 for k in range(1, 17)} | {1.0 - 0.5**k for k in range(5, 21)})
#: Largest change there, over that at the ends; a convention, so that the rounding of a small change is no peak.
MOST_BETWEEN = 1.01
#: Why a number that follows from others is not determined.
UNSURE = (
    "it has no value, or changes more than at their ends, within the errors of what it follows from"
)
#: What stands under the figures of a question that does not say itself what its errors are.
ERROR_SCOPE = (
    "The error is numerical only: coupling, steps and rows. Tolerances of the parameters and the model's own "
    "error are not in it; `scenarios study` varies parameters within their tolerances."
)


class Figure(NamedTuple):
    """A value, its unit, and its error in the same unit.

    The error covers every cause: coupling, rows between which the figure lies, settling, the place
    of a peak, a search's bracket. It is 0 for a formula alone. A figure that cannot be determined is
    refused: its error is None, its value is nan, and `reason` says why in a sentence.
    """

    value: float
    unit: str
    error: float | None
    meaning: str = ""
    reason: str = ""

    @classmethod
    def undetermined(cls, unit: str, reason: str, meaning: str = "") -> Figure:
        """A figure that is not determined, and why.

        Parameters
        ----------
        unit : str
            The unit that the value would have.
        reason : str
            Why there is no value, as a sentence without its end.
        meaning : str
            What the figure is.

        Examples
        --------
        >>> Figure(40.123, "rad/s", 0.02).text()
        '40.123 ± 0.020 rad/s'
        >>> Figure.undetermined("rad/s", "no speed of the sweep is steady").text()
        'not determined (no speed of the sweep is steady)'
        """
        return cls(math.nan, unit, None, meaning, reason)

    @classmethod
    def measured(cls, value: float, unit: str, meaning: str = "") -> Figure:
        """A number of a certified run, whose error the run determines: that of coupling, columns and rows.

        It is refused for nan, which is what does not happen. Only `figures` of a question may return it.
        """
        return cls(value, unit, math.nan, meaning)

    @property
    def awaits_error(self) -> bool:
        """Whether its error is still to be determined."""
        return self.error is not None and math.isnan(self.error)

    @property
    def known_error(self) -> float:
        """The error, nan where there is none."""
        return math.nan if self.error is None else self.error

    def problem(self) -> str:
        """Return why this is no valid figure, as the end of a sentence about it; "" if it is one."""
        if not isinstance(self.unit, str) or not self.unit:
            return 'has no unit; a dimensionless number has the unit "1"'
        if self.error is None and not (self.reason and math.isnan(self.value)):
            return "has no error; use Figure.undetermined(unit, reason) to say why"
        if self.error is not None and not (self.error >= 0.0 and math.isfinite(self.value)):
            return f"= {self.value!r} +- {self.error!r} is not a valid figure"
        return ""

    def text(self, unit: str = "") -> str:
        """The figure as text, "12.34 ± 0.05 rad/s"; `unit` is the wording of its unit."""
        if self.error is None:
            return f"not determined ({self.reason})" if self.reason else "not determined"
        if self.error == 0.0:
            return f"{self.value:.6g}{unit_suffix(unit or self.unit)}"
        return with_error(self.value, self.error, unit or self.unit, "±", MOST_DIGITS)

    @property
    def has_digit(self) -> bool:
        """Whether the error leaves a digit of the value; else only a bound of its size is known."""
        return self.error is not None and has_digit(self.value, self.error)

    def brief(self, unit: str = "") -> str:
        """Write the figure for a sentence, in SENTENCE_DIGITS digits where its error allows.

        An error below half a unit of the last digit is left out: 40.0022 ± 0.0002 becomes "40.00".
        With the rounding, the figure is then less than one unit of that digit from what is written. A
        larger error is written as `text` writes it; tables of figures have the error in either case.

        Parameters
        ----------
        unit : str
            Wording of the unit, by default the unit itself.
        """
        if self.error is None:
            return self.text(unit)
        digits = certain(self.value, self.error, SENTENCE_DIGITS)
        if self.error == 0.0:
            is_short = abs(self.value) < 10.0**SENTENCE_DIGITS
            digits = f"{self.value:.{SENTENCE_DIGITS if is_short else MOST_DIGITS}g}"
        return f"{digits}{unit_suffix(unit or self.unit)}" if digits else self.text(unit)

    def json(self) -> dict[str, Any]:
        """The figure for JSON, which has neither infinity nor nan."""
        return without_infinities(self._asdict())  # type: ignore[return-value]


class NamedFigures(dict[str, Figure]):
    """Figures by name; one that there is not is an error that names the nearest."""

    def __missing__(self, name: str) -> Figure:
        near = get_close_matches(name, list(self), 1, 0.0)
        raise KeyError(
            f"there is no figure {name!r}" + "".join(f", did you mean {x!r}?" for x in near)
        )


def figure_of_columns(
    function: Callable[..., float], *columns: Array, unit: str, meaning: str = ""
) -> Figure:
    """Return the number that a function makes of columns of shape (rows,), with the error that their spacing leaves.

    It shows in every second and every third row alone, see `cosim.accuracy.judge.row_spacing_error`. The first and the
    last row are always among them.
    """
    import numpy as np

    from cosim.accuracy.judge import row_spacing_error
    from cosim.dense import thinned_rows

    value, rows = float(function(*columns)), np.arange(float(len(columns[0])))
    second, third = (
        max(abs(float(function(*(x[thinned_rows(rows, n, k)] for x in columns))) - value) for k in range(n))
        for n in (2, 3)
    )  # fmt: skip
    error = float(row_spacing_error(np.array([second]), np.array([third]))[0])
    return Figure(value, unit, max(error, ROUNDING * abs(value)), meaning)


def figure_of_figures(
    function: Callable[..., Any], *figures: Figure, unit: str, meaning: str = ""
) -> Figure:
    """Return the number that a function of arrays makes of figures, with the error of `value_of_values`."""
    refused = next((x for x in figures if x.error is None), None)
    if refused:
        return Figure.undetermined(unit, refused.reason, meaning)
    values, errors = zip(*((x.value, x.error) for x in figures)) if figures else ((), ())
    value, error = map(float, value_of_values(function, values, errors))
    if math.isnan(value):
        return Figure.undetermined(unit, UNSURE, meaning)
    return Figure(value, unit, error, meaning)


def value_of_values(
    function: Callable[..., Any], values: Sequence[Any], errors: Sequence[Any]
) -> tuple[Array, Array]:
    """Return what a function of arrays makes of values, and the error: the largest change that their errors make.

    Each goes to either end of its error alone, and all go to every corner together. Both are nan where
    the function has no value on the way there, or changes more than at the ends: at a pole, or around a peak.
    The values and errors have one shape, or none.
    """
    import numpy as np

    signs = [(-1.0, 1.0) if np.any(error) else (0.0,) for error in errors]
    one = np.eye(len(values))
    ways = np.concatenate([one, -one, np.array([*product(*signs)])])
    shifts = np.multiply.outer([0.0, *ON_THE_WAY], ways)
    shape = np.broadcast_shapes(*map(np.shape, values))
    shifts = shifts.reshape(*shifts.shape, *(1 for _ in shape))
    with np.errstate(all="ignore"):
        at = [x + error * shifts[:, :, k] for k, (x, error) in enumerate(zip(values, errors))]
        y = np.broadcast_to(function(*at), (*shifts.shape[:2], *shape))
        value, changes = y[0, 0], np.abs(y - y[0])
        error = changes.max((0, 1))
        is_peak = error > MOST_BETWEEN * changes[-1].max(0) + ROUNDING * np.abs(value)
    is_unsure = (is_peak | ~np.isfinite(error)) & np.isfinite(sum(errors, np.zeros(shape)))
    return np.where(is_unsure, np.nan, value), np.where(is_unsure, np.nan, error)


def scaled(figure: Figure, factor: float, unit: str, meaning: str) -> Figure:
    """Return a multiple of a figure, in this unit; one that is not determined stays so."""
    error = None if figure.error is None else abs(factor) * figure.error
    return Figure(factor * figure.value, unit, error, meaning, figure.reason)


def checked_figures(
    figures: Any, path: Path, *, may_await_error: bool = False
) -> dict[str, Figure]:
    """Return the figures of a question, those whose error has no bound as undetermined.

    With `may_await_error`, those without an error are let through: a run determines it.

    Raises
    ------
    SetupError
        For what is no figure, with the file of the question, the name and what is wrong.
    """
    if not isinstance(figures, Mapping):
        raise SetupError(f"{path}: figures must be a dict of workbench.Figure")
    result = NamedFigures()
    for key, figure in figures.items():
        prefix = f"{path}: figure {key!r}"
        if not isinstance(figure, Figure):
            raise SetupError(f"{prefix} must be a workbench.Figure(value, unit, error, meaning)")
        awaits_error = may_await_error and figure.awaits_error and figure.unit
        if not awaits_error and (problem := figure.problem()):
            raise SetupError(f"{prefix} {problem}")
        is_bounded = awaits_error or figure.error is None or math.isfinite(figure.error)
        unbounded = Figure.undetermined(figure.unit, "its error has no bound", figure.meaning)
        result[key] = figure if is_bounded else unbounded
    return result


def listed(texts: Sequence[str]) -> str:
    """Texts joined for a sentence: "a", "a and b", "a, b and c"."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def percent(share: float) -> str:
    """Write a share, 0.0123, in percent with three significant digits, "1.23 %"."""
    value = 100.0 * share
    if abs(value) >= 10.0 ** (SHARE_DIGITS - 1):
        return f"{value:.0f} %"
    return f"{value:.{SHARE_DIGITS}g} %"


def certain(value: float, error: float, digits: int) -> str:
    """Write a value in so many significant digits, or "" where its error needs to be written, too.

    Parameters
    ----------
    value, error : float
        A value and its error, in the same unit.
    digits : int
        Significant digits; zeros fill the places behind them in front of the decimal point.

    Returns
    -------
    str
        The digits, or "" if the error is half a unit of the last of them or more, or the value is 0.
    """
    if not (value and math.isfinite(value)):
        return ""
    text = f"{value:.{digits - 1}e}"
    last = int(text.partition("e")[2]) + 1 - digits
    if not error < 0.5 * 10.0**last:
        return ""
    return text if last < LEAST_POWER else f"{float(text):.{max(-last, 0)}f}"
