"""Independent references of the iron drive: numbers, material points, energies, one system."""

from __future__ import annotations

from collections import namedtuple
from math import pi
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np
from mpmath import mpf

from components.drive_motor import model as drive_motor
from components.iron_drive import model as iron
from fmukit.declare.model import DEFAULTS
from fmukit.declare.record import real, record, start
from fmukit.runtime import hybrid as motion

TABLES = """
deg R alpha beta H H_1 H_2
10 0.10005456 1.6764628372 3.0282948416 0.4633791856 -0.0036620472154 -0.055949627621
50 0.11 1.5640615881 3.040914367 0.43230698238 -0.078171240912 0.00060766865937
80 0.11933312 1.4601146279 3.043733398 0.40323883345 -0.020442425319 0.13179741232
130 0.12 1.452704782 3.0436545869 0.40116436336 0 0
182 0.11808090662 1.4740296777 3.0437866501 0.40713494835 0.049455936769 0.24001768971
200 0.11 1.5640615881 3.040914367 0.43230698238 0.09771405114 0.00094948228027
235 0.10000916094 1.6769829946 3.0282098613 0.46352134252 0.0012631969216 -0.040530198949
300 0.1 1.6770879656 3.0281926798 0.46355002835 0 0

deg J J_1 A_1 B_1 C_load tau_cam
10 0.40137370681 0.0022521755998 0.40137848098 0.0011990287033 -0.41120524527 0.43224335899
50 0.43477011666 -0.00068471685293 0.43694554113 -0.00035926921435 -6.5293865609 6.5230828364
80 0.40358716793 -0.029491505339 0.40373593775 -0.015704908788 -1.7985105663 1.5229528118
130 0.4013 0 0.4013 0 0.18888720684 -0.18888720684
182 0.41468639904 0.12993317178 0.41395556721 0.061419740343 3.9927012092 -2.9150326944
200 0.45359705728 0.0013373376034 0.45074410418 0.00064094680698 7.0788979735 -7.0676519443
235 0.40130877025 -0.00056279261468 0.40130829347 -0.00026609845772 0.082335482047 -0.087004435841
300 0.4013 0 0.4013 0 -0.17684577768 0.17684577768

deg W T_iron T_span M_rocker N pressure
10 67.940112046 74.035866524 78.215170687 -21.797531923 249.00775848 -13.433658413
50 73.292364015 79.814851306 83.053555287 -23.193347343 259.37431452 6.5061626361
80 72.805406941 79.16946253 80.618168192 -21.966902036 244.35348194 2.7273862455
130 82.677798249 82.677798249 85.710303812 -23.850518022 265.0057558 0
182 64.041256373 59.046807443 59.198604844 -15.609721086 175.54329088 -8.8754532658
200 73.268374218 67.794393685 71.02883115 -19.837181742 237.86172742 -22.082431352
235 66.815270045 61.859726442 65.841727404 -18.361356446 210.60659197 -14.372546059
300 63.96209875 63.96209875 67.422860381 -18.654533108 213.75728078 -14.149004509

deg lift v a F_spring E_kin E_pot
10 0.00017084275597 0.015339547505 0.98169011735 24.051252827 3.5212441807 -4.0293631824
50 0.031243045978 0.32744292823 -0.010662132044 33.372913793 3.8142302727 -1.7176015867
80 0.060311194904 0.085629030938 -2.31251257 42.093358471 3.5406628345 0.61158725358
130 0.062385664995 0 0 42.715699499 3.5205975521 0.66191659851
182 0.05641508 -0.20716054351 -4.2113415941 40.924524 3.6380361858 -0.011085542407
200 0.031243045978 -0.40930366028 -0.016659581319 33.372913793 3.979398678 -2.0722219595
235 2.8685830689e-05 -0.005291266892 0.71114138653 24.008605749 3.5206744934 -4.3723646207
300 0 0 0 24 3.5205975521 -4.2630173489
"""


def tables() -> dict[float, dict[str, float]]:
    """The reference rows at the nominal speed by cam angle in degrees."""
    rows: dict[float, dict[str, float]] = {}
    for table in TABLES.strip().split("\n\n"):
        head, *lines = (line.split() for line in table.splitlines())
        for line in lines:
            rows.setdefault(float(line[0]), {}).update(zip(head[1:], map(float, line[1:])))
    return rows


def jet(f: Any, x: Any) -> tuple[Any, Any, Any]:
    """A vector-valued function with two derivatives, by central differences of order 8."""
    h = mpf("1e-3")
    values = {k: np.array(f(x + k * h), dtype=object) for k in range(-4, 5)}
    odd = [(k, values[k] - values[-k]) for k in range(1, 5)]
    even = [(k, values[k] + values[-k]) for k in range(1, 5)]
    first = zip((mpf(4) / 5, -mpf(1) / 5, mpf(4) / 105, -mpf(1) / 280), odd)
    second = zip((mpf(8) / 5, -mpf(1) / 5, mpf(8) / 315, -mpf(1) / 560), even)
    return (
        values[0],
        sum(c * d for c, (_, d) in first) / h,
        (sum(c * d for c, (_, d) in second) - mpf(205) / 72 * values[0]) / h**2,
    )


def by_material_points(p: Any, phi: float, w: float, eps: float, K: float) -> dict[str, Any]:
    """All that the equations say, from material points of rocker, link, chain and spring, in the complex plane."""
    c, r, z, s, g = p.cam, p.rocker, p.sprocket, p.spring, p.g
    exp, arg, re, im = mpmath.expj, mpmath.arg, mpmath.re, mpmath.im

    def alpha(phi: Any) -> list[Any]:
        f = phi % (2 * mpmath.pi)
        x, back = f / c.rise, (f - c.rise - c.top) / c.ret
        share = min(max(x, 0), 1) if back < 0 else 1 - min(back, 1)
        R = c.R_b + c.h * mpmath.betainc(4, 4, 0, share, regularized=True)
        return [r.alpha0 - mpmath.acos((mpf(r.L) ** 2 + mpf(r.l) ** 2 - R**2) / (2 * r.L * r.l))]

    def path(alpha: Any) -> tuple[Any, ...]:
        end = r.l_K * exp(alpha)
        to = mpmath.mpc(-z.C, z.A) - end
        if p.wrap == iron.Wrap.top:
            to += mpmath.mpc(0, z.R)
            n, theta = abs(to), mpmath.pi / 2
            along = to / n
        else:
            n = mpmath.sqrt(abs(to) ** 2 - mpf(z.R) ** 2)
            along = to * mpmath.mpc(n, -z.R) / abs(to) ** 2
            theta = arg(along) % (2 * mpmath.pi) - mpmath.pi / 2
        return end, along, n, theta, p.chain.l + p.link.l - n - z.R * (mpmath.pi - theta)

    def dots(a: Any, b: Any) -> Any:
        return sum(re(x * mpmath.conj(y) * mass) for x, y, mass in zip(a, b, m))

    ((angle,), (a_1,), (a_2,)) = jet(alpha, mpf(phi))
    _, _, n, theta, H = path(angle)
    arc, total_length = z.R * (mpmath.pi - theta), p.chain.l + mpf(p.link.l)
    nodes = [((1 + mpf(x)) / 2, mpf(y) / 2) for x, y in zip(*np.polynomial.legendre.leggauss(10))]
    swing = mpmath.sqrt(mpf(p.link.J) / p.link.m)
    masses = [("run", mpf(p.link.l) / 2 + side * swing, mpf(p.link.m) / 2) for side in (-1, 1)]
    for kind, begin, end in (
        ("run", p.link.l, n), ("arc", n, n + arc), ("hang", n + arc, total_length),
    ):  # fmt: skip
        span = end - begin
        masses += [(kind, begin + span * x, p.chain.rho * span * y) for x, y in nodes]
    masses += [("hang", total_length, mpf(p.iron.m))]
    masses += [("spring", x, s.m * y) for x, y in nodes]
    m = np.array([mass for _, _, mass in masses])

    def coordinates(alpha: Any) -> list[Any]:
        end, along, n, theta, H = path(alpha)
        arc = z.R * (mpmath.pi - theta)
        where = {
            "run": lambda q: end + q * along,
            "arc": lambda q: mpmath.mpc(-z.C, z.A) + z.R * exp(theta + (q - n) / z.R),
            "hang": lambda q: mpmath.mpc(-z.C - z.R, z.A - (q - n - arc)),
            "spring": lambda q: mpmath.mpc(0, -H * q),
        }
        return [*(where[kind](q) for kind, q, _ in masses), H, arg(along)]

    (*_, beta), (*ra, H_a, _), (*raa, H_aa, _) = jet(coordinates, angle)
    ra, raa = np.array(ra), np.array(raa)
    H_1, H_2 = H_a * a_1, H_aa * a_1**2 + H_a * a_2
    H_b = path(alpha(mpf(-pi / 3))[0])[-1]
    e = s.e_0 + s.side * (H_b - H)
    J_a = r.J + dots(ra, ra) + z.J / mpf(z.R) ** 2 * H_a**2
    J_aa = 2 * dots(ra, raa) + 2 * z.J / mpf(z.R) ** 2 * H_a * H_aa
    weight = r.m * g * r.r * mpmath.cos(angle + r.gamma) + dots(ra, [mpmath.mpc(0, g)] * len(m))
    Pi_a = weight - s.side * s.c * e * H_a

    angular, H_tt = a_1 * eps + a_2 * w**2, H_1 * eps + H_2 * w**2
    pull = raa * (a_1 * w) ** 2 + ra * angular + mpmath.mpc(0, g)
    sort = np.array([kind for kind, _, _ in masses])
    W = (p.iron.m + mpf(s.m) / 2) * g + s.side * s.c * e - p.iron.m * H_tt
    at_iron = sum(k * (g - H_tt * q) * q for kind, q, k in masses if kind == "spring")
    T_iron = p.iron.m * (g - H_tt) + s.side * s.c * e + at_iron + K * W
    T_hang = T_iron + sum(im(a) * k for a, k in zip(pull[sort == "hang"][:-1], m[sort == "hang"]))
    on_arc = np.where(sort == "arc", m, 0) / H_a
    T_span = T_hang - sum(re(a * mpmath.conj(x)) * k for x, a, k in zip(ra, pull, on_arc))
    T_span -= z.J / mpf(z.R) ** 2 * H_tt
    M_rocker = r.J * angular + dots(pull, ra) + z.J / mpf(z.R) ** 2 * H_tt * H_a - K * W * H_a
    M_rocker += r.m * g * r.r * mpmath.cos(angle + r.gamma) - s.side * s.c * e * H_a
    cam_weight = c.m * g * c.r * mpmath.cos(mpf(phi) + c.gamma)
    M_less = p.cam.J * eps + cam_weight + a_1 * M_rocker
    psi = r.alpha0 - angle
    roller = r.l * exp(-psi)
    slip = 1j * a_1 * roller - 1j * (roller - r.L)
    normal = 1j * slip / abs(slip)
    N = abs(M_rocker / im(mpmath.conj(roller) * normal)) * (1 if M_rocker < 0 else -1)
    tilt = mpmath.acos(abs(re(normal * mpmath.conj(1j * roller))) / r.l)
    return {
        "alpha": angle, "alpha_1": a_1, "alpha_2": a_2, "beta": beta % (2 * mpmath.pi), "n": n,
        "H": H, "H_1": H_1, "H_2": H_2, "lift": H_b - H, "W": W, "T_iron": T_iron, "T_hang": T_hang,
        "J": p.reducer.J * p.reducer.i_g**2 + c.J + J_a * a_1**2, "T_span": T_span, "N": N,
        "J_1": J_aa * a_1**3 + 2 * J_a * a_1 * a_2, "Pi_1": cam_weight + Pi_a * a_1,
        "M_rocker": M_rocker, "tau_cam": M_less, "tilt": tilt,
    }  # fmt: skip


class State(namedtuple("State", [*iron.State._fields, "tau", "E_in"])):  # type: ignore[attr-defined,misc]
    """Drive and motor as one system: the drive's State, the motor's torque and work."""

    _declared = iron.State._declared | {  # type: ignore[attr-defined]
        "tau": real(0.0, "Motor torque")._replace(quantity=None),
        "E_in": real(0.0, "Work of the motor")._replace(quantity=None),
    }


@record
class Nothing:
    """No inputs."""


class CoupledDrive:
    """Drive and motor integrated together, events by the drive's own guard and jump."""

    def __init__(self, p: Any, motor: dict[str, float], **state: float) -> None:
        q, i_g = start(drive_motor.Parameters, **motor), p.reducer.i_g

        def parts(x: Any) -> tuple[Any, Any]:
            return iron.State._make(x[:-2]), iron.Inputs(x.tau)

        def derivatives(_: Any, t: float, x: Any, u: Any) -> Any:
            w = i_g * x.w_cam
            turn = drive_motor.derivatives(q, t, drive_motor.State(x.tau), drive_motor.Inputs(w))
            return State(*iron.derivatives(p, t, *parts(x)), turn.tau, x.tau * w)

        def event_update(_: Any, t: float, x: Any, u: Any, which: int) -> Any:
            return x._replace(**iron.event_update(p, t, *parts(x), which)._asdict())

        functions = {
            "State": State,
            "derivatives": derivatives,
            "event_indicators": lambda _, t, x, u: iron.event_indicators(p, t, *parts(x)),
            "event_update": event_update,
            "LONGEST_STEP": iron.LONGEST_STEP,
        }
        self.model: Any = SimpleNamespace(**DEFAULTS | functions)
        x = start(State, **state)
        first, u = parts(x)
        self.t, self.x = 0.0, x._replace(**iron.sample(p, 0.0, first, None, u)._asdict())

    def to(self, t: float) -> Any:
        """The state at the time t."""
        still = motion.InputTrajectory(Nothing(), Nothing(), t - self.t)
        self.x = motion.advance(self.model, None, self.t, self.x, still)
        self.t = t
        return self.x

    def until(self, phi: float) -> Any:
        """The state where the cam reaches phi."""
        while self.x.phi < phi - 0.1:
            self.to(self.t + 0.01)
        t, x = self.t, self.x
        for _ in range(5):
            end = self.t + (phi - self.x.phi) / self.x.w_cam
            self.t, self.x = t, x
            self.to(end)
        return self.x

    def events(self, stop: float) -> list[tuple[float, Any]]:
        """Times and states of the events up to `stop`."""
        still = motion.InputTrajectory(Nothing(), Nothing(), stop - self.t)
        return [
            (self.t + s, x) for s, _, x in motion.events(self.model, None, self.t, self.x, still)
        ]
