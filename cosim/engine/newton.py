"""Newton's method for what feeds back on itself by direct feedthrough."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Limits the iterations. Derived: from a difference as large as the signal, quadratic convergence takes
#: six; damped by an inexact Jacobian, three times as many.
MOST_ITERATIONS = 20
#: The residual of a signal over its size, below which it is solved. Derived: FMUs that solve equations
#: inside do so to about 1e-10, and a smaller residual cannot be asked of their outputs.
NEWTON_TOLERANCE = 1e-10
#: The step of a difference over the size of its signal. Derived: the square root of what is left of 16
#: digits after FMUs have lost four, (1e-12) ** 0.5.
DIFFERENCE = 1e-6
#: The condition of the scaled Jacobian above which it is singular. Derived: differences give it to
#: about DIFFERENCE, and a hundred times less must be left of the solution.
SINGULAR = 1e8
#: The same where the derivatives are exact. Derived: a solution loses as many digits as the condition number has, and
#: of the sixteen of a double four remain.
SINGULAR_EXACT = 1e12
#: By how much an iteration must reduce the residual to be followed by another, once all signals are within their
#: nominal sizes. Derived: Newton's method squares it, and rounding does not reduce it at all.
WORTHWHILE = 0.5


def solve_fixed_point(
    response: Callable[[Array], Array],
    z: Array,
    nominal: Array,
    names: Sequence[str],
    *,
    derivative: Callable[[], Array] | None = None,
    tolerance: float = NEWTON_TOLERANCE,
) -> str:
    """Find z = response(z), and leave the system at the solution.

    Newton's method. Every signal is solved to the tolerance of its own size, however large another one in the
    loop is. One that comes no closer, since it is a small difference of larger signals, is solved to the
    tolerance of these or of its nominal value. Whether the Jacobian is singular is decided after scaling,
    which takes out the units of the signals: coefficients of 1e6 and 1e-6 that meet in one loop are as
    harmless as two of 1.

    Parameters
    ----------
    response
        Puts values on the inputs and returns what the outputs bring to them, both of shape (n,).
    z
        The initial guess, shape (n,).
    nominal
        The sizes of the signals, shape (n,).
    names
        The signals, for the message.
    derivative
        The derivative of the response where the system is, shape (n, n); by default forward differences.
    tolerance
        The largest residual over the size of a signal.

    Returns
    -------
    str
        "" if solved; else the signals that are still off, and by how much.
    """
    residual = response(z) - z
    worst, size = math.inf, nominal + np.abs(z)
    for _ in range(MOST_ITERATIONS):
        remaining = np.abs(residual)
        unsettled = ~(remaining <= tolerance * np.abs(z))
        if not unsettled.any():
            return ""
        previous, worst = worst, float((remaining / nominal)[unsettled].max())
        if (remaining <= tolerance * size).all() and worst > WORTHWHILE * previous:
            return ""
        if derivative is None:
            jacobian, most = _jacobian(response, z, residual, nominal), SINGULAR
        else:
            jacobian, most = derivative() - np.eye(len(z)), SINGULAR_EXACT
        if not np.isfinite(jacobian).all() or is_singular(jacobian, most):
            residual = response(z) - z  # brings the system back from the last difference
            break
        z = z - np.linalg.solve(jacobian, residual)
        residual = response(z) - z
        size = nominal + np.abs(jacobian) @ np.abs(z)
    return ", ".join(
        f"{name} by {r:.2g}"
        for name, r, of_signal in zip(names, residual, size)
        if not abs(r) <= tolerance * of_signal
    )


def _jacobian(
    response: Callable[[Array], Array], z: Array, residual: Array, nominal: Array
) -> Array:
    """The derivatives of the residual, shape (n, n), by forward differences."""
    columns = []
    for i, step in enumerate(DIFFERENCE * (nominal + np.abs(z))):
        shifted = z.copy()
        shifted[i] += step
        columns.append((response(shifted) - shifted - residual) / step)
    return np.array(columns).T


def is_singular(jacobian: Array, most: float) -> bool:
    """Whether a solution with this Jacobian of a residual would lose more digits than `most` has.

    It is the derivative of the response less one, which may cancel: then the rounding of both is left. The factor that
    errors of theirs have in the solution is that of Bauer (ZAMM 46, 1966) and Skeel (J. ACM 26, 1979); units of the
    signals leave it as it is.
    """
    if condition(jacobian) > most:
        return True
    one = np.eye(len(jacobian))
    factors = np.abs(np.linalg.inv(jacobian)) @ (np.abs(jacobian + one) + one)
    return bool(np.abs(np.linalg.eigvals(factors)).max() > most)


def condition(matrix: Array) -> float:
    """The condition number after its rows and columns are scaled to a largest element of 1.

    Such a matrix has nearly the least condition that any scaling gives it (van der Sluis, Numer. Math. 14, 1969).
    """
    scaled = np.abs(matrix).max(axis=1, keepdims=True)
    rows = matrix / np.where(scaled > 0.0, scaled, 1.0)
    largest = np.abs(rows).max(axis=0)
    return float(np.linalg.cond(rows / np.where(largest > 0.0, largest, 1.0)))
