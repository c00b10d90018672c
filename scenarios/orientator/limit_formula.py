r"""How fast the rotor may turn, in formulas: the limits of a machine without a simulation.

All loads are linear in W = w^2, and friction mu F_2 has a potential while the cup slides down, so that
the energies of catcher and cup are linear in W up to the release: falling, landing, joint and hook
contact in closed form. In turning the cup is followed along a parabola phi1(phi2) that leaves the hook
contact with the true slope; the equation of motion across it is met in a weighted mean. After the
release the square of the cup's speed obeys a linear equation, solved by quadrature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

from cosim import System
from workbench.answer import parameters

Samples = NDArray[np.float64]
UP, TURNED, DOWN = 1.5 * math.pi, 2 * math.pi, 2.5 * math.pi
POINTS, SHARES = (z / 2 for z in np.polynomial.legendre.leggauss(24))
POINTS = POINTS + 0.5
FREE, HELD = (SHARES * np.sqrt(POINTS) * (1 - POINTS) ** power for power in (0.5, 1.0))


class TurningPath(NamedTuple):
    """A path of stage turning: what is left of its equation at the points, a + W b, of shape (2, 24);
    W at which the cup stops in the end.
    """

    left: Samples
    stops: float


class HookImpact(NamedTuple):
    """The contact with the hook: slope w1/w2 after it, kinetic energy before it, energy + W energy_per_W, and its
    share that is left after it.
    """

    slope: float
    energy: float
    energy_per_W: float
    share_left: float


@dataclass(frozen=True)
class OrientatorParameters:
    """The parameters of the FMU in SI units, index 1 the catcher's, index 2 the cup's."""

    d: float
    h: float
    l2: float
    m2: float
    J2: float
    l1: float
    h1: float
    m1: float
    J1: float
    phi10: float
    c: float
    R: float
    H: float
    mu: float
    g: float

    @classmethod
    def of(cls, system: System) -> OrientatorParameters:
        """The machine of a system with the part `orientator`."""
        names = (
            "cup.d", "cup.h", "cup.l", "cup.m", "cup.J", "catcher.l", "catcher.h", "catcher.m",
            "catcher.J", "catcher.phi", "spring.c", "chute.R", "chute.H", "chute.mu", "g",
        )  # fmt: skip
        parameter_values = parameters(system)
        return cls(*(float(parameter_values[f"orientator.{name}"].value) for name in names))

    @property
    def r(self) -> float:
        """Radius of the cup [m]."""
        return self.d / 2

    @property
    def e(self) -> float:
        """Distance of the cup's centre of mass from the end of its cylinder [m]."""
        return self.h - self.l2

    @property
    def bottom_from_pivot(self) -> float:
        """Distance L - r of the bottom's centre from the pivot while it slides on the wall [m]."""
        return self.l1 * math.cos(self.phi10) + self.r

    @property
    def angle_on_hook(self) -> float:
        """Angle of the catcher at which the cup lies on the hook [rad]."""
        far = self.r + self.l1
        return math.atan2(self.h, far) + math.acos(self.bottom_from_pivot / math.hypot(self.h, far))

    @property
    def centrifugal(self) -> tuple[float, float]:
        """Centrifugal forces F_1 and F_2 over W [kg.m]."""
        arm = self.R - self.d - self.l1 / 2 * math.cos(self.phi10)
        return self.m1 * arm, self.m2 * (self.R - self.r)

    @property
    def begin_of_turning(self) -> tuple[float, float, float]:
        """Angles of catcher and cup and height of its centre where turning begins."""
        phi1, phi2 = self.angle_on_hook, self.angle_on_hook + UP
        return phi1, phi2, float(self.hook_motion(phi1, phi2)["yc"])

    @property
    def sticking(self) -> float:
        """W at which friction holds the cup in the chute, g/(mu (R - r)) [rad2/s2]."""
        return self.g / (self.mu * (self.R - self.r)) if self.mu else math.inf

    def potential(self, phi1: Any, phi2: Any, yc: Any) -> tuple[Any, Any]:
        """Potential energy of weight, spring, centrifugal forces and friction: a + W b [J]."""
        half, (F_1, F_2) = self.l1 / 2, self.centrifugal
        turned = (phi1 - self.phi10) * np.sin(phi1) + np.cos(phi1) - math.cos(self.phi10)
        xc, slid = (
            self.bottom_from_pivot - self.e * np.cos(phi2),
            yc + self.e * np.sin(phi2) + self.r * phi2,
        )
        still = self.c * half * half * turned - self.m2 * self.g * yc
        return still, F_2 * (self.mu * slid - xc) - F_1 * half * np.cos(phi1)

    def joint_motion(self, phi1: float) -> tuple[float, float, float, float]:
        """Stage joint: derivatives of phi2, xc, yc by phi1, and the inertia at phi1."""
        c1, s1, r, h = math.cos(phi1), math.sin(phi1), self.r, self.h
        phi2 = (
            TURNED
            - math.atan2(r, h)
            - math.acos((self.bottom_from_pivot - self.l1 * c1) / math.hypot(h, r))
        )
        c2, s2 = math.cos(phi2), math.sin(phi2)
        u = -self.l1 * s1 / (h * s2 + r * c2)
        x, y = self.e * s2 * u, self.l1 * c1 + (self.l2 * c2 - r * s2) * u
        return u, x, y, self.J1 + self.m2 * (x * x + y * y) + self.J2 * u * u

    def hook_motion(self, phi1: Any, phi2: Any) -> dict[str, Any]:
        """Stage turning: the tip's place x1 on the cup, height, masses, derivatives of the centre."""
        c1, s1, s2, T, S = np.cos(phi1), np.sin(phi1), np.sin(phi2), np.tan(phi2), 1 / np.cos(phi2)
        x, y, r, e = self.l1 * c1 + self.h1 * s1, self.l1 * s1 - self.h1 * c1, self.r, self.e
        G = self.bottom_from_pivot - x
        z1, z2, x2 = x + y * T, G * S * S + r * S * T - e / S, e * s2
        M11, M22 = self.J1 + self.m2 * z1 * z1, self.J2 + self.m2 * (x2 * x2 + z2 * z2)
        Y22 = 2 * G * S * S * T + r * S * (T * T + S * S) + e * s2
        return {
            "x1": (G + r * s2) * S, "yc": y + G * T + r * S - e * s2, "z1": z1, "z2": z2, "x2": x2,
            "M11": M11, "M12": self.m2 * z1 * z2, "M22": M22,
            "Y11": x * T - y, "Y12": y * S * S, "Y22": Y22,
        }  # fmt: skip

    @cached_property
    def hook_impact(self) -> HookImpact:
        """The impact of the contact with the hook."""
        *_, y, J = self.joint_motion(self.phi10)
        landed = (self.m2 * y) ** 2 * self.H / J
        high = self.potential(self.phi10, UP, self.l1 * math.sin(self.phi10) - self.l2)
        phi1, phi2, _ = self.begin_of_turning
        k, low = self.hook_motion(phi1, phi2), self.potential(*self.begin_of_turning)
        a = landed * self.g + high[0] - low[0]
        b = -landed * self.mu * (self.R - self.r) + high[1] - low[1]
        u, x, y, J = self.joint_motion(phi1)
        momenta = (
            self.J1 + self.m2 * k["z1"] * y,
            self.J2 * u + self.m2 * (k["x2"] * x + k["z2"] * y),
        )
        mass = np.array([[k["M11"], k["M12"]], [k["M12"], k["M22"]]])
        speeds = np.linalg.solve(mass, momenta)
        share = float(speeds @ mass @ speeds / J)
        return HookImpact(float(speeds[0] / speeds[1]), float(a), float(b), share)

    @property
    def joint_limit(self) -> float:
        """W above which the cup cannot reach the hook: a bound of every limit, closed [rad2/s2]."""
        return -self.hook_impact.energy / self.hook_impact.energy_per_W

    def needed_speed_squared(self, phi2: float) -> float:
        """Square of the cup's speed at its release at phi2 that takes it to the end, over W."""
        phi = np.linspace(phi2, DOWN, 801)
        c2, s2, me = np.cos(phi), np.sin(phi), self.m2 * self.e
        q = self.e * s2 - self.mu * (self.e * c2 + self.r)
        rate = 2 * q / (self.J2 + q * me * s2)
        grown = np.exp(cumulative_trapezoid(rate * me * c2, phi, initial=0))
        got = cumulative_trapezoid(grown * rate * self.centrifugal[1], phi, initial=0)
        return float(-got.min())

    def turning_path(self, slope: float, bend: float) -> TurningPath | None:
        """The parabola with this slope and second derivative, to where the tip leaves the cup; None
        where it stays.
        """
        impact = self.hook_impact
        start, first = self.angle_on_hook, self.angle_on_hook + UP

        def at(x: Any) -> tuple[Any, Any, dict[str, Any]]:
            phi1, phi2 = start + slope * x + bend * x * x / 2, first + x
            return phi1, phi2, self.hook_motion(phi1, phi2)

        tried = np.linspace(1e-6, DOWN - 0.1 - first, 120)
        over = np.flatnonzero(at(tried)[2]["x1"] > self.h)
        if not len(over) or over[0] == 0:
            return None
        end = float(brentq(lambda x: at(x)[2]["x1"] - self.h, *tried[over[0] - 1 : over[0] + 1]))

        x = np.append(POINTS, 1.0)
        phi1, phi2, k = at(end * x)
        p, c2, m, half = slope + bend * end * x, np.cos(phi2), self.m2, self.l1 / 2
        F_1, F_2 = self.centrifugal
        gained = impact.share_left * np.array(
            [impact.energy, impact.energy_per_W]
        ) + self.potential(*self.begin_of_turning)
        mass = (k["M11"] * p + 2 * k["M12"]) * p + k["M22"]
        square = 2 * (gained[:, None] - self.potential(phi1, phi2, k["yc"])) / mass

        def across(Q_1: Any, Q_2: Any) -> Any:
            det = k["M11"] * k["M22"] - k["M12"] ** 2
            return (Q_1 * (k["M22"] + p * k["M12"]) - Q_2 * (k["M12"] + p * k["M11"])) / det

        spring = self.c * half * half * (phi1 - self.phi10) * np.cos(phi1)
        on_catcher = (
            m * self.g * k["z1"] - spring,
            -half * F_1 * np.sin(phi1) - self.mu * F_2 * k["z1"],
        )
        rubs = self.mu * (k["z2"] + self.e * c2 + self.r)
        on_cup = m * self.g * k["z2"], F_2 * (k["x2"] - rubs)
        ay = (k["Y11"] * p + 2 * k["Y12"]) * p + k["Y22"]
        bent = across(-m * k["z1"] * ay, -m * (k["z2"] * ay + k["x2"] * self.e * c2)) - bend
        left = (across(np.array(on_catcher), np.array(on_cup)) + bent * square)[:, :-1]
        released = square[:, -1]
        stops = released[0] / (self.needed_speed_squared(float(phi2[-1])) - released[1])
        return TurningPath(left, float(stops))

    def limit(self) -> tuple[float, int]:
        """W above which a product jams first, and the reason; nan where the formula finds none.

        Either catcher and tip come back together, along a straight path between known ends; or the cup
        stops in the end, after a parabola with the slope after the hook contact and a free end.
        """
        angles = np.linspace(self.angle_on_hook + UP, DOWN - 0.1, 200)
        on = np.flatnonzero(self.hook_motion(self.phi10, angles)["x1"] > self.h)
        if not len(on):
            return math.nan, 0
        distance = float(angles[on[0]]) - self.angle_on_hook - UP
        straight = (self.phi10 - self.angle_on_hook) / distance
        if back := self.turning_path(straight, 0.0):
            still, turns = back.left @ HELD
            if back.stops >= -still / turns > 0.0:
                return float(-still / turns), 6
        slope = self.hook_impact.slope

        def left(bend: float) -> float:
            path = self.turning_path(slope, bend)
            return float(np.array([1.0, path.stops]) @ path.left @ FREE) if path else math.nan

        bends = np.linspace(3 * (straight - slope) / distance, 0.05, 30)
        values = np.array([left(bend) for bend in bends])
        change = np.flatnonzero(values[:-1] * values[1:] <= 0.0)
        if not len(change):
            return math.nan, 0
        last = self.turning_path(slope, float(brentq(left, *bends[change[0] : change[0] + 2])))
        return last.stops if last else math.nan, 7


def rpm_of_squared(W: float) -> float:
    """Speed of a rotor whose square is W [rpm]; nan where none has it."""
    return 30 / math.pi * math.sqrt(W) if W >= 0.0 else math.nan
