"""Drawn systems for benchmarks/certify.py whose solution is exact: linear ones by modes, bouncing ones by DOP853.

Two or three parts of models/linear drive each other; what is special of a system is its kind. A seed and a number
give one of them, with its algorithm, its steps and its figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

from benchmarks.models.linear import pack
from cosim import Adaptive, Series, System
from cosim.metrics import Crossing, Largest, Last, Mean, Metric, Rms, Smallest, TimeOfLargest

Array = NDArray[np.float64]
KINDS = (
    "rest", "jump", "staircase", "change", "sine", "sine in a step", "triangle", "pulse", "tie", "one part",
    "fixed step", "relaxing", "relaxing and a jump", "swinging", "hidden resets", "hidden outputs",
    "hidden resets and a jump", "bouncing",
)  # fmt: skip
ALGORITHMS = ("jacobi", "gauss-seidel", "strang", "iterated")
#: Kinds of which adaptive steps say nothing, or which cannot have them.
FIXED_ONLY = {"one part", "fixed step"}
#: Times of a piece at which the truth is looked at, evenly and from its beginning on.
EVEN, EARLY = 1500, 200


@dataclass(frozen=True)
class Drawn:
    """A system with its settings, and the truth of each of its figures."""

    name: str
    system: System
    settings: dict[str, Any]
    step: float | Adaptive
    metrics: dict[str, Metric]
    truth: dict[str, float]
    #: What is certain of each truth, and the largest value of its column.
    certain: dict[str, float]


class Piece:
    """A solution from one time to another [s]: a function of the time since, which gives all columns."""

    def __init__(
        self, begin: float, end: float, columns: Callable[[Array], Array], wave: float
    ) -> None:
        self.begin, self.end, self.columns, self.wave = begin, end, columns, wave


class Truth:
    """The columns of a solution in pieces, and the figures of one."""

    def __init__(self, pieces: Sequence[Piece]) -> None:
        self.pieces = pieces

    def within(self, begin: float, end: float) -> Truth:
        """The part from one time to another [s]."""
        parts = []
        for p in self.pieces:
            a, b = max(p.begin, begin), min(p.end, end)
            if b > a:
                moved = a - p.begin
                of = lambda s, p=p, moved=moved: p.columns(s + moved)
                parts.append(Piece(a, b, of, p.wave))
        return Truth(parts)

    def grid(self, p: Piece) -> Array:
        """Times since the beginning of a piece [s], close behind it."""
        length = p.end - p.begin
        even = np.linspace(0.0, length, max(EVEN, int(40 * length * p.wave)))
        return np.union1d(even, np.geomspace(1e-9 * length, length, EARLY))

    def figures(self, k: int, level: float | None = None) -> dict[str, float]:
        """The figures of column k."""
        total = square = 0.0
        tops: dict[str, tuple[float, float]] = {}
        nodes, weights = np.polynomial.legendre.leggauss(8)
        crossing, before = math.nan, math.nan
        for p in self.pieces:
            s = self.grid(p)
            x = p.columns(s)[k]
            half = 0.5 * np.diff(s)
            inner = (0.5 * (s[1:] + s[:-1]) + np.outer(nodes, half)).ravel()
            v = p.columns(inner)[k].reshape(len(nodes), -1)
            total += float(weights @ v @ half)
            square += float(weights @ v**2 @ half)
            for name, sign in (("largest", 1.0), ("smallest", -1.0)):
                for n in np.argsort(-sign * x)[:3]:
                    time, value = float(s[n]), float(x[n])
                    if 0 < n < len(s) - 1:
                        f = lambda q, p=p, sign=sign: -sign * float(p.columns(np.array([q]))[k, 0])
                        found = minimize_scalar(
                            f,
                            bounds=(s[n - 1], s[n + 1]),
                            method="bounded",
                            options={"xatol": 1e-13},
                        )
                        if sign * value < -found.fun:
                            time, value = float(found.x), -sign * float(found.fun)
                    if name not in tops or sign * value > sign * tops[name][0]:
                        tops[name] = value, p.begin + time
            if level is not None and math.isnan(crossing):
                side = np.sign(x - level)
                if before * side[0] < 0:
                    crossing = p.begin
                elif (side != side[0]).any():
                    n = int(np.argmax(side != side[0]))
                    f = lambda q, p=p: float(p.columns(np.array([q]))[k, 0]) - level
                    crossing = p.begin + brentq(f, s[n - 1], s[n], xtol=1e-15)
                before = float(side[-1])
        span = self.pieces[-1].end - self.pieces[0].begin
        return {
            "last": float(x[-1]), "largest": tops["largest"][0], "time of largest": tops["largest"][1],
            "smallest": tops["smallest"][0], "mean": total / span, "rms": math.sqrt(square / span),
            "crossing": crossing,
        }  # fmt: skip


FIGURES: dict[str, Callable[..., Metric]] = {
    "last": Last, "largest": Largest, "time of largest": TimeOfLargest, "smallest": Smallest, "mean": Mean, "rms": Rms,
    "crossing": Crossing,
}  # fmt: skip


@dataclass
class Input:
    """c0 + c1 (t - begin) + a sin(w t + p) from `begin` on, in pieces that follow each other."""

    begins: list[float]
    level: list[float]
    slope: list[float]
    wave: tuple[float, float, float] = (0.0, 0.0, 0.0)
    held: bool = False

    def at(self, k: int, t: float) -> float:
        """The value in piece k."""
        a, w, p = self.wave
        return self.level[k] + self.slope[k] * (t - self.begins[k]) + a * math.sin(w * t + p)

    def profile(self, start: float, stop: float) -> Any:
        """What a system takes for it."""
        a, w, p = self.wave
        if a:
            level = self.level[0]
            return lambda t: level + a * math.sin(w * t + p)
        times, values = [], []
        for k, (begin, end) in enumerate(zip(self.begins, [*self.begins[1:], stop])):
            times += [begin, end]
            values += [self.at(k, begin), self.at(k, end)]
        series = Series.of({"t": times, "u": values})
        return series.held() if self.held else series


class Coupled:
    """Parts on their wires as equations of the states, shape (2 * parts,), and of free inputs, shape (inputs,)."""

    def __init__(
        self,
        parts: Mapping[str, Mapping[str, float]],
        wires: Mapping[str, str],
        free: Mapping[str, Input],
    ) -> None:
        self.parts, self.wires, self.names, self.free = parts, wires, [*parts], free
        self.x = np.array([q.get(f"x{i}", 0.0) for q in parts.values() for i in (1, 2)])

    def state(self, name: str, x: Array) -> float:
        """A state by its name, of all."""
        part, v = name.split(".")
        return float(x[2 * self.names.index(part) + int(v[1]) - 1])

    def input(self, port: str, x: Array, u: Array) -> float:
        """What an input hears."""
        if port in self.wires:
            return self.state(self.wires[port], x)
        return float(u[[*self.free].index(port)]) if port in self.free else 0.0

    def rates(self, x: Array, u: Array) -> Array:
        """The derivatives of the states."""
        rates = []
        for name, q in self.parts.items():
            x1, x2 = (self.state(f"{name}.x{i}", x) for i in (1, 2))
            heard = [self.input(f"{name}.u{j}", x, u) for j in (1, 2)]
            for i, at in ((1, x1), (2, math.sin(x1) if q.get("swings") else x1)):
                own = q.get(f"a{i}1", 0.0) * at + q.get(f"a{i}2", 0.0) * x2
                rates.append(own + sum(q.get(f"b{i}{j}", 0.0) * y for j, y in enumerate(heard, 1)))
        return np.array(rates)

    def column(self, name: str, x: Array, u: Array) -> float:
        """A state or the output z; that which rises by itself is none."""
        part, v = name.split(".")
        if v.startswith("x"):
            return self.state(name, x)
        q = self.parts[part]
        return sum(
            q.get(f"c{j}", 0.0) * self.state(f"{part}.x{j}", x)
            + q.get(f"d{j}", 0.0) * self.input(f"{part}.u{j}", x, u)
            for j in (1, 2)
            if v == "z"
        )

    def resets(self, start: float, stop: float) -> dict[float, list[int]]:
        """Which parts begin again when [s]."""
        resets: dict[float, list[int]] = {}
        for k, q in enumerate(self.parts.values()):
            t, period = q.get("first", 1e300), q.get("period", 0.0)
            while t <= stop:
                resets.setdefault(t, []).append(k)
                t = t + period if period else 1e300
        return resets


def linear(parts: Coupled, start: float, stop: float, columns: Sequence[str]) -> Truth:
    """The solution of linear parts by their modes, piece by piece."""
    inputs, resets, x = [*parts.free.values()], parts.resets(start, stop), parts.x.copy()
    no_x, no_u = np.zeros(len(x)), np.zeros(len(inputs))
    units = [(e, no_u) for e in np.eye(len(x))], [(no_x, e) for e in np.eye(len(inputs))]
    M, B = (np.array([parts.rates(*each) for each in some]).reshape(-1, len(x)).T for some in units)
    C, D = (
        np.array([[parts.column(c, *each) for each in some] for c in columns]) for some in units
    )
    rises = [parts.parts[c[0]].get("rise", 0.0) if c.endswith(".s") else 0.0 for c in columns]
    rate, modes = np.linalg.eig(M)
    identity, since = np.eye(len(x)), dict.fromkeys(parts.names, start)
    begins = {b for u in inputs for b in u.begins if start < b < stop}
    pieces = []
    for a, b in pairwise(sorted({start, stop, *resets, *begins})):
        now = [max(n for n, t in enumerate(u.begins) if t <= a or n == 0) for u in inputs]
        slope = np.array([u.slope[n] for u, n in zip(inputs, now)])
        level = [u.level[n] + u.slope[n] * (a - u.begins[n]) for u, n in zip(inputs, now)]
        # inputs are the real part of the sum of p exp(r s), and a slope times s; so are the states that they drive
        terms = [(0.0, np.array(level))]
        for u, e in zip(inputs, np.eye(len(inputs))):
            size, w, phase = u.wave
            if size:
                terms.append((1j * w, -1j * size * np.exp(1j * (w * a + phase)) * e))
        drift = np.linalg.solve(-M, B @ slope)
        driven = [np.linalg.solve(r * identity - M, B @ p) for r, p in terms]
        driven[0] = driven[0] - np.linalg.solve(-M, drift)
        c = np.linalg.solve(modes, x - sum(q.real for q in driven))
        rs = np.array([*rate, *(r for r, _ in terms)])
        qs = np.column_stack([modes * c, *driven])
        ps = np.column_stack([0.0 * modes[: len(inputs)], *(p for _, p in terms)])
        rise = np.array([k * (a - since[name[0]]) for k, name in zip(rises, columns)])

        def of(
            s: Array, rs: Array = rs, out: Array = C @ qs + D @ ps, rise: Array = rise,
            slopes: Array = C @ drift + D @ slope + rises,
        ) -> Array:  # fmt: skip
            values = (out @ np.exp(np.outer(rs, s))).real
            return np.asarray(values + rise[:, None] + np.outer(slopes, s))

        wave = max((abs(r) / 6.28 for r, _ in terms), default=0.0)
        pieces.append(Piece(a, b, of, wave))
        x = (qs @ np.exp(rs * (b - a))).real + drift * (b - a)
        for k in resets.get(b, ()):
            q = parts.parts[parts.names[k]]
            x[2 * k : 2 * k + 2] *= q.get("keep1", 1.0), q.get("keep2", 1.0)
            since[parts.names[k]] = b
    if stop in resets:  # the last value is that after the reset
        last = C @ x
        end = lambda s: last[:, None] + 0.0 * s
        pieces.append(Piece(stop, math.nextafter(stop, math.inf), end, 0.0))
    return Truth(pieces)


def bouncing(parts: Coupled, start: float, stop: float, columns: Sequence[str]) -> Truth:
    """The solution of parts that swing, and bounce at a floor, by an integrator that meets each bounce."""
    floors = [(2 * k, q) for k, q in enumerate(parts.parts.values()) if "floor" in q]
    events = []
    for k, q in floors:
        event = lambda _, y, k=k, floor=q["floor"]: y[k] - floor
        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        events.append(event)
    rows = [2 * parts.names.index(c[0]) + int(c[-1]) - 1 for c in columns]
    t, y, pieces, no_u = start, parts.x, [], np.zeros(0)
    while t < stop:
        got = solve_ivp(
            lambda _, y: parts.rates(y, no_u), (t, stop), y, "DOP853", dense_output=True, rtol=1e-12,
            atol=1e-13, events=events, max_step=0.01,
        )  # fmt: skip
        end, y = float(got.t[-1]), got.y[:, -1].copy()
        of = lambda s, got=got, t=t: got.sol(t + s)[rows]
        pieces.append(Piece(t, end, of, 0.0))
        for (k, q), found in zip(floors, got.t_events or []):
            if len(found):
                y[k], y[k + 1] = q["floor"], -q.get("keep2", 1.0) * y[k + 1]
        t = end
    return Truth(pieces)


def draw(seed: int, number: int, folder: Path, kind: str = "") -> Drawn:
    """System number so-and-so of a seed, of one of the kinds in turn."""
    rng = np.random.default_rng([seed, number])
    kind = kind or KINDS[number % len(KINDS)]
    uniform = lambda a, b: float(rng.uniform(a, b))
    chance = lambda share: bool(rng.random() < share)
    log = lambda a, b: float(np.exp(rng.uniform(math.log(a), math.log(b))))
    stop = 1.0
    is_hidden = kind.startswith("hidden") or kind == "bouncing"
    steps = int(rng.choice([100, 160, 200, 400]))
    start = 0.0 if chance(0.8) else 0.25
    step = (stop - start) / steps
    parts: dict[str, dict[str, float]] = {}
    # two oscillators or lags that drive each other
    for name in "ab" if kind != "one part" else "a":
        f, d = 2 * math.pi * uniform(0.6, 2.5), uniform(0.1, 0.6)
        if chance(0.6) or kind in ("tie", "bouncing", "swinging"):
            q = {
                "a12": 1.0,
                "a21": -f * f,
                "a22": -2 * d * f,
                "b21": uniform(0.2, 0.6) * f * f,
                "c1": 1.0,
                "d1": 0.0,
            }
            q |= {"x1": uniform(-1, 1), "x2": uniform(-1, 1) * f}
        else:
            q = {
                "a11": -f,
                "a22": -uniform(0.5, 2.0) * f,
                "a21": f,
                "b11": uniform(0.3, 0.9) * f,
                "c1": uniform(0.5, 1),
                "c2": uniform(-1, 1),
            }
            q |= {"x1": uniform(-1, 1), "x2": uniform(-1, 1)}
        parts[name] = q | {"d1": float(rng.choice([0.0, 0.5])), "b22": 0.5 * f, "b12": 0.0}
    wires = {"a.u1": "b.x1", "b.u1": "a.x1"} if "b" in parts else {}
    if wires and chance(0.4):
        wires["b.u1"] = "a.x2"
        parts["b"] |= {k: 0.1 * parts["b"].get(k, 0.0) for k in ("b11", "b21")}
    if kind.startswith("relaxing"):
        T = step * log(1e-3, 10.0)
        q = parts["b"] = {
            "a11": -1 / T,
            "b11": uniform(0.5, 1.0) / T,
            "x1": uniform(-1, 1),
            "c1": 1.0,
            "b12": 0.5 / T,
        }
        q |= {"a21": 1 / (T * uniform(2, 20)), "x2": uniform(-1, 1)}
        q["a22"] = -q["a21"]
        wires["b.u1"] = "a.x1"
        wires["a.u1"] = str(rng.choice(["b.x1", "b.x2"]))
    free: dict[str, Input] = {}
    port = "a.u2" if kind != "one part" else "a.u1"
    grid = lambda: start + step * float(rng.integers(steps // 8, steps // 2))
    at = grid() + (0.0 if chance(0.3) else uniform(0.05, 0.95) * step)
    changes: list[str] = []
    if "jump" in kind or kind in ("change", "fixed step") or (kind == "one part" and chance(0.5)):
        before, after = uniform(-0.5, 0.5), uniform(1.0, 2.0) * float(rng.choice([1, -1]))
        free[port] = Input([start, at], [before, after], [0.0, 0.0])
        if kind == "change":
            changes = [f"at {at!r} s {port} = {after!r}"]
    elif kind == "staircase":
        n = int(rng.choice([5, 20, 40]))
        begins = [start, *(start + (stop - start) * np.sort(rng.uniform(0.02, 0.98, n))).tolist()]
        free[port] = Input(
            begins, rng.normal(size=n + 1).tolist(), [0.0] * (n + 1), held=chance(0.5)
        )
    elif kind.startswith("sine"):
        w = 2 * math.pi * uniform(0.5, 6.0)
        if kind == "sine in a step":
            w = 2 * math.pi * int(rng.integers(1, 6)) / step
        free[port] = Input(
            [start], [uniform(-0.5, 0.5)], [0.0], (uniform(0.5, 2.0), w, uniform(0, 6))
        )
    elif kind == "triangle":
        middle = start + 0.4 * (stop - start) * uniform(0.5, 1.5)
        up = uniform(1, 4)
        free[port] = Input([start, middle], [0.0, up * (middle - start)], [up, -up])
    elif kind == "pulse":
        width = step * log(0.05, 20)
        free[port] = Input(
            [start, at, at + width],
            [0.0, min(2.0 * (stop - start) / width * 0.1, 500.0), 0.0],
            [0.0] * 3,
        )
    if kind in ("hidden resets", "hidden resets and a jump"):
        parts["b"] |= {
            "first": start + uniform(0.05, 0.4),
            "period": uniform(0.02, 0.4),
            "keep1": uniform(-0.5, 1.2),
            "keep2": uniform(-0.5, 1.2),
        }
    elif kind == "hidden outputs":
        parts["b"] |= {
            "first": start + uniform(0.05, 0.4),
            "period": uniform(0.05, 0.3),
            "rise": uniform(0.5, 5.0),
        }
        parts["b"] |= {"keep2": uniform(0.0, 0.9)}
    elif kind in ("swinging", "bouncing"):
        for q in parts.values():
            f = 2 * math.pi * uniform(0.8, 2.0)
            q |= {
                "swings": 1.0,
                "a21": -f * f,
                "a22": -uniform(0.02, 0.3) * f,
                "x1": uniform(0.3, 2.0),
                "x2": 0.0,
                "b21": uniform(0.1, 0.3) * f * f,
            }
            q["b22"] = 0.0
        if kind == "bouncing":
            parts["b"] |= {"floor": uniform(-0.3, 0.1), "keep2": uniform(0.5, 0.9)}
    elif kind == "tie":
        # x1 of a alone swings without damping, so that its peaks are nearly as high
        f = 2 * math.pi * uniform(2.0, 4.0)
        parts["a"] |= {
            "a21": -f * f,
            "a22": -float(rng.choice([-1, 1])) * log(1e-9, 1e-2) * f,
            "b21": log(1e-9, 1e-3),
            "b22": 0.0,
        }
    columns = (
        ["a.x1", "a.z"]
        if kind == "one part"
        else ["a.x1", "b.x1", "b.s" if kind == "hidden outputs" else "b.z"]
    )
    if kind in ("swinging", "bouncing"):
        columns = ["a.x1", "b.x1", "b.x2"]
        truth = bouncing(Coupled(parts, wires, {}), start, stop, columns)
    else:
        for name in parts:
            for j in (1, 2):
                if f"{name}.u{j}" not in wires and f"{name}.u{j}" not in free:
                    parts[name] |= {f"b{i}{j}": 0.0 for i in (1, 2)}
        truth = linear(Coupled(parts, wires, free), start, stop, columns)
    name = f"{'events' if is_hidden else 'linear'}{'' if kind != 'fixed step' else '_fixed'}.fmu"
    fmu = folder / name
    if not fmu.exists():
        pack(fmu, has_events=is_hidden, varies=kind != "fixed step")
    if kind == "fixed step":  # its table jumps at points that all runs have
        u = free[port]
        u.begins[1] = start + 4 * step * round((at - start) / (4 * step))
        truth = linear(Coupled(parts, wires, free), start, stop, columns)
    values = {f"{p}.{v}": x for p, q in parts.items() for v, x in q.items()}
    if changes:
        values[port] = free[port].level[0]
    inputs = {} if changes else {p: u.profile(start, stop) for p, u in free.items()}
    system = System(
        dict.fromkeys(parts, fmu),
        [f"{s} -> {t}" for t, s in wires.items()],
        values,
        inputs=inputs,
        changes=changes,
    )
    algorithm = ALGORITHMS[int(rng.integers(4))]
    settings: dict[str, Any] = {
        "stop": stop,
        "start": start,
        "algorithm": algorithm,
        "input_order": int(rng.choice([0, 0, 0, 1, 2])),
    }
    h: float | Adaptive = step
    if kind not in FIXED_ONLY and chance(0.3):
        h = Adaptive(log(1e-4, 1e-2))
    metrics: dict[str, Metric] = {}
    true: dict[str, float] = {}
    certain: dict[str, float] = {}
    begin = start + (stop - start) * uniform(0.2, 0.5)
    stretches = {
        "": (-math.inf, math.inf),
        "@": (begin, begin + (stop - begin) * uniform(0.3, 1.0)),
    }
    if chance(0.3):
        stretches["@"] = (begin, stop)
    for k, column in enumerate(columns):
        for mark, (a, b) in stretches.items():
            some = truth if not mark else truth.within(a, b)
            bounds = some.figures(k)
            level = float(
                f"{bounds['smallest'] + uniform(0.35, 0.65) * (bounds['largest'] - bounds['smallest']):.5g}"
            )
            stretch = {} if not mark else {"begin": a, "end": b}
            size = max(abs(bounds["largest"]), abs(bounds["smallest"]), 1e-300)
            for figure, value in some.figures(k, level).items():
                if mark and figure in ("smallest", "rms") and k:
                    continue
                key = f"{column}{mark}|{figure}"
                metrics[key] = FIGURES[figure](
                    column, **stretch, **({"level": level} if figure == "crossing" else {})
                )
                true[key] = value
                certain[key] = 1e-9 * (
                    stop if figure in ("crossing", "time of largest") else size
                ) + (2e-8 if "ing" in kind[-4:] and kind in ("swinging", "bouncing") else 0.0)
    adaptive = f" ad {h.tolerance:.1g}" if isinstance(h, Adaptive) else f" N {steps}"
    label = f"{seed}/{number} {kind} {algorithm} o{settings['input_order']}{adaptive}"
    return Drawn(label, system, settings, h, metrics, true, certain)
