"""The two interpreters of a program agree on its layout: the tables in Python, and loop.c."""

from __future__ import annotations

import ctypes
import re
from typing import Any

import pytest

from cosim.engine import members
from cosim.engine.compiler import MEMBERS, SOURCE
from cosim.engine.loop import Column
from cosim.fmu.fmi3 import Answer
from cosim.fmu.operations import NOT_FINITE, Code, Layout

TYPES: dict[str, Any] = {
    "int": ctypes.c_int,
    "double": ctypes.c_double,
    "bool": ctypes.c_bool,
    "longlong": ctypes.c_longlong,
    "column": Column,
}


def enumeration(text: str) -> list[str]:
    """The names of the first enumeration, in their sequence."""
    match = re.search(r"enum \{(.*?)\};", text, re.DOTALL)
    assert match
    return [name.split("=")[0].strip() for name in match[1].split(",")]


def structures(text: str) -> dict[str, list[tuple[str, Any]]]:
    """The fields of each structure by its name, pointers as addresses."""
    structures = {}
    for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", text, re.DOTALL):
        fields: list[tuple[str, Any]] = []
        for declaration in filter(
            None, map(str.strip, body.replace("long long", "longlong").split(";"))
        ):
            kind, variables = re.sub(r"^const ", "", declaration).split(None, 1)
            for variable in variables.split(","):
                pointer = variable.strip().startswith("*")
                fields.append((variable.strip(" *"), ctypes.c_void_p if pointer else TYPES[kind]))
        structures[name] = fields
    return structures


def differences(text: str) -> list[str]:
    """What of the tables in Python is not as in this C."""
    wrong = [] if enumeration(text) == [*(code.name for code in Code), "NOT_FINITE"] else ["enum"]
    fields = structures(text)
    pairs = {"operation": Layout, "answer": Answer, "column": Column}
    return wrong + [name for name, kind in pairs.items() if fields[name] != list(kind._fields_)]


def test_the_tables_are_those_of_the_compiled_loop() -> None:
    assert differences(SOURCE.read_text()) == []
    assert [*Code] == list(range(len(Code))) and NOT_FINITE == -(2**31)


TABLES = {
    "instance": members.InstanceLayout, "setting": members.Setting, "memory": members.Memory,
    "listener": members.Listener, "promise": members.Promise, "side": members.Side,
    "ensemble": members.EnsembleLayout, "place": members.Place,
}  # fmt: skip


def test_the_tables_are_those_of_the_loop_over_members() -> None:
    text = MEMBERS.read_text()
    found = structures(text)
    assert found.keys() == TABLES.keys()
    assert [name for name, kind in TABLES.items() if found[name] != list(kind._fields_)] == []
    outcomes = re.search(r"enum \{ (DONE.*?) \};", text)
    assert outcomes and outcomes[1].split(", ") == ["DONE", "WARNED", "LEFT"]
    assert [members.DONE, members.WARNED, members.LEFT] == [0, 1, 2]
    changed = structures(
        text.replace("double start, stop, h, share_kept;", "double start, h, stop, share_kept;")
    )
    assert changed["ensemble"] != list(members.EnsembleLayout._fields_)


@pytest.mark.parametrize(
    ("old", "new", "wrong"),
    [
        ("COPY, SCALE", "SCALE, COPY", ["enum"]),
        ("STEP3, BOOK", "STEP3, WAIT, BOOK", ["enum"]),
        ("double at, size,", "double size, at,", ["operation"]),
        ("bool event, ended", "int event, ended", ["answer"]),
        ("int type;\n", "double type;\n", ["column"]),
    ],
)
def test_a_table_that_differs_is_noticed(old: str, new: str, wrong: list[str]) -> None:
    text = SOURCE.read_text()
    assert old in text
    assert differences(text.replace(old, new, 1)) == wrong
