r"""Linear system of up to four states, inputs and outputs: a yardstick for co-simulation masters.

$$ \dot x = A\,x + B\,u, \qquad y = C\,x, \qquad z = C\,x + D\,u $$

A system coupled from linear parts has a closed solution. This part adds no error of its own.
For inputs that change linearly from $u_0$ to $u_1$ over a communication step $h$, which covers
every `input_hold`, its step ends where the equations end:

$$ x(h) = e^{Ah}x(0) + G_0u_0 + G_1u_1, \quad
   G_0 = h\,[\varphi_1(Ah) - \varphi_2(Ah)]\,B, \quad G_1 = h\,\varphi_2(Ah)\,B $$

$$ \varphi_1(M) = \sum_{k=0}^{\infty}\frac{M^k}{(k+1)!}, \quad
   \varphi_2(M) = \sum_{k=0}^{\infty}\frac{M^k}{(k+2)!} $$

Any difference from the closed solution of the whole system is due to the master. $A$ may be
singular or stiff. The three matrices are computed in decimal arithmetic, with as many more digits
than a Real as $\|A\|h$ can cost, and then rounded. The rounding error of $e^{Ah}$ is kept as a
second number, so that it does not accumulate over millions of short steps.

`y` does not depend directly on `u`, and `ModelStructure` says so: parts coupled through `y` form no
algebraic loop, and a master has no reason to look for one. `z` is declared to depend on all inputs,
because `D` may contain any number. A master that reads `ModelStructure` must treat parts coupled
through `z` in both directions as a possible algebraic loop, even where `D` is zero. Use `z` where
the part has feedthrough, `y` everywhere else.

All variables are dimensionless, since their meaning is up to the user; time is in seconds. The
defaults describe a damped oscillator, released at 1:

$$ \ddot x_1 = -\omega^2 x_1 - 2\,\zeta\,\omega\,\dot x_1 + u_1, \quad
   \omega = 10, \quad \zeta = 0.1, \quad y_1 = z_1 = x_1 $$

For your own system, set its non-zero entries, and set to zero the oscillator's entries that it
does not have: `A[1,2]`, `A[2,1]`, `A[2,2]`, `B[2,1]`, `C[1,1]`, `x[1]`. All other entries are zero.
A state with only zeros in every matrix keeps its value.
"""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Context, Decimal, localcontext
from functools import lru_cache
from itertools import count
from math import frexp, fsum
from operator import add, mul

from fmukit import Experiment, array, fill, record
from fmukit.si import Ratio

EXPERIMENT = Experiment(stop=5.0, step=0.01)
PYTHON_ONLY = "its matrix exponential needs decimal arithmetic, which C does not have"

Vector = tuple[Ratio, ...]
Matrix = tuple[Vector, ...]
DecimalMatrix = list[list[Decimal]]

INPUTS = ("u[1]", "u[2]", "u[3]", "u[4]")
HALF = Decimal("0.5")
ZERO = (0.0, 0.0, 0.0, 0.0)


@record
class Parameters:
    A: Matrix = array(
        [(0.0, 1.0, 0.0, 0.0), (-100.0, -2.0, 0.0, 0.0), ZERO, ZERO], "Rate of x[{0}] per x[{1}]"
    )
    B: Matrix = array([ZERO, (1.0, 0.0, 0.0, 0.0), ZERO, ZERO], "Rate of x[{0}] per u[{1}]")
    C: Matrix = array([(1.0, 0.0, 0.0, 0.0), ZERO, ZERO, ZERO], "y[{0}] and z[{0}] per x[{1}]")
    D: Matrix = array([ZERO, ZERO, ZERO, ZERO], "z[{0}] per u[{1}]")


@record
class Inputs:
    u: Vector = array(ZERO, "Input {0}")


@record
class State:
    x: Vector = array((1.0, 0.0, 0.0, 0.0), "State {0}")


@record
class Outputs:
    y: Vector = array(ZERO, "Output {0} without feedthrough, from C x")
    z: Vector = array(ZERO, "Output {0} with feedthrough, from C x + D u", feedthrough=INPUTS)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return fill(State, [fsum(map(mul, a + b, x.x + u.u)) for a, b in zip(p.A, p.B)])


def exact(p: Parameters, x: State, u0: Inputs, u1: Inputs, h: float) -> State:
    """Exact update for inputs that change linearly from u0 to u1."""
    operands = x.x + u0.u + u1.u + x.x
    return fill(State, [fsum(map(mul, row, operands)) for row in propagator(p.A, p.B, h)])


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    y = [fsum(map(mul, c, x.x)) for c in p.C]
    z = [fsum(map(mul, c + d, x.x + u.u)) for c, d in zip(p.C, p.D)]
    return fill(Outputs, y + z)


@lru_cache(maxsize=1024)
def propagator(A: Matrix, B: Matrix, h: float) -> Matrix:
    """Rows of exp(A h), G_0, G_1 and the rounding error of exp(A h), side by side.

    Raises OverflowError beyond 1e300.
    """
    doublings = max(0, frexp(max(sum(abs(a) * h for a in row) for row in A))[1] + 3)
    try:
        with localcontext(Context(prec=38 + 2 * doublings // 3, Emax=300)):
            hA, hB = scaled(A, Decimal(h)), scaled(B, Decimal(h))
            E, phi_1, phi_2 = exponentials(hA, doublings)
            G_1 = product(phi_2, hB)
            G_0 = added(product(phi_1, hB), scaled(G_1, -1))
            rounded = [[float(e) for e in row] for row in E]
            rest = added(E, scaled(rounded, -1))
            rows = zip(rounded, G_0, G_1, rest)
            return tuple(tuple(float(e) for part in row for e in part) for row in rows)
    except ArithmeticError:
        raise OverflowError(f"A h or exp(A h) is beyond 1e300 with h = {h!r} s") from None


def exponentials(
    M: DecimalMatrix, doublings: int
) -> tuple[DecimalMatrix, DecimalMatrix, DecimalMatrix]:
    """exp(M), phi_1(M) and phi_2(M): the series at M / 2^doublings, then doubled that often."""
    M = scaled(M, HALF**doublings)
    identity = [[Decimal(i == j) for j in range(len(M))] for i in range(len(M))]
    term = phi_2 = scaled(identity, HALF)
    for k in count(3):
        term = scaled(product(term, M), 1 / Decimal(k))
        before, phi_2 = phi_2, added(phi_2, term)
        if phi_2 == before:
            break
    phi_1 = added(identity, product(M, phi_2))
    E = added(identity, product(M, phi_1))
    for _ in range(doublings):
        phi_2 = scaled(added(product(phi_1, phi_1), scaled(phi_2, 2)), HALF * HALF)
        phi_1 = scaled(added(phi_1, product(E, phi_1)), HALF)
        E = product(E, E)
    return E, phi_1, phi_2


def product(a: DecimalMatrix, b: DecimalMatrix) -> DecimalMatrix:
    columns = list(zip(*b))
    return [[sum(map(mul, row, column), Decimal(0)) for column in columns] for row in a]


def added(a: DecimalMatrix, b: DecimalMatrix) -> DecimalMatrix:
    return [list(map(add, *rows)) for rows in zip(a, b)]


def scaled(a: Iterable[Iterable[float | Decimal]], factor: int | Decimal) -> DecimalMatrix:
    return [[Decimal(item) * factor for item in row] for row in a]
