"""The state of tracing, in one place: the nodes that there are, and the paths that are being followed.

Operators of nodes have no argument for it, so that one context is the current one while functions are
traced. Nothing else of tracing is global.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from .execute import Path
    from .graph import Node, Tree

N = TypeVar("N", bound="Node")


class TraceContext:
    """All nodes of a component by what makes them unique, its loops, and the path that is being followed."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.node_by_identity: dict[Any, Node] = {}
        self.loop_numbers: dict[Any, int] = {}
        self.loop_bodies: dict[Any, Tree] = {}
        self.paths: list[Path] = []
        self.joins: dict[Any, Any] = {}
        self.forks, self.answers_only = 0, False

    def unique(self, identity: tuple[Any, ...], make: Callable[[int], N]) -> N:
        """Return the node of this identity; `make` makes it from its number where there is none."""
        if identity not in self.node_by_identity:
            node = make(len(self.nodes))
            self.node_by_identity[identity] = node
            self.nodes.append(node)
        return self.node_by_identity[identity]  # type: ignore[return-value]

    @property
    def path(self) -> Path:
        """The path that is being followed."""
        return self.paths[-1]

    @contextmanager
    def from_start(self, answers_only: bool) -> Iterator[None]:
        """Follow a function from its start, whatever path calls it; with `answers_only` without joins."""
        saved = self.paths, self.joins, self.forks, self.answers_only
        self.paths, self.joins, self.forks, self.answers_only = [], {}, 0, answers_only
        try:
            yield
        finally:
            self.paths, self.joins, self.forks, self.answers_only = saved


#: The contexts that are active, the current one last.
_ACTIVE: list[TraceContext] = []


def current() -> TraceContext:
    """Return the current context; raises RuntimeError outside of tracing."""
    if not _ACTIVE:
        raise RuntimeError("a traced number was used after tracing")
    return _ACTIVE[-1]


@contextmanager
def active(context: TraceContext) -> Iterator[TraceContext]:
    """Make a context the current one."""
    _ACTIVE.append(context)
    try:
        yield context
    finally:
        _ACTIVE.pop()
