"""The coupling algorithms: a file each, registered here once."""

from __future__ import annotations

from ...errors import SetupError
from ...names import meant
from .base import Algorithm, CouplingContext, Feedthrough, Stage, Turn
from .gauss_seidel import GaussSeidel
from .iterated import Iterated
from .jacobi import Jacobi
from .strang import Strang

#: The registry: engine, theory, checks, command line and documents take the algorithms from here.
REGISTRY: dict[str, Algorithm] = {
    algorithm.name: algorithm for algorithm in (Jacobi(), GaussSeidel(), Strang(), Iterated())
}
ALGORITHMS = tuple(REGISTRY)
CONVERGENCE_ORDERS = {name: algorithm.held_order for name, algorithm in REGISTRY.items()}


def find_algorithm(name: str) -> Algorithm:
    """The algorithm of this name.

    Raises
    ------
    SetupError
        If none is registered under the name.
    """
    if name not in REGISTRY:
        raise SetupError(
            f"algorithm {name!r} must be one of {', '.join(REGISTRY)}{meant(name, REGISTRY)}"
        )
    return REGISTRY[name]


__all__ = [
    "ALGORITHMS",
    "CONVERGENCE_ORDERS",
    "REGISTRY",
    "Algorithm",
    "CouplingContext",
    "Feedthrough",
    "Stage",
    "Turn",
    "find_algorithm",
]
