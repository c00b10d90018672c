"""What the kit needs of a model: all parts, with the right names and arguments, in files that import nothing else."""

import ast
import sys
from difflib import get_close_matches
from inspect import Signature, signature
from math import inf
from pathlib import Path
from types import ModuleType

from ..declare.model import RECORDS, Model
from ..trace.modules import imported_files

#: The arguments of a model's functions.
FUNCTIONS = {
    "derivatives": "p, t, x, u", "outputs": "p, t, x, u", "check": "p", "step_constants": "p, x",
    "exact": "p, x, u0, u1, h", "event_indicators": "p, t, x, u", "event_update": "p, t, x, u, which",
    "sample": "p, t, x, before, now", "complete_state": "p, x", "notes": "p, t, old, new, u",
}  # fmt: skip
#: The modules of the standard library that give the same at each import; with others, and with the functions below, a
#: file, a clock, a random number or the environment would enter a model's constants, and its FMU stay up to date.
CONSTANT_MODULES = frozenset(
    [
        "__future__",
        "abc",
        "array",
        "bisect",
        "cmath",
        "collections",
        "contextlib",
        "copy",
        "dataclasses",
        "decimal",
        "enum",
        "fractions",
        "functools",
        "heapq",
        "itertools",
        "json",
        "math",
        "numbers",
        "operator",
        "re",
        "statistics",
        "string",
        "struct",
        "textwrap",
        "types",
        "typing",
        "warnings",
    ]
)
READING_FUNCTIONS = ("open", "input", "eval", "exec", "__import__")
#: Least similarity of a misspelt name, as `difflib` measures it: two letters exchanged in the shortest names give 0.8.
SIMILARITY = 0.8


def require_parts(model: Model) -> None:
    """Raise TypeError or ValueError, with what to write, for a part that is missing or wrong."""
    needed = {
        "__doc__": 'write """One line that says what it is""" at the top of the file',
        "EXPERIMENT": "write EXPERIMENT = Experiment(stop=10.0, step=0.01)",
        "derivatives": "write def derivatives(p, t, x, u), which returns the State of slopes",
        "outputs": "write def outputs(p, t, x, u), which returns the Outputs",
    }
    if model.event_indicators or model.event_update:
        needed["event_indicators"] = (
            "write def event_indicators(p, t, x, u), which returns a tuple of values that stay above 0"
        )
        needed["event_update"] = (
            "write def event_update(p, t, x, u, which), which returns the State after the event"
        )
    for name, form in needed.items():
        if not vars(model).get(name):
            raise TypeError(f"{'the docstring' if name == '__doc__' else name} is missing: {form}")
    stop, step = model.EXPERIMENT
    if not isinstance(stop, int | float) or not isinstance(step, int | float):
        raise TypeError(f"EXPERIMENT has stop = {stop!r} and step = {step!r}: write numbers, in s")
    if not 0.0 < step <= stop < inf:
        raise ValueError(
            f"EXPERIMENT has stop = {stop!r} s and step = {step!r} s: 0 < step <= stop must hold"
        )
    for name, expected in FUNCTIONS.items():
        if function := vars(model)[name]:
            constants = name == "derivatives" and model.step_constants
            optional = ["constants"] if constants else []
            _require_arguments(name, signature(function), expected.split(", "), optional)


def _require_arguments(
    name: str, actual: Signature, expected: list[str], optional: list[str]
) -> None:
    names = list(actual.parameters)
    swapped = names[: len(expected)] != expected and sorted(names[: len(expected)]) == sorted(
        expected
    )
    try:
        actual.bind(*expected)
        actual.bind(*expected, *optional)
    except TypeError:
        swapped = True
    if swapped:
        form = ", ".join([*expected, *(f"{argument}=None" for argument in optional)])
        raise TypeError(f"{name} takes {', '.join(names)}: write def {name}({form})")


def require_spelling(path: Path, module: ModuleType) -> None:
    """Raise SyntaxError for a name that nothing in the file uses and that is almost one which the kit reads.

    Such a function or constant would be ignored. A helper that is called may have any name.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    symbols = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    used = {node.id for node in symbols if isinstance(node.ctx, ast.Load)}
    missing = {name.lower(): name for name in Model.__annotations__ if name not in vars(module)}
    for node in tree.body:
        named = [node] if isinstance(node, ast.FunctionDef | ast.ClassDef) else []
        targets: list[ast.expr] = [node.target] if isinstance(node, ast.AnnAssign) else []
        targets += node.targets if isinstance(node, ast.Assign) else []
        names = [x.name for x in named] + [x.id for x in targets if isinstance(x, ast.Name)]
        for name in names:
            for close in get_close_matches(name.lower(), missing, 1, SIMILARITY):
                if name not in used:
                    reason = f"nothing uses {name}: write {definition_to_write(missing[close])}"
                    raise SyntaxError(reason, (str(path), node.lineno, None, None))


def definition_to_write(name: str) -> str:
    """How a model begins the definition of a name that the kit reads."""
    if name in RECORDS:
        return f"class {name}"
    return f"def {name}({FUNCTIONS[name]})" if name in FUNCTIONS else f"{name} = ..."


def require_imports(path: Path) -> None:
    """Raise SyntaxError for an import that would be missing from the FMU, and for what reads more than files of the model."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bound = {
        n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Load)
    }
    bound |= {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
    bound |= {n.arg for n in ast.walk(tree) if isinstance(n, ast.arg)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in READING_FUNCTIONS and node.id not in bound:
            _refuse_reading(path, node, node.id)
        if not isinstance(node, ast.Import | ast.ImportFrom) or imported_files(path, node):
            continue
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            names = ["." * node.level + (node.module or "")]
        for name in names:
            package = name.partition(".")[0]
            imports_package = isinstance(node, ast.Import) and package == "fmukit"
            if imports_package or package not in {"fmukit", *sys.stdlib_module_names}:
                raise SyntaxError(
                    f"{name} cannot go into the FMU: a model uses only the standard library, "
                    "'from fmukit import ...', and 'from .name import ...' of a file name.py "
                    "in its folder",
                    (str(path), node.lineno, None, None),
                )
            if package != "fmukit" and package not in CONSTANT_MODULES:
                _refuse_reading(path, node, name)


def _refuse_reading(path: Path, node: ast.Name | ast.Import | ast.ImportFrom, name: str) -> None:
    """Raise SyntaxError for what may give another value at the next build, of the same file."""
    raise SyntaxError(
        f"{name} may give other values at another time, and the FMU would not be built anew: write the numbers into "
        "the model, or into a file name.py in its folder, for 'from .name import ...'",
        (str(path), node.lineno, None, None),
    )
