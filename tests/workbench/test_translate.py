"""Python that was translated, in a browser, beside Python."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from cosim import SetupError
from tests.workbench.browser import Browser
from tests.workbench.test_report import shown
from workbench.figure import Figure, whole
from workbench.live import ENGINE, FOLDER
from workbench.measure import harmonics
from workbench.translate import script

__all__ = ["shown"]
NUMBERS = (0.0, -0.0, 0.0625, 2.5, -1234.5678, 1e-7, 123456789.0, math.nan, math.inf)
SIZES = {("m", "mm"): 1e3, ("rad", "deg"): 180 / math.pi}


class Place(NamedTuple):
    x: float
    y: float = 2.0

    @property
    def far(self) -> float:
        return math.hypot(self.x, self.y)

    def moved(self, by: float, *, up: bool = False) -> Place:
        return self._replace(y=self.y + by) if up else self._replace(x=self.x + by)


def formats() -> Any:
    forms = [f"{x:g} {x:.3g} {x:.3f} {x:z.1f} {x:+.2f} {x:.0%} {x:.2e}" for x in NUMBERS]
    return [*forms, f"{3!r} {'a'!r} {round(2.5)} {round(-1.25, 1)} {7 // 2} {-7 % 5}"]


def collections() -> Any:
    first, *rest = [3, 1, 2]
    *front, last = "a", "b", "c"
    seen = {x: k for k, x in enumerate(sorted(rest), 1)} | {"far": Place(3.0, 4.0).far}
    seen |= {key: value for (key, _), value in SIZES.items()}
    numbers = [*range(2, 9, 3)]
    numbers += [10] * 2
    numbers[0], other = -1, numbers[-2:]
    place, pairs = Place(1.0).moved(2.0, up=True), list(zip("ab", count(5)))
    least = min(((abs(x - 4), x) for x in numbers), default=None)
    none = max((x for x in numbers if x > 99), default=-1)
    words = [first, front, last, seen["far"], seen["m"], place, pairs, least, none, other]
    inside = 1 in seen and "far" in seen and not (0 < len(words) <= 2) and "c" not in front
    return [*words, inside, SIZES["m", "mm"], "-".join(words[2:1] + front).partition("-"), numbers]


def arrays() -> Any:
    x = np.linspace(0.0, 1.0, 5)
    grid = np.stack([x, x**2, -x], axis=-1)
    grid[:, 0] -= 1.0
    turned = np.exp(1j * x) * (2.0 - 1j) / (1 + x)
    spline = CubicSpline(x, np.sin(3 * x))
    told = [grid[1:, -1], grid[[0, 2]], grid[x > 0.3].T, grid.max(axis=0), grid[None, :2, 1]]
    told += [turned.real, abs(turned), np.outer(x, x)[-1], np.where(x > 0.5, x, -x), x[::-1]]
    told += [np.diff(x), np.flatnonzero(x > 0.4), np.clip(3 * x, 0.5, 2.0), x[:, None] + x[:2]]
    told += [spline(0.3), spline.derivative().roots(extrapolate=False), spline.integrate(0.1, 0.9)]
    told += [spline.solve(0.5, extrapolate=False), np.roots([1.0, -3.0, 2.0]), (x > 2).any()]
    return [y.tolist() if isinstance(y, np.ndarray) else float(y) for y in told]


def running() -> Any:
    total = 0
    for k in count():
        if k % 2:
            continue
        for j in range(k):
            if j > 5:
                break
            total += j
        else:
            total += 100
        if k > 12:
            break
    add = partial(lambda a, b, c=0: a + 10 * b + 100 * c, 1, c=3)
    return [total, add(2), (found := 5) + found, None if total else 1]


class Lost(Exception):
    pass


@dataclass(frozen=True)
class Counted:
    """What is kept, by an object and by a function."""

    start: int
    told: list[int] = field(default_factory=list)

    def _more(self) -> int:
        self.told.append(self.start)
        return len(self.told)

    @cached_property
    def once(self) -> int:
        return self._more()


TOLD: list[int] = []


@cache
def doubled(n: int, place: Place) -> float:
    TOLD.append(n)
    return 2 * n + place.x


def asking(first: int) -> Generator[list[int], int, str]:
    total = 0
    for k in range(first, first + 3):
        total += yield [k, total]
    if total > 99:
        raise Lost(f"{total} is too much")
    return f"{total} in all"


def generators() -> Any:
    told: list[Any] = []
    for one, answers in ((asking(1), (5, 6, 7)), (asking(2), (90, 9, 9))):
        try:
            told.append(next(one))
            for x in answers:
                told.append(one.send(x))
        except StopIteration as done:
            told.append(done.value)
        except Lost as reason:
            told.append(str(reason))
    numbers = count(3)
    told += [list(islice(numbers, 2)), next(numbers), list(islice(iter([8, 9]), 5))]
    first, other = Counted(1), Counted(2)
    told += [first.once, first.once, first._more(), other.told, replace(other, start=7).once]
    told += [doubled(1, Place(0.5)), doubled(1, Place(0.5)), doubled(2, Place(0.5)), TOLD]
    told += [getattr(Place(3.0, 4.0), name)(1.0).far for name in ("moved",)]
    return [*told, *(getattr(2 + 3j, part) for part in ("real", "imag"))]


def numerics() -> Any:
    x = np.linspace(0.0, 2.0, 9)
    z = np.exp(1j * x) / (2.0 + 1j * x) - 3j * x**2
    grid = np.outer(x[:4], [1.0, -2.0, 0.5]) + np.eye(4)[:, :3]
    few = np.polynomial.Polynomial.fit(x[:4], z[:4], 3)
    told = [abs(z), (z * z[::-1] - z).real, (z**3).imag, np.angle(-z, deg=True), few(0.3).imag]
    told += [CubicSpline(x, z)(np.array([0.1, 1.9])).imag, CubicSpline(x, z).derivative()(0.7).imag]
    told += [np.linalg.lstsq(grid, x[:4], rcond=1e-12)[0], np.linalg.solve(grid[:3], x[:3])]
    told += [np.linalg.lstsq(grid, np.stack([x[:4], x[1:5]], axis=1), rcond=1e-12)[0]]
    told += [np.abs(np.linalg.eigvals([[0.2, 1.0], [-0.5, 0.1]])).max(), np.diff(grid, axis=0)]
    told += [np.sort(np.abs(np.linalg.eigvals(np.array([[2.0, 1, 0], [0, 3, 1], [1, 0, 4]]))))]
    told += [np.sort(np.roots([1.0, -2.5, -3.0, 4.0, 1.0]).real)]
    told += [np.where(np.eye(3), 1.0, grid[:3]).prod(axis=1), grid @ x[:3]]
    told += [brentq(lambda x: math.cos(x) - x, 0.0, 1.0, xtol=1e-15)]
    told += [harmonics(3 * x, np.stack([np.sin(3 * x) + 0.2, np.cos(6 * x)], axis=1), 2).imag]
    told += [abs(harmonics(3 * x, np.sin(3 * x + 0.4), 2))]
    return [y.tolist() if isinstance(y, np.ndarray) else float(y) for y in told]


def verdicts() -> Any:
    figures = {"t": Figure(2.0, "s", 0.1), "f": Figure.refused("N", "it stuck")}
    figures |= {"g": Figure.refused("N", "it broke")}
    t, f, g = (x.text() for x in figures.values())
    said = (
        f"It takes {t}. It gives {f}.\nIt is {f}; it is {t}.",
        f"Of {f}, {g}.",
        f"With it: {f}.\n{f}",
    )
    return [whole(x, figures) for x in said]


def leaves() -> None:
    with Path("x").open():
        pass


@pytest.mark.parametrize(
    "tell", [formats, collections, arrays, running, generators, numerics, verdicts]
)
def test_translated_python_tells_what_python_tells(
    tell: Callable[[], Any], shown: Browser, tmp_path: Path
) -> None:
    made = "".join((FOLDER / name).read_text().replace('"use strict";', "") for name in ENGINE)
    empty = tmp_path / "empty.html"
    empty.write_text("<!doctype html><html data-ready='yes'>")
    shown.open(empty, 1000)
    body = f"{made}; {script({'tell': tell}, ['tests'])}; return py.plain(py.call(page.tell, []));"
    seen, wanted = shown.value(f"(() => {{ {body} }})()"), json.loads(json.dumps(tell()))
    for one, other in zip(flat(seen), flat(wanted), strict=True):
        number = isinstance(other, float | int)
        assert one == (pytest.approx(other, rel=1e-12, abs=1e-14) if number else other)


def flat(told: Any) -> list[Any]:
    """All that is in lists of lists."""
    return [x for one in told for x in flat(one)] if isinstance(told, list) else [told]


def test_what_cannot_be_translated_is_refused_by_file_and_line() -> None:
    line = leaves.__code__.co_firstlineno + 1
    with pytest.raises(SetupError, match=rf"test_translate\.py:{line}: LIVE cannot use With here"):
        script({"leaves": leaves}, ["tests"])
