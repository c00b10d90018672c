"""Names say what a thing is: words without a meaning of their own are banned from identifiers.

`tests/names_left.txt` counts the identifiers that still hold one, by file. A count may only shrink, and
`python tests/test_names.py` writes the list again once it did.
"""

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LEFT = ROOT / "tests" / "names_left.txt"
#: participles, pronouns and adverbs, which name nothing; the glossary has the terms to use instead
BANNED_LIST = """
alike alive alone apart asked away begun bench beside blemish bring busy calm coarser course deaf drawn
fallen few forget found given handed hear heard here kept kick known ladder late law lone looking looks
lost made meets moved off one others own place places remains rough said seen shaken shown spoil spot
steer tell tells there told torn way ways whole words
"""
BANNED = frozenset(BANNED_LIST.split())
#: substitutes that say as little
EMPTY = frozenset({"obj", "res", "stuff", "thing", "things", "tmp"})
#: names that others gave: fixtures of pytest, Python's standard library, the papers' symbol of the resonance
FOREIGN = frozenset(
    {
        "tmp_path",
        "tmp_path_factory",
        "FileNotFoundError",
        "ModuleNotFoundError",
        "PackageNotFoundError",
        "nu_res",
        "is_alive",
        "parse_known_args",
    }
)


def parts_of(name: str) -> set[str]:
    """The words of an identifier: `largest_found`, `LargestFound` and `LARGEST_FOUND` have two."""
    separated = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return set(separated.lower().split("_"))


def identifiers(path: Path) -> Iterator[str]:
    """Each identifier that a file binds or uses, as often as it does; those of strings are not meant."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        code = re.sub(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"', " ", text, flags=re.DOTALL)
        yield from re.findall(r"[A-Za-z_]\w*", code)
        return
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Name(id=name) | ast.arg(arg=name) | ast.Attribute(attr=name):
                yield name
            case (
                ast.FunctionDef(name=name)
                | ast.AsyncFunctionDef(name=name)
                | ast.ClassDef(name=name)
            ):
                yield name
            case ast.alias(asname=str(name)):
                yield name


def banned(path: Path) -> int:
    """How many identifiers of a file hold a banned word."""
    return sum(
        bool(parts_of(name) & (BANNED | EMPTY)) for name in identifiers(path) if name not in FOREIGN
    )


def count() -> Counter[str]:
    """The files of the project that have such identifiers, and how many."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py", "*.c", "*.h"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    return Counter(
        {name: n for name in listed if (ROOT / name).exists() and (n := banned(ROOT / name))}
    )


def read_left() -> Counter[str]:
    """The list of what is not done yet."""
    lines = LEFT.read_text(encoding="utf-8").splitlines() if LEFT.exists() else []
    return Counter({name: int(n) for n, name in (line.split(maxsplit=1) for line in lines)})


def test_parts_of_compound_identifiers_are_compared() -> None:
    assert parts_of("largest_found") == parts_of("LargestFound") == parts_of("LARGEST_FOUND")
    assert (
        parts_of("known") & BANNED
        and not parts_of("unknown") & BANNED
        and not parts_of("own_") & {"owner"}
    )


def test_a_planted_word_is_detected(tmp_path: Path) -> None:
    python, c = tmp_path / "a.py", tmp_path / "a.c"
    python.write_text('def f(told):\n    """found"""\n    return told.seen + x\n')
    c.write_text('static int kept; /* found */ char* text = "given";\n')
    assert (banned(python), banned(c)) == (3, 1)


def test_banned_identifiers_only_become_fewer() -> None:
    left, now = read_left(), count()
    more = {name: (n, left[name]) for name, n in now.items() if n > left[name]}
    assert not more, f"identifiers with a banned word, now and before, see docs/glossary.md: {more}"
    fewer = {name: (now[name], n) for name, n in left.items() if now[name] < n}
    assert not fewer, f"done, so write the list again with python tests/test_names.py: {fewer}"


if __name__ == "__main__":
    before, now = read_left(), count()
    risen = [name for name, n in now.items() if before and n > before[name]]
    if risen and "--moved" not in sys.argv:
        sys.exit(f"more than before: {risen}; --moved says that files were moved or split")
    LEFT.write_text("".join(f"{n} {name}\n" for name, n in sorted(now.items())), encoding="utf-8")
