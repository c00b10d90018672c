"""Newton's method for what feeds back on itself by direct feedthrough."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import SetupError

Array = NDArray[np.float64]

#: Limits the iterations. Derived: from a difference as large as the signal, quadratic convergence takes
#: six; damped by an inexact Jacobian, three times as many.
MOST_ITERATIONS = 20
#: The residual of a signal over its size, below which it is solved. Derived: FMUs that solve equations
#: inside do so to about 1e-10, and a smaller residual cannot be asked of their outputs.
TOLERANCE = 1e-10
#: The step of a difference over the size of its signal. Derived: the square root of what is left of 16
#: digits after FMUs have lost four, (1e-12) ** 0.5.
DIFFERENCE = 1e-6
#: The condition of the balanced Jacobian above which it is singular. Derived: differences give it to
#: about DIFFERENCE, and a hundred times less must be left of the solution.
SINGULAR = 1e8


def solve_fixed_point(
    response: Callable[[Array], Array], z: Array, nominal: Array, names: Sequence[str]
) -> None:
    """Find z = response(z), and leave the system at the solution.

    Newton's method with forward differences. Whether the Jacobian is singular is decided after balancing,
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

    Raises
    ------
    SetupError
        With signals and residuals, if there is no solution or no convergence.
    """
    residual = response(z) - z
    for _ in range(MOST_ITERATIONS):
        if (np.abs(residual) <= TOLERANCE * (nominal + np.abs(z))).all():
            return
        jacobian = _jacobian(response, z, residual, nominal)
        if not np.isfinite(jacobian).all() or _condition(jacobian) > SINGULAR:
            break
        z = z - np.linalg.solve(jacobian, residual)
        residual = response(z) - z
    worst = ", ".join(
        f"{name} by {r:.2g}"
        for name, r, size in zip(names, residual, nominal)
        if not abs(r) <= TOLERANCE * size
    )
    raise SetupError(f"the start values of an algebraic loop were not found; still off: {worst}")


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


def _condition(jacobian: Array) -> float:
    """The condition number after balancing: Parlett and Reinsch, Numer. Math. 13 (1969)."""
    from scipy.linalg import matrix_balance

    balanced, _ = matrix_balance(jacobian)
    return float(np.linalg.cond(balanced))
