"""The structures of the loops in C, for ctypes, as their sources declare them."""

from __future__ import annotations

import ctypes
import re
from typing import Any

INT, LONG, DOUBLE, PLACE = ctypes.c_int, ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p
TYPES: dict[str, Any] = {"int": INT, "long long": LONG, "double": DOUBLE, "bool": ctypes.c_bool}
STRUCTURE = re.compile(r"typedef struct \{(?P<fields>[^}]*)\} (?P<name>\w+);")
FIELD = re.compile(r"\s*(?:const )?(?P<type>(?:long )?\w+) (?P<names>.*)", re.DOTALL)


def structures(source: str, **known: Any) -> dict[str, Any]:
    """The structures of a source by name, and those that are `known`; pointers are addresses."""
    made = {**TYPES, **known}
    for structure in STRUCTURE.finditer(source):
        fields = []
        for line in structure["fields"].split(";")[:-1]:
            field = FIELD.fullmatch(line)
            assert field is not None, line
            fields += [
                (name.lstrip("*"), PLACE if "*" in name else made[field["type"]])
                for name in map(str.strip, field["names"].split(","))
            ]
        made[structure["name"]] = type(structure["name"], (ctypes.Structure,), {"_fields_": fields})
    return made
