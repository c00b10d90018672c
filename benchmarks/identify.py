"""How often the interval of a resonance holds the truth.

Machines of four kinds are drawn at random, integrated by DOP853 from equations that no FMU shares, and
recorded for a second at 1 kHz with noise and on the grid of an encoder. Each is identified from first
guesses that are up to 20 % off, of any angle. Shown are how many were answered, how many intervals hold
the true resonance, how wide they are, and how many of the answers are wrong by more than three
half-widths. With --errors the machines have something that the model lacks.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.coverage import Demand, Stated, Study, Trial, main
from cosim import Identified, Series, System, identify
from cosim.system import Value
from tests.scenarios import exciter_oracle
from tests.scenarios.orbit_oracle import Drive
from tests.scenarios.shooting import Motor

#: The page that this backs, and its heading.
CLAIM = ("docs/identify.md", "How far it can be trusted")

FMUS = ROOT / "fmus/native"
CONVEYOR = {"motor": FMUS / "DriveMotor.fmu", "conveyor": FMUS / "CrankConveyor.fmu"}
EXCITER = {"motor": FMUS / "DCMotor.fmu", "exciter": FMUS / "UnbalanceExciter.fmu"}
#: Duration of a record [s]. Chosen: a few revolutions.
STOP = 1.0
#: Rows of a record per second [Hz]. Chosen: a usual logger.
RATE = 1000.0
#: Largest relative error of a first guess. Chosen: what is known from data sheets.
GUESS_ERROR = 0.2
#: Radius of the crank [m]. Convention of the FMU's default.
R = 0.010
#: Length of the rod where it is finite [m]. Convention of the FMU's default.
ROD = 0.4
#: Relative tolerance of the motion that is measured. Chosen: far below the noise of the measurements.
RELATIVE_TOLERANCE = 1e-8
#: Absolute tolerance of that motion, in the units of its states. Chosen: a tenth of the relative one.
ABSOLUTE_TOLERANCE = 1e-9
#: Half of the difference of two speeds from which a motor's slope is computed [rad/s]. Chosen: its square, the error of
#: the slope, is small, and rounding is still smaller.
SPEED_DIFFERENCE = 1e-4
Samples = NDArray[np.float64]
Machine = dict[str, float]


class Record(NamedTuple):
    """A machine, what is free of it, known and sought first, its resonance, and what was measured:
    column, unit, noise over the deviation of the signal, and the grid over the noise.
    """

    machine: Machine
    parts: Mapping[str, Path]
    wires: Sequence[str]
    free: Sequence[str]
    prior: Mapping[str, float]
    first: Sequence[str]
    resonance: Callable[[Mapping[str, float]], float]
    columns: Mapping[str, tuple[int, float, float]]
    fixed: Mapping[str, Value]
    rates: Callable[..., Sequence[float]]
    states: Sequence[str]


def static(p: Mapping[str, float], w: float) -> float:
    """Torque of a motor at a steady speed."""
    if "motor.kloss.w_s" not in p:
        return p["motor.A"] - p["motor.B"] * w
    return float(Motor.of(p).torque(w)[0])


def conveyor_rates(
    p: Machine,
    t: float,
    y: Samples,
    rod: float = math.inf,
    friction: float = 0.0,
    drift: float = 0.0,
    most: float = math.inf,
) -> list[float]:
    """Rates of angle, speed and torque; with dry friction [N] of the trough, a supply that drifts by a
    share per second, and a motor whose torque is limited [N.m].
    """
    phi, w, tau = y
    drive = Drive.of(
        {**p, "conveyor.crank.r": R, "conveyor.rod.l": rod, "conveyor.rod.finite": rod < math.inf}
    )
    slope = drive.trough(phi)[1]
    drifted = p | {"motor.A": p.get("motor.A", 0.0) * (1.0 + drift * t)}
    torque = min(max(static(drifted, w), -most), most)
    free = tau - friction * slope * math.tanh(200.0 * slope * w)
    return [w, drive.acceleration(phi, w, free), (torque - tau) / p["motor.T"]]


def exciter_rates(p: Machine, t: float, y: Samples, **_: float) -> list[float]:
    """Rates of angle, current, speed, displacement and velocity."""
    return exciter_oracle.rates(
        {x: p[name] for x, name in exciter_oracle.NAMES.items()}, p["motor.v"], y
    )


def electromechanical_resonance(p: Mapping[str, float]) -> float:
    """Where motor and load swing against each other, about the mean speed [rad/s]."""
    load = p["conveyor.trough.d"] * R * R / 2
    inertia = p["conveyor.rotor.J"] + p["conveyor.trough.m"] * R * R / 2
    if "motor.kloss.w_s" in p:
        w_s = p["motor.kloss.w_s"]
        pull_out = w_s * (1.0 - p["motor.kloss.s_b"])
        if pull_out <= 0.0 or static(p, pull_out) <= load * pull_out:
            return math.nan
        w = brentq(lambda w: static(p, w) - load * w, pull_out, w_s)
        slope = (static(p, w - SPEED_DIFFERENCE) - static(p, w + SPEED_DIFFERENCE)) / (
            2 * SPEED_DIFFERENCE
        )
    else:
        slope = p["motor.B"]
    return math.sqrt((slope + load) / (inertia * p["motor.T"])) / 2


def mount_resonance(p: Mapping[str, float]) -> float:
    """The resonance of the mount of an exciter [rad/s]."""
    return math.sqrt(p["exciter.mount.c"] / (p["exciter.mount.m"] + p["exciter.rotor.m"]))


LOAD = {"conveyor.trough.m": 0.02, "conveyor.spring.c": 0.01}
CRANK = [
    "conveyor.rotor.J",
    "conveyor.trough.d",
    "conveyor.phi",
    "conveyor.w",
    "motor.tau",
    "motor.T",
]
TORQUE_SPEED = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]


def draw(kind: str, rng: np.random.Generator) -> Record:
    """A machine of a kind: "droop" speed alone, "rod" speed and torque, "induction", "exciter"."""

    def about(value: float, most: float = 1.6) -> float:
        return value * most ** rng.uniform(-1.0, 1.0)

    angle = rng.uniform(-math.pi, math.pi)
    if kind == "exciter":
        p = {
            "motor.R": about(2.0), "motor.L": about(2e-3), "motor.k": about(0.2, 1.2),
            "exciter.rotor.J": about(0.02), "exciter.rotor.m": 0.5, "exciter.rotor.r": 0.05,
            "exciter.rotor.d": 0.005, "exciter.mount.m": about(19.5, 1.3),
            "exciter.mount.c": about(5e4), "exciter.mount.d": about(200.0),
        }  # fmt: skip
        w = mount_resonance(p) * rng.uniform(0.6, 1.6)
        p |= {"motor.v": p["motor.k"] * w + 1.0, "motor.i": 0.5, "exciter.phi": angle}
        p |= {"exciter.w": w, "exciter.x": 0.0, "exciter.v": 0.0}
        states = ["exciter.phi", "motor.i", "exciter.w", "exciter.x", "exciter.v"]
        return Record(
            p, EXCITER, ["motor.tau -> exciter.tau", "exciter.w -> motor.w"],
            ["motor.R", "exciter.rotor.J", "exciter.mount.c", "exciter.mount.d", "motor.v", *states],
            {"exciter.mount.m": 0.01, "motor.k": 0.01}, ["exciter.phi", "motor.v"], mount_resonance,
            {"exciter.w": (2, 0.1, 0.3), "exciter.v": (4, 0.05, 0.0)}, {}, exciter_rates, states,
        )  # fmt: skip
    p = {
        "motor.T": about(0.05), "conveyor.rotor.J": about(0.49), "conveyor.trough.m": about(200.0, 1.3),
        "conveyor.spring.c": about(720e3, 1.2), "conveyor.trough.d": about(4000.0, 1.4),
    }  # fmt: skip
    fixed: dict[str, Value] = {"conveyor.crank.r": R}
    load = p["conveyor.trough.d"] * R * R / 2
    free, prior, first = [*CRANK], dict(LOAD), ["conveyor.phi"]
    if kind == "induction":
        p |= {"motor.kloss.tau_b": about(190.0, 1.3), "motor.kloss.s_b": about(0.16, 1.3)}
        p |= {"motor.kloss.w_s": about(55.0, 1.3)}
        free += ["motor.kloss.s_b", "motor.kloss.w_s"]
        prior |= {"motor.kloss.tau_b": 0.05}
        first += ["motor.kloss.w_s"]
        fixed |= {"motor.characteristic": 1}
        w = p["motor.kloss.w_s"] * 0.98
    else:
        p |= {"motor.B": about(120.0)}
        w = electromechanical_resonance(p) * rng.uniform(0.7, 1.35)
        p |= {"motor.A": (p["motor.B"] + load) * w}
        free += ["motor.B", "motor.A"]
        first += ["motor.A"]
    p |= {"conveyor.phi": angle, "conveyor.w": w * rng.uniform(0.95, 1.05), "motor.tau": load * w}
    columns = {"conveyor.w": (1, 0.05, rng.choice([0.0, 1.0, 2.0]))}
    rod = math.inf
    if kind == "rod":
        columns |= {"motor.tau": (2, 0.05, 0.5)}
        fixed |= {"conveyor.rod.finite": True, "conveyor.rod.l": ROD}
        rod = ROD
    rates, states = partial(conveyor_rates, rod=rod), ["conveyor.phi", "conveyor.w", "motor.tau"]
    return Record(
        p,
        CONVEYOR,
        TORQUE_SPEED,
        free,
        prior,
        first,
        electromechanical_resonance,
        columns,
        fixed,
        rates,
        states,
    )


KINDS = ("droop", "rod", "induction", "exciter")
LACKING = ("rod", "friction", "drift", "saturation")


def draw_lacking_effect(name: str, record: Record, rng: np.random.Generator) -> dict[str, float]:
    """Something that a machine has and the model has not, of random size."""
    if name == "rod":
        return {"rod": rng.uniform(3.0, 20.0) * R}
    if name == "friction":
        return {"friction": rng.uniform(100.0, 1000.0)}
    if name == "drift":
        return {"drift": rng.choice([-1.0, 1.0]) * rng.uniform(0.002, 0.05)}
    p = record.machine
    run = solve_ivp(
        partial(record.rates, p), (0.0, STOP), [p[x] for x in record.states], max_step=2e-3
    )
    torque = [abs(static(p, w)) for w in run.y[1]]
    return {"most": rng.uniform(0.5, 0.95) * max(torque)}


def make_record(record: Record, rng: np.random.Generator, **error: float) -> dict[str, Series]:
    """What a logger keeps of a machine."""
    p, t = record.machine, np.arange(round(STOP * RATE) + 1) / RATE
    start = [p[name] for name in record.states]
    run = solve_ivp(
        partial(record.rates, p, **error),
        (0.0, t[-1]),
        start,
        "DOP853",
        t,
        rtol=RELATIVE_TOLERANCE,
        atol=ABSOLUTE_TOLERANCE,
    )
    data = {}
    for name, (state, noise, grid) in record.columns.items():
        x = run.y[state]
        sigma = noise * float(np.std(x))
        noisy = x + sigma * rng.standard_normal(len(x))
        if grid:
            noisy = np.round(noisy / (grid * sigma)) * grid * sigma
        data[name] = Series.of({"t": t, "y": noisy})
    return data


def fit_record(record: Record, data: Mapping[str, Series], rng: np.random.Generator) -> Identified:
    """The machine from its record, and from guesses."""
    p, w = record.machine, next(iter(data))
    guess = {name: x * (1.0 + GUESS_ERROR * rng.uniform(-1.0, 1.0)) for name, x in p.items()}
    prior = {
        name: (p[name] * (1 + s * rng.standard_normal()), s * p[name])
        for name, s in record.prior.items()
    }
    guess |= {name: p[name] for name in p if name not in record.free}
    guess |= {name: mean for name, (mean, _) in prior.items()}
    mean = float(np.mean(data[w].numbers()))
    for name in data:
        guess[name] = float(np.mean(data[name].numbers()[:5]))
    for name in record.states:
        if name.endswith(".phi"):
            guess[name] = 0.0
    if "motor.A" in p:
        guess["motor.A"] = (guess["motor.B"] + guess["conveyor.trough.d"] * R * R / 2) * mean
    if "motor.kloss.w_s" in p:
        guess["motor.kloss.w_s"] = mean * 1.02
    if "motor.v" in p:
        guess["motor.v"] = guess["motor.k"] * mean + 0.5 * guess["motor.R"]
    system = System(record.parts, record.wires, guess | dict(record.fixed))
    return identify(
        system, data, free=record.free, prior=prior, first=record.first,
        derived={"resonance": lambda values, _: record.resonance(values)}, units={"resonance": "rad/s"},
    )  # fmt: skip


def trial(kind: str, seed: int, *, lacking: str = "") -> Trial:
    """One machine, recorded and identified."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    record = draw(kind, rng)
    effect = draw_lacking_effect(lacking, record, rng) if lacking else {}
    data = make_record(record, rng, **effect)
    began = time.process_time()
    fit = fit_record(record, data, rng)
    seconds = time.process_time() - began
    truth = record.resonance(record.machine)
    if lacking:
        local = fit.linearisation
        half_width = local.half_width(local.gradients[0])
        resonance = Stated.of(float(local.derived[0]), float(half_width), truth)
    elif fit.misfit:
        resonance = Stated.of(None, None, truth)
    else:
        interval = fit.derived["resonance"]
        resonance = Stated(interval.value, interval.low, interval.high, truth)
    name = f"lacks {lacking}" if lacking else kind
    return Trial(name, seed, {"resonance": resonance}, seconds, "; ".join(fit.misfit))


STUDY = Study(
    __doc__,
    {kind: partial(trial, kind) for kind in KINDS}
    | {f"lacks {name}": partial(trial, "droop", lacking=name) for name in LACKING},
    number=50,
    # 95 % intervals: of 50, 44 hold the truth with a probability of 98.8 %
    demands={kind: Demand(within=0.88) for kind in KINDS}
    | {f"lacks {name}": Demand(within=0.0) for name in LACKING},
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
