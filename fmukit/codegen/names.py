"""Names in what is printed: what a model calls its parameters never meets the printer's own names."""

from __future__ import annotations

import re

from ..trace.graph import Node


def printed_name(name: str) -> str:
    """The printed name of a parameter of a function, or of its tangents."""
    plain = re.sub(r"\W", lambda letter: f"_{ord(letter[0]):x}_", name.rstrip("'"), flags=re.ASCII)
    return f"{'d' if name.endswith(chr(39)) else 'p'}_{plain}"


def parameter_name(node: Node) -> str | None:
    """A number that a function has been given, or carries through a loop; None for any other."""
    if node.op == "symbol":
        return printed_name(node.args[0])
    if node.op == "element":
        return f"{printed_name(node.args[0])}[{node.args[1]}]"
    return f"v{node.args[0]}_{node.args[1]}" if node.op == "variable" else None
