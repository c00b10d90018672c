"""Independent references of the iron drive: numbers, material points, and one system of cam, rocker and motor."""

from __future__ import annotations

from functools import cache
from itertools import accumulate
from math import cos, hypot, pi, sin
from typing import Any, NamedTuple

import mpmath
import numpy as np
import sympy as sp
from mpmath import mpf
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from components.iron_drive import model as iron
from tests.oracle import by_name


def jet(f: Any, x: Any) -> Any:
    """A vector-valued function with two derivatives, by central differences of order 8."""
    h = mpf("1e-3")
    values = np.array([f(x + k * h) for k in range(-4, 5)], dtype=object)
    first = np.array([mpf(c) / 840 for c in (3, -32, 168, -672, 0, 672, -168, 32, -3)])
    second = [mpf(c) / 5040 for c in (-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9)]
    return values[4], first @ values / h, np.array(second) @ values / h**2


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
    J = p.reducer.J * p.reducer.i_g**2 + c.J + J_a * a_1**2
    return {
        "E_kin": J * w**2 / 2, "v": -H_1 * w, "a": -H_tt, "w": p.reducer.i_g * w,
        "alpha": angle, "alpha_1": a_1, "alpha_2": a_2, "beta": beta % (2 * mpmath.pi), "n": n,
        "H": H, "H_1": H_1, "H_2": H_2, "lift": H_b - H, "W": W, "T_iron": T_iron, "T_hang": T_hang,
        "J": J, "T_span": T_span, "N": N,
        "J_1": J_aa * a_1**3 + 2 * J_a * a_1 * a_2, "Pi_1": cam_weight + Pi_a * a_1,
        "M_rocker": M_rocker, "tau_cam": M_less, "tilt": tilt,
    }  # fmt: skip


DIMENSIONS = (
    "cam.R_b", "cam.h", "cam.rise", "rocker.L", "rocker.l", "rocker.l_K", "rocker.alpha0", "link.l",
    "chain.l", "sprocket.A", "sprocket.C", "sprocket.R",
)  # fmt: skip
SYMBOL = {name: sp.Symbol(name.replace(".", "_"), positive=True) for name in DIMENSIONS}
ROUNDING = 1e-14
TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}


class Geometry(NamedTuple):
    """Formulas (1) to (10) of the paper, its signs mended: alpha of phi on the rise, the rest of alpha."""

    phi: Any
    alpha: Any
    of_phi: Any
    n: Any
    beta: Any
    H: Any


@cache
def geometry(wrap: int) -> Geometry:
    R_b, h, rise, L, l, l_K, alpha0, l_T, l_c, A, C, R_z = (SYMBOL[name] for name in DIMENSIONS)
    phi, alpha = sp.symbols("phi alpha", real=True)
    x = phi / rise
    R = R_b + h * (35 * x**4 - 84 * x**5 + 70 * x**6 - 20 * x**7)
    of_phi = alpha0 - sp.acos((L**2 + l**2 - R**2) / (2 * L * l))
    X, Y = C + l_K * sp.cos(alpha), A - l_K * sp.sin(alpha)
    if wrap == iron.Wrap.top:
        n = sp.sqrt(X**2 + (Y + R_z) ** 2)
        beta, arc = sp.pi - sp.atan((Y + R_z) / X), sp.pi * R_z / 2
    else:
        d = sp.sqrt(X**2 + Y**2)
        n = sp.sqrt(d**2 - R_z**2)
        beta = sp.pi - sp.atan(Y / X) - sp.asin(R_z / d)
        arc = R_z * (3 * sp.pi / 2 - beta)
    return Geometry(phi, alpha, of_phi, n, beta, l_c - (n - l_T) - arc)


@cache
def transfer(wrap: int) -> Any:
    """alpha', alpha'', beta', beta'', H', H'' on the rise, as formulas (2) to (11) chain them, as a
    function of phi and the dimensions, in mpmath's numbers.
    """
    g = geometry(wrap)
    a_1, a_2 = (sp.diff(g.of_phi, g.phi, k) for k in (1, 2))
    solution = [a_1, a_2]
    for f in (g.beta, g.H):
        f_1, f_2 = (sp.diff(f, g.alpha, k) for k in (1, 2))
        solution += [f_1 * a_1, f_2 * a_1**2 + f_1 * a_2]
    arguments = [g.phi, *SYMBOL.values()]
    angle = sp.lambdify(arguments, g.of_phi, "mpmath")
    rest = sp.lambdify([g.alpha, *arguments], solution, "mpmath", cse=True)
    return lambda *values: rest(angle(*values), *values)


class Reference:
    """Cam, rocker and motor: two coordinates, phi and alpha, and a force between them that pushes."""

    def __init__(self, p: Any, tau: float, motor: dict[str, float] | None = None) -> None:
        self.p, self.q, self.motor = p, by_name(p), motor
        self.tau = tau
        g, q = geometry(p.wrap), self.q
        values = {SYMBOL[name]: q[name] for name in DIMENSIONS}
        rho, m_T, l_T, l_K, R_z = (
            q[x] for x in ("chain.rho", "link.m", "link.l", "rocker.l_K", "sprocket.R")
        )
        beta, n, H, a = (f.subs(values) for f in (g.beta, g.n, g.H, g.alpha))
        b_1, H_1 = sp.diff(beta, a), sp.diff(H, a)
        across = sp.cos(beta - a)
        arc = q["chain.l"] - (n - l_T) - H
        m_e = q["sprocket.J"] / R_z**2 + rho * (arc + H) + q["iron.m"] + q["spring.m"] / 3
        J = q["rocker.J"] + m_T * (l_K**2 + l_T**2 * b_1**2 / 4 + l_K * l_T * b_1 * across)
        J += q["link.J"] * b_1**2 + rho * l_K**2 * (n - l_T) + rho * b_1**2 * (n**3 - l_T**3) / 3
        J += rho * l_K * b_1 * across * (n**2 - l_T**2) + m_e * H_1**2
        s, theta = sp.Symbol("s"), sp.Symbol("theta")
        height = l_K * sp.sin(a) + s * sp.sin(beta)
        around = q["sprocket.A"] + R_z * sp.sin(theta)
        Pi = sp.integrate(rho * height, (s, l_T, n)) + m_T * height.subs(s, l_T / 2)
        Pi += sp.integrate(rho * R_z * around, (theta, sp.pi - arc / R_z, sp.pi))
        Pi += rho * H * (q["sprocket.A"] - H / 2) - (q["iron.m"] + q["spring.m"] / 2) * H
        Pi += q["rocker.m"] * q["rocker.r"] * sp.sin(a + q["rocker.gamma"])
        self.H_b = float(H.subs(a, g.of_phi.subs(values).subs(g.phi, 0)))
        e = q["spring.e_0"] + q["spring.side"] * (self.H_b - H)
        Pi = q["g"] * Pi + q["spring.c"] / 2 * e**2
        drag = q["joints.rocker"] + q["joints.link"] * (b_1 - 1) ** 2
        drag += q["joints.sprocket"] * (H_1 / R_z) ** 2
        W_0 = (q["iron.m"] + q["spring.m"] / 2) * q["g"] + q["spring.side"] * q["spring.c"] * e
        sides = [J, sp.diff(J, a), sp.diff(Pi, a), H_1, sp.diff(H_1, a), W_0, drag, Pi]
        self.side = sp.lambdify(a, sides, "math", cse=True)
        up = [sp.diff(g.of_phi.subs(values), g.phi, k) for k in (0, 1, 2)]
        self.rise = sp.lambdify(g.phi, up, "math", cse=True)
        self.J_c = q["cam.J"] + q["reducer.J"] * q["reducer.i_g"] ** 2
        self.ends = [*accumulate(q[f"cam.{x}"] for x in ("rise", "top", "ret"))]

    def cam(self, phi: float, cell: int) -> tuple[float, float, float]:
        """alpha, alpha', alpha'' where the follower is on the cam in this cell of a turn."""
        f = phi % (2 * pi)
        if cell == 0:
            return tuple(self.rise(f))
        if cell == 2:
            scale = self.q["cam.rise"] / self.q["cam.ret"]
            value, first, second = self.rise((self.ends[2] - f) * scale)
            return value, -first * scale, second * scale * scale
        return self.rise(self.q["cam.rise"] if cell == 1 else 0.0)[0], 0.0, 0.0

    def friction(self, v: float) -> float:
        q = self.q
        return q["friction.K_down"] if v > 0 else q["friction.K_up"] if v < 0 else 0.0

    def forces(self, y: Any, cell: int, flying: bool) -> tuple[float, float, float, float]:
        """Accelerations of cam and rocker, torque between them, power lost to the guide."""
        phi, w, alpha, v, tau, *_ = y
        q, (_, a_1, a_2) = self.q, self.cam(phi, cell)
        J, J_1, Pi_1, H_1, H_2, W_0, drag, _ = self.side(alpha)
        K, m = self.friction(v), q["iron.m"]
        A = J + K * m * H_1 * H_1
        Q = K * H_1 * (W_0 - m * H_2 * v * v) - J_1 * v * v / 2 - Pi_1 - drag * v
        weight = q["cam.m"] * q["g"] * q["cam.r"] * cos(phi + q["cam.gamma"])
        M = q["reducer.i_g"] * tau - weight - q["joints.cam"] * w
        push = 0.0 if flying else Q - A * (a_2 * w * w + a_1 * (M + a_1 * (Q - A * a_2 * w * w)) / (
            self.J_c + A * a_1 * a_1
        ))  # fmt: skip
        turn = (Q - push) / A
        W = W_0 - m * (H_1 * turn + H_2 * v * v)
        return (M + a_1 * push) / self.J_c, turn, push, -K * W * H_1 * v

    def slope(self, y: Any, cell: int, flying: bool) -> list[float]:
        """Of phi, w, alpha, v, tau, friction's energy, work of the motor, time in flight."""
        eps, turn, _, loss = self.forces(y, cell, flying)
        i, tau = self.q["reducer.i_g"], y[4]
        motor = self.motor
        lag = 0.0 if motor is None else (motor["A"] - motor["B"] * i * y[1] - tau) / motor["T"]
        return [y[1], eps, y[3], turn, lag, loss, i * tau * y[1], float(flying)]

    def energy(self, y: Any) -> float:
        """Kinetic and potential, of all but a constant."""
        J, *_, Pi = self.side(y[2])
        q = self.q
        Pi += q["cam.m"] * q["g"] * q["cam.r"] * sin(y[0] + q["cam.gamma"])
        return float((self.J_c * y[1] ** 2 + J * y[3] ** 2) / 2 + Pi)

    def arm(self, phi: float, cell: int) -> float:
        """Lever of the contact's normal about the rocker's axis, from the path of the roller."""
        alpha, a_1, _ = self.cam(phi, cell)
        L, l, psi = self.q["rocker.L"], self.q["rocker.l"], self.q["rocker.alpha0"] - alpha
        roller = complex(l * cos(psi), -l * sin(psi))
        slip = 1j * a_1 * roller - 1j * (roller - L)
        normal = 1j * slip / hypot(slip.real, slip.imag)
        return abs((roller.conjugate() * normal).imag)

    def impact(self, y: Any, cell: int) -> tuple[Any, bool, float]:
        """The state after a landing, whether it leaves again, and its impulse over the arm."""
        _, a_1, _ = self.cam(y[0], cell)
        J, _, _, H_1, *_ = self.side(y[2])
        w, v, m = y[1], y[3], self.q["iron.m"]

        def after(P: float) -> tuple[float, float]:
            down, up = (J + self.friction(s) * m * H_1 * H_1 for s in (1.0, -1.0))
            stands = max(v, 0.0) * down
            end = v - P / down if stands >= P else min(v, 0.0) - (P - stands) / up
            return w + a_1 * P / self.J_c, end

        def parting(P: float) -> float:
            w, v = after(P)
            return a_1 * w - v

        meeting = brentq(parting, 0.0, 1e3, xtol=1e-14, rtol=1e-14)
        total_impulse, arm = (1 + self.q["follower.e"]) * meeting, self.arm(y[0], cell)
        leaves = parting(total_impulse) * arm >= self.q["follower.v"]
        P = total_impulse if leaves else meeting
        new = np.array(y)
        new[1], new[3] = after(P)
        stand = min(max(v, 0.0), v) if v > 0 else v
        K_down, K_up = self.friction(1.0), self.friction(-1.0)
        low = 0.0 if v > 0 > new[3] else new[3] if v > 0 else stand
        rubbed = K_up * (new[3] ** 2 - low**2) * (new[3] < 0) - K_down * (v * v - low**2) * (v > 0)
        new[5] += m * H_1 * H_1 * rubbed / 2
        return new, leaves, P / arm

    def run(self, phi: float, w: float, stop: float, times: Any = ()) -> dict[str, Any]:
        """The state at the end of a run from the cam, lift-offs and landings with their times, and rows at
        some times; it also ends where the cam stops while it carries the follower.
        """
        names = ("phi", "w_cam", "alpha", "v", "tau", "E_friction", "work", "t_flight")
        cell = sum(phi % (2 * pi) >= end for end in self.ends)
        alpha, a_1, _ = self.cam(phi, cell)
        t, flying, y = 0.0, False, np.array([phi, w, alpha, a_1 * w, self.tau, 0.0, 0.0, 0.0])
        lifted: list[float] = []
        landed: list[tuple[float, float, float, float]] = []
        rows: list[Any] = []
        energy_loss = 0.0
        while t < stop:
            first = 2 * pi * (y[0] // (2 * pi))
            edge = first + [*self.ends, 2 * pi][cell]

            def passed(t: float, y: Any, edge: float = edge) -> float:
                return float(edge - y[0])

            def touch(t: float, y: Any, cell: int = cell, flying: bool = flying) -> float:
                if flying:
                    return self.cam(y[0], cell)[0] - y[2] + ROUNDING
                return self.forces(y, cell, False)[2] if self.p.follower.lifts else 1.0

            def turns(t: float, y: Any, flying: bool = flying) -> float:
                return float(y[3] if flying else y[1])

            events = [passed, touch, turns]
            for event, sense in zip(events, (-1, -1, 0 if flying else -1)):
                event.terminal, event.direction = True, sense  # type: ignore[attr-defined]
            solution = solve_ivp(
                lambda t, y, c=cell, f=flying: self.slope(y, c, f), (t, stop), y, events=events,
                max_step=2e-3, dense_output=True, **TIGHT,
            )  # fmt: skip
            begin, t, y = t, float(solution.t[-1]), solution.y[:, -1]
            rows += [solution.sol(x) for x in times if begin <= x < t or x == t == stop]
            if solution.status != 1 or (len(solution.t_events[2]) and not flying):
                break
            if len(solution.t_events[0]):
                y[0] = edge
                cell = (cell + 1) % 4
                if cell == 0:
                    y[0] = first + 2 * pi
            elif len(solution.t_events[1]) and flying:
                before, rubbed = self.energy(y), y[5]
                speed = (y[3] - self.cam(y[0], cell)[1] * y[1]) * self.arm(y[0], cell)
                y[2] = self.cam(y[0], cell)[0]
                y, flying, impulse = self.impact(y, cell)
                loss = before - self.energy(y) - (y[5] - rubbed)
                energy_loss += loss
                landed.append((t, speed, impulse, loss))
            elif len(solution.t_events[1]):
                flying = True
                lifted.append(t)
            if not flying:
                y[2], a_1, _ = self.cam(y[0], cell)
                y[3] = a_1 * y[1]
            elif len(solution.t_events[2]):
                y[3] = np.copysign(ROUNDING, -solution.y[3, -2])
        return dict(zip(names, map(float, y))) | {
            "gap": self.cam(y[0], cell)[0] - y[2] if flying else 0.0, "E_landing": energy_loss,
            "lifted": lifted, "landed": landed, "t": t, "rows": dict(zip(names, np.array(rows).T)),
        }  # fmt: skip
