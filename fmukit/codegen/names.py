"""Names in what is printed: what a model calls its parameters never meets the printer's own names."""

from __future__ import annotations

import re

from ..trace.graph import Argument, LoopVariable, Node


def printed_name(name: str) -> str:
    """The printed name of a parameter of a function, or of its tangents."""
    plain = re.sub(r"\W", lambda letter: f"_{ord(letter[0]):x}_", name.rstrip("'"), flags=re.ASCII)
    return f"{'d' if name.endswith(chr(39)) else 'p'}_{plain}"


def parameter_name(node: Node) -> str | None:
    """A number that is an argument of a function, or carried through a loop; None for any other."""
    if isinstance(node, Argument):
        name = printed_name(node.name)
        return name if node.index is None else f"{name}[{node.index}]"
    return f"v{node.loop}_{node.index}" if isinstance(node, LoopVariable) else None
