"""What sweeps return, as JSON and back: the same to the last bit, and nothing is executed."""

from __future__ import annotations

import json
import math
import pickle
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workbench import Figure
from workbench.measure import Measured
from workbench.runs.codec import Records, dumps, loads

RECORDS = Records(frozenset({"workbench", __name__}))


class Point(NamedTuple):
    nu: float
    torque: complex
    waveform: tuple[float, ...] = ()


@dataclass(frozen=True)
class Machine:
    d: float
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.d < 0.0:
            raise AssertionError("reading calls no function of a class")


class Loose:
    """No record."""


SCALARS = st.none() | st.booleans() | st.integers() | st.text() | st.floats() | st.complex_numbers()
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner)
        | st.lists(inner).map(tuple)
        | st.dictionaries(st.text() | st.integers() | st.booleans(), inner)
    ),
)


# drawing takes longer on a busy machine, which says nothing about the values
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(VALUES)
def test_plain_values_are_the_same_to_the_last_bit(value: Any) -> None:
    again = loads(dumps(value))
    assert repr(again) == repr(value)  # tells apart -0.0, nan, True and 1, tuples and lists


def test_arrays_numbers_and_records_are_the_same_to_the_last_bit() -> None:
    rng = np.random.default_rng(1)
    plain = rng.standard_normal((3, 4, 2))
    values = [
        plain, plain.astype(">f4"), np.asfortranarray(plain[0]), plain[:, ::2], plain[0] * 1j,
        np.array([[True, False]]), np.arange(5, dtype=np.uint8), np.zeros((0, 3)), np.array(2.5),
        np.float64(0.1), np.complex128(1 - 0j), np.int32(-7), np.bool_(True), np.float32("nan"),
    ]  # fmt: skip
    for value in values:
        again = loads(dumps(value))
        assert type(again) is type(value)
        assert again.dtype == value.dtype
        assert again.shape == value.shape
        assert again.tobytes() == value.tobytes()
        if isinstance(value, np.ndarray):
            assert again.flags.writeable
            assert again.flags.f_contiguous == value.flags.f_contiguous or not (
                value.flags.c_contiguous or value.flags.f_contiguous
            )
    records = [
        Point(1.0, complex(-0.0, math.inf), (0.1, math.nan)),
        (Machine(0.3, ("a", "!b")), Figure.undetermined("N", "it jams")),
        {"up": Measured(math.nan, math.inf), "!down": [Measured(1.0, 5e-324)]},
    ]
    for record in records:
        again = loads(dumps(record, RECORDS), RECORDS)
        assert type(again) is type(record)
        assert repr(again) == repr(record)


@pytest.mark.parametrize(
    "value", [object(), {1, 2}, Loose(), np.array([object()]), np.str_("a"), Path("a"), b"a", len]
)
def test_a_value_of_another_type_is_refused_by_the_name_of_its_type(value: Any) -> None:
    with pytest.raises(TypeError, match=f"type .*{type(value).__name__}"):
        dumps([value], RECORDS)


def test_a_record_is_written_and_read_only_where_its_package_is_imported() -> None:
    text = dumps(Point(1.0, 2.0), RECORDS)
    with pytest.raises(TypeError, match=r"value of type .*Point"):
        dumps(Point(1.0, 2.0), Records(frozenset({"workbench"})))
    with pytest.raises(ValueError, match="is no known class"):
        loads(text, Records(frozenset({"workbench"})))


HOSTILE = (
    '{"!record":["subprocess:Popen",{"args":["touch","owned"]}]}',
    '{"!record":["workbench.runs.codec:Records",{}]}',
    '{"!record":["workbench.runs.codec:sys.modules",{}]}',
    '{"!record":["workbench.runs.transport:pickled_call",{}]}',
    '{"!record":["workbench.figure:Figure",{"value":1.0}]}',
    '{"!record":["workbench.figure:Figure.text",{}]}',
    '{"!record":"workbench.figure:Figure"}',
    '{"!record":[["workbench"],{}]}',
    '{"!array":["|O",[1],"C","AAAAAAAAAAA="]}',
    '{"!array":["<f8",[1],"C","AAAA"]}',
    '{"!array":["<f8",[3],"C","AAAAAAAAAAA="]}',
    '{"!array":["<f8",[1],"C","!!!"]}',
    '{"!array":["f8, i4",[1],"C","AAAAAAAAAAA="]}',
    '{"!scalar":["<f8",""]}',
    '{"!scalar":["|V8","AAAAAAAAAAA="]}',
    '{"!float":"1.0"}', '{"!float":1.0}', '{"!complex":[1.0]}', '{"!complex":["a",1.0]}',
    '{"!dict":[[[1],2]]}', '{"!dict":[[1]]}', '{"!tuple":3}', '{"!new":1}',
    '{"!float":"nan","more":1}', "NaN", "[Infinity]", "x", "", "[" * 100_000,
)  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE)
def test_another_text_is_refused_and_runs_nothing(text: str) -> None:
    before = set(sys.modules)
    with pytest.raises(ValueError):
        loads(text, RECORDS)
    assert set(sys.modules) == before


def test_reading_imports_nothing_and_is_plain_json() -> None:
    assert json.loads(dumps({"tau": [1.5, "N.m", None]})) == {"tau": [1.5, "N.m", None]}
    with pytest.raises(ValueError, match="is no known class"):
        loads('{"!record":["workbench.never_loaded:Some",{}]}', RECORDS)
    with pytest.raises(ValueError):
        loads(pickle.dumps([1]).decode("latin-1"))
