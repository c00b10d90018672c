"""The state of tracing, in one place: the nodes that there are, and the paths that are being followed.

Operators of nodes have no argument for it, so that one context is the current one while functions are
traced. Nothing else of tracing is global.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from .execute import FollowedPath
    from .graph import Node, Tree

N = TypeVar("N", bound="Node")
#: What tells a place on a path from all others, the same whenever the path is followed.
Place = tuple[Any, ...]


class TraceContext:
    """All nodes of a component by what makes them unique, its loops, and the path that is being followed."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.node_by_identity: dict[Any, Node] = {}
        self.loop_numbers: dict[Any, int] = {}
        self.loop_bodies: dict[Any, Tree] = {}
        self.paths: list[FollowedPath] = []
        self.joins: dict[Any, Any] = {}
        self.forks, self.without_joins = 0, False

    def unique(self, identity: tuple[Any, ...], cls: type[N], *fields: Any) -> N:
        """Return the node of this identity, with these fields after its number where it is made now."""
        if identity not in self.node_by_identity:
            node = cls(len(self.nodes), *fields)
            self.node_by_identity[identity] = node
            self.nodes.append(node)
        return self.node_by_identity[identity]  # type: ignore[return-value]

    @property
    def path(self) -> FollowedPath:
        """The path that is being followed."""
        return self.paths[-1]

    @contextmanager
    def separate_function(self, without_joins: bool) -> Iterator[None]:
        """Follow a function from its start, whatever path calls it, each path to its end if `without_joins`."""
        saved = self.paths, self.joins, self.forks, self.without_joins
        self.paths, self.joins, self.forks, self.without_joins = [], {}, 0, without_joins
        try:
            yield
        finally:
            self.paths, self.joins, self.forks, self.without_joins = saved


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
