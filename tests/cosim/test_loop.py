"""The two interpreters of a program agree on its layout: the tables in Python, and loop.c."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from cosim.engine import compiler
from cosim.engine.compiler import SOURCE
from cosim.engine.loop import ColumnCell
from cosim.fmu.fmi3 import StepAnswer
from cosim.fmu.operations import NOT_FINITE, Code, COperation


def enumeration(text: str) -> list[str]:
    """The names of the first enumeration, in their sequence."""
    match = re.search(r"enum \{(.*?)\};", text, re.DOTALL)
    assert match
    return [name.split("=")[0].strip() for name in match[1].split(",")]


def test_the_tables_are_those_of_the_compiled_loop(tmp_path: Path) -> None:
    """Codes are numbered alike; structures have the size, and fields the place, that the compiler gives them."""
    assert enumeration(SOURCE.read_text()) == [*(code.name for code in Code), "NOT_FINITE"]
    assert [*Code] == list(range(len(Code))) and NOT_FINITE == -(2**31)
    kinds: dict[str, Any] = {"operation": COperation, "answer": StepAnswer, "column": ColumnCell}
    places = {
        f"offsetof({name}, {field[0]})": getattr(kind, field[0]).offset
        for name, kind in kinds.items()
        for field in kind._fields_
    }
    places |= {f"sizeof({name})": ctypes.sizeof(kind) for name, kind in kinds.items()}
    source = f'#include "{SOURCE}"\nconst int places[] = {{{", ".join(places)}}};\n'
    (tmp_path / "places.c").write_text(source)
    command = [sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-o", "p.so", "places.c"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    array = (ctypes.c_int * len(places)).in_dll(ctypes.CDLL(str(tmp_path / "p.so")), "places")
    assert dict(zip(places, array)) == places


def test_the_loop_is_compiled_for_every_platform_of_a_release(tmp_path: Path) -> None:
    """Each links against what its system has: what the compiler puts in place of a loop in C must be there, too."""
    compiler.compile_every_loop(tmp_path)
    names = {compiler.file_name(*platform) for platform in compiler.TARGETS}
    assert {path.name for path in tmp_path.iterdir()} == names
