"""Every numeric constant of a module says where its number comes from.

It stands alone on its line, with a comment `#:` above it that says what it is derived from, where it was
measured or whose convention it is. `tests/constants_left.txt` counts those that do not, by file; a count may only
shrink, and `python tests/test_constants.py` writes the list again once it did.
"""

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LEFT = ROOT / "tests" / "constants_left.txt"
PRODUCT = (
    "fmukit",
    "cosim",
    "workbench",
    "scenarios",
    "components",
    "gallery",
    "examples",
    "benchmarks",
)
#: numbers that need no origin: they index, count from or turn signs
PLAIN = frozenset({"-1", "0", "1"})


def is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, or arithmetic of numbers."""
    match node:
        case ast.Constant(value=bool()):
            return False
        case ast.Constant(value=int() | float()):
            return True
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) and is_number(right)
    return False


def unexplained(text: str) -> Iterator[str]:
    """The names of constants that a module binds to a number without a word, or several in one line."""
    lines = text.splitlines()
    for node in ast.parse(text).body:
        match node:
            case ast.Assign(targets=[target], value=value):
                pass
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                pass
            case _:
                continue
        match target, value:
            case ast.Tuple(elts=names), ast.Tuple(elts=values) if any(map(is_number, values)):
                yield from (ast.unparse(name) for name in names)
            case ast.Name(id=name), _ if name.lstrip("_").isupper() and is_number(value):
                above = lines[node.lineno - 2].lstrip() if node.lineno > 1 else ""
                explained = above.startswith("#:") and len(above.split()) > 2
                if not explained and ast.unparse(value) not in PLAIN:
                    yield name


def count() -> Counter[str]:
    """The modules that have such constants, and how many."""
    listed = subprocess.run(
        [
            "git",
            "ls-files",
            "--cached",
            "--others",
            "--exclude-standard",
            *(f"{x}/*.py" for x in PRODUCT),
        ],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    files = {name: ROOT / name for name in listed if (ROOT / name).exists()}
    counts = {
        name: len(list(unexplained(x.read_text(encoding="utf-8")))) for name, x in files.items()
    }
    return Counter({name: n for name, n in counts.items() if n})


def read_left() -> Counter[str]:
    """The list of what is not done yet."""
    lines = LEFT.read_text(encoding="utf-8").splitlines() if LEFT.exists() else []
    return Counter({name: int(n) for n, name in (line.split(maxsplit=1) for line in lines)})


def test_a_planted_constant_is_detected() -> None:
    text = "A, B = 3, 4\nC = 0.3\n#: convention of the standard\nD = 2.0\n#: x\nE = 2.0\nF = 1\n"
    assert list(unexplained(text)) == ["A", "B", "C", "E"]


def test_unexplained_constants_only_become_fewer() -> None:
    left, now = read_left(), count()
    more = {name: (n, left[name]) for name, n in now.items() if n > left[name]}
    assert not more, (
        f"constants without an origin (a comment #: above them), now and before: {more}"
    )
    fewer = {name: (now[name], n) for name, n in left.items() if now[name] < n}
    assert not fewer, f"done, so write the list again with python tests/test_constants.py: {fewer}"


if __name__ == "__main__":
    before, now = read_left(), count()
    risen = [name for name, n in now.items() if before and n > before[name]]
    if risen and "--moved" not in sys.argv:
        sys.exit(f"more than before: {risen}; --moved says that files were moved or split")
    LEFT.write_text("".join(f"{n} {name}\n" for name, n in sorted(now.items())), encoding="utf-8")
