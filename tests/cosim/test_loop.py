"""The two interpreters of a program agree on its layout: the tables in Python, and loop.c."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from pathlib import Path

from cosim.engine import compiler, members
from cosim.engine.compiler import MEMBERS, SOURCE
from cosim.engine.structures import structures
from cosim.fmu.fmi3 import StepAnswer
from cosim.fmu.operations import NOT_FINITE, Code, COperation


def enumeration(text: str) -> list[str]:
    """The names of the first enumeration, in their sequence."""
    match = re.search(r"enum \{(.*?)\};", text, re.DOTALL)
    assert match
    return [name.split("=")[0].strip() for name in match[1].split(",")]


def test_the_tables_are_those_of_the_compiled_loop() -> None:
    text = SOURCE.read_text()
    made, pairs = structures(text), {"operation": COperation, "answer": StepAnswer}
    assert enumeration(text) == [*(code.name for code in Code), "NOT_FINITE"]
    assert {n: made[n]._fields_ for n in pairs} == {
        n: list(kind._fields_) for n, kind in pairs.items()
    }
    assert [*Code] == list(range(len(Code))) and NOT_FINITE == -(2**31)


def test_the_statuses_and_the_place_are_those_of_the_loop_over_members() -> None:
    text = MEMBERS.read_text()
    place = structures(text, **structures(SOURCE.read_text()))["place"]
    assert list(place._fields_) == list(members.Place._fields_)
    outcomes = re.search(r"enum \{ (DONE.*?) \};", text)
    assert outcomes and outcomes[1].split(", ") == ["DONE", "WARNED", "LEFT"]
    assert [members.DONE, members.WARNED, members.LEFT] == [0, 1, 2]


def test_a_structure_has_the_size_that_the_compiler_gives_it(tmp_path: Path) -> None:
    made = structures(MEMBERS.read_text(), **structures(SOURCE.read_text()))
    names = [name for name, kind in made.items() if issubclass(kind, ctypes.Structure)]
    assert len(names) > 10
    sizes = ", ".join(f"sizeof({name})" for name in names)
    (tmp_path / "sizes.c").write_text(f'#include "{MEMBERS}"\nconst int sizes[] = {{{sizes}}};\n')
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-shared",
        "-fPIC",
        "-o",
        "sizes.so",
        "sizes.c",
    ]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    loaded = ctypes.CDLL(str(tmp_path / "sizes.so"))
    array = (ctypes.c_int * len(names)).in_dll(loaded, "sizes")
    assert dict(zip(names, array)) == {name: ctypes.sizeof(made[name]) for name in names}


def test_the_loop_is_compiled_for_every_platform_of_a_release(tmp_path: Path) -> None:
    """Each links against what its system has: what the compiler puts in place of a loop in C must be there, too."""
    compiler.compile_every_loop(tmp_path)
    names = {compiler.file_name(*platform) for platform in compiler.TARGETS}
    assert {path.name for path in tmp_path.iterdir()} == names
