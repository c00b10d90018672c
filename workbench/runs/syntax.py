"""What of a file of Python computes: its code without comments and docstrings, of a question without what it shows."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Iterator

from ..catalog import is_question
from .bundle import digest

#: What the class of a question has that only says or shows its answer.
SHOWN = frozenset({"judgements", "show", "live", "decisive", "sources", "error_scope"})


def code_digest(content: bytes, *, is_question: bool = False) -> str:
    """Return a short name for the syntax of a file.

    Comments, docstrings and line numbers are not in it; of a question neither is what only serves its
    verdict, its pictures and its live part.

    Raises
    ------
    SyntaxError
        For what is no Python.
    """
    tree = ast.parse(content)
    if is_question:
        tree.body = computing(tree.body)
    for node in ast.walk(tree):
        match node:
            case ast.Module() | ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
                if ast.get_docstring(node, clean=False) is not None:
                    del node.body[0]
    return digest(ast.dump(tree).encode())


def computing(body: Iterable[ast.stmt]) -> list[ast.stmt]:
    """Return the definitions to which the class of a question leads, and all statements that define nothing.

    The class is without what is SHOWN.
    """
    statements = [single for statement in body for single in _imports_split(statement)]
    classes = [x for x in statements if isinstance(x, ast.ClassDef) and is_question(x)]
    for each in classes:
        each.body = [x for x in each.body if not _names(x) & SHOWN] or [ast.Pass()]
    names = [_names(statement) for statement in statements]
    others = [_used(statement) for statement, own in zip(statements, names) if not own]
    kept = _reached(frozenset(x.name for x in classes).union(*others), statements, names)
    return [x for x, own in zip(statements, names) if not own or own & kept]


def _imports_split(statement: ast.stmt) -> Iterator[ast.stmt]:
    """A statement; of an import, one for each name."""
    if isinstance(statement, ast.Import | ast.ImportFrom):
        for alias in statement.names:
            yield type(statement)(**{**dict(ast.iter_fields(statement)), "names": [alias]},
                                  lineno=statement.lineno, col_offset=statement.col_offset)  # fmt: skip
    else:
        yield statement


def _names(statement: ast.stmt) -> set[str]:
    """The names that a statement defines; none for one that does something else."""
    match statement:
        case ast.ImportFrom(module="__future__") | ast.ImportFrom(names=[ast.alias(name="*")]):
            return set()
        case ast.Import(names=[alias]) | ast.ImportFrom(names=[alias]):
            return {alias.asname or alias.name.partition(".")[0]}
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            return {name}
        case ast.Assign(targets=targets):
            return {x.id for target in targets for x in ast.walk(target) if isinstance(x, ast.Name)}
        case ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
    return set()


def _used(statement: ast.stmt) -> set[str]:
    """The names that a statement mentions."""
    return {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}


def _reached(start: Collection[str], statements: list[ast.stmt], names: list[set[str]]) -> set[str]:
    """The names of definitions that some names lead to, themselves among them."""
    uses: dict[str, set[str]] = {}
    for statement, own in zip(statements, names):
        for name in own:
            uses.setdefault(name, set()).update(_used(statement))
    reached: set[str] = set()
    waiting = [*start]
    while waiting:
        name = waiting.pop()
        if name in uses and name not in reached:
            reached.add(name)
            waiting += uses[name]
    return reached
