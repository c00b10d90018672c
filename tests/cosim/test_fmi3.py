"""FMUs of FMI 3.0 in the master: the numbers of FMI 2.0, and what FMI 3.0 has more."""

from __future__ import annotations

import math
import re
from contextlib import closing
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from lxml import etree
from numpy.testing import assert_array_equal

from cosim import (
    Adaptive,
    Result,
    SetupError,
    SimulationError,
    System,
    read_ssp,
    run,
    write_container,
    write_osp,
    write_ssp,
)  # fmt: skip
from cosim.engine.settings import RunSettings
from cosim.engine.setup import Setup
from cosim.engine.snapshot import Snapshot
from cosim.engine.system_instance import SystemInstance
from cosim.formats.ssp.standard import check_standard
from cosim.system import connect
from tests.conftest import rewritten
from tests.cosim import foreign
from tests.cosim.test_cosim import WIRES
from tests.cosim.third import BASES, pack
from tests.fmukit.test_native import built

G = 9.81
RANGES = {
    "Int8": (-128, 127),
    "UInt8": (0, 255),
    "Int16": (-(2**15), 2**15 - 1),
    "UInt16": (0, 65535),
}
RANGES |= {"Int32": (-(2**31), 2**31 - 1), "UInt32": (0, 2**32 - 1)}
RANGES |= {"Int64": (-(2**53), 2**53), "UInt64": (0, 2**53)}
TICKS = 'intervalVariability="{}" intervalDecimal="0.1" shiftDecimal="0.05"'


@pytest.fixture(scope="module")
def third(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack(tmp_path_factory.mktemp("third") / "third.fmu")


@pytest.fixture(scope="module")
def two(third: Path) -> dict[str, Path]:
    return {"A": third, "B": third}


def ball(t: float, e: float = 0.5) -> tuple[float, float, int]:
    """Height and speed of the ball, and how often it has landed."""
    v, begin, number = 0.0, 0.0, 0
    flight = math.sqrt(2.0 / G)
    h = 1.0
    while t >= begin + flight:
        v = -e * (v - G * flight)
        begin, h, number = begin + flight, 0.0, number + 1
        flight = 2.0 * v / G
    s = t - begin
    return h + v * s - 0.5 * G * s * s, v - G * s, number


def falls(result: Result, within: float = 1e-11) -> None:
    """The ball of part A is where it must be."""
    true = np.array([ball(t + 1e-12) for t in result["time"]])
    assert result["A.h"] == pytest.approx(true[:, 0], abs=within)
    assert result["A.v"] == pytest.approx(true[:, 1], abs=10 * within)


def test_all_types_go_over_wires(two: dict[str, Path]) -> None:
    kinds = [*BASES, "String", "Gear"]
    for k in (0, 1):
        start: dict[str, Any] = {f"A.{kind}_in": both[k] for kind, both in RANGES.items()}
        start |= {"A.Float32_in": 0.1, "A.Float64_in": 0.1, "A.Boolean_in": bool(k)}
        start |= {"A.String_in": "Größe", "A.Gear_in": ("low", "high")[k]}
        wires = [f"A.{kind}_out -> B.{kind}_in" for kind in kinds]
        result = run(System(two, wires, start), stop=0.3, step=0.1)
        last = dict(zip(result.names, result.data[-1]))
        for kind, both in RANGES.items():
            assert last[f"B.{kind}_out"] == both[k], kind
        assert last["B.Float32_out"] == np.float32(0.1)
        assert (last["B.Float64_out"], last["B.Boolean_out"]) == (0.1, k)
        assert last["B.Gear_out"] == (1, 5)[k]
        assert result.warnings == []


def test_what_changes_enters_by_event_mode(two: dict[str, Path]) -> None:
    """The FMU refuses discrete inputs before a step; an event is made only where one changes."""
    wires = ["A.Int8_out -> B.Int8_in", "A.Float64_out -> B.Float64_in"]
    changes = ["at 0.25 s A.Int8_in = 7", "at 0.4 s A.Boolean_in = true"]
    system = System(two, wires, {"A.e": 0.9, "A.h": 50.0, "B.h": 50.0}, changes=changes)
    result = run(system, stop=0.6, step=0.1, algorithm="gauss-seidel")
    times = [0.0, 0.1, 0.2, 0.25, 0.25, 0.3, 0.4, 0.4, 0.5, 0.6]
    assert result["time"] == pytest.approx(times, abs=1e-12)
    assert result["B.Int8_out"].tolist() == [0, 0, 0, 0, 0, 7, 7, 7, 7, 7]
    assert result["A.Boolean_out"].tolist() == [0] * 7 + [1] * 3
    assert result["B.events"].max() == 1
    assert result["A.events"].max() == 2


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_what_takes_event_mode_is_the_same_in_both_loops(
    algorithm: str, two: dict[str, Path], request: pytest.FixtureRequest
) -> None:
    """A switch and a number of one are inputs of another, which enters event mode when they change."""
    wires = ["A.Int32_out -> B.Int32_in", "A.Boolean_out -> B.Boolean_in"]
    changes = ["at 0.25 s A.Boolean_in = true", "at 0.55 s A.Int32_in = 7"]
    system = System(two, wires, {"A.h": 50.0}, changes=changes)
    record = ["B.h", "B.Int32_out", "B.Boolean_out", "B.events", "B.bounces"]
    settings: dict[str, Any] = {"stop": 1.2, "step": 0.01, "algorithm": algorithm, "record": record}
    quick = run(system, **settings)
    request.getfixturevalue("interpreted")
    slow = run(system, **settings)
    assert (quick.provenance["loop"], slow.provenance["loop"][:6]) == ("compiled", "Python")
    assert_array_equal(quick.data, slow.data)
    t = quick["time"] - 0.01 * (algorithm == "jacobi")
    assert quick["B.Boolean_out"].tolist() == (t > 0.255).tolist()
    assert quick["B.Int32_out"].tolist() == (7 * (t > 0.555)).tolist()
    assert quick["B.events"][-1] == quick["B.bounces"][-1] + 2 == 5


def test_a_number_that_a_type_cannot_hold_stops_the_run(two: dict[str, Path]) -> None:
    system = System(two, ["A.Int16_out -> B.Int8_in"], changes=["at 0.2 s A.Int16_in = 128"])
    with pytest.raises(
        SimulationError, match=r"B.Int8_in cannot take 128, which a wire brings at t"
    ):
        run(system, stop=1.0, step=0.1)
    with pytest.raises(SetupError, match=r"A.UInt8_in = 256 must be an 8-bit unsigned integer"):
        run(System(two, start={"A.UInt8_in": 256}), stop=1.0, step=0.1)


def test_types_of_both_versions_meet(third: Path, tmp_path: Path) -> None:
    parts = {"A": foreign.pack(tmp_path / "A.fmu"), "B": third}
    kinds = {"integer": "Int64", "boolean": "Boolean", "string": "String", "enumeration": "Int8"}
    wires = [f"A.{old}_out -> B.{new}_in" for old, new in kinds.items()]
    wires += ["A.y -> B.Float32_in", "B.Float32_out -> A.u"]
    start = {"A.integer_in": -7, "A.boolean_in": True, "A.string_in": "x", "A.enumeration_in": 5}
    result = run(System(parts, wires, start), stop=0.5, step=0.1)
    for column, value in (("Int64", -7), ("Boolean", 1), ("Int8", 5)):
        assert result[f"B.{column}_out"][-1] == value
    assert result["B.Float32_out"][-1] == np.float32(result["A.y"][-1])


def test_arrays_go_over_wires_together_and_by_element(two: dict[str, Path]) -> None:
    start = {f"A.Float64_ins[{i},{j}]": 10.0 * i + j for i in (1, 2) for j in (1, 2)}
    start |= {"B.Int32_ins[1,2]": 5, "B.Float32_ins[2,2]": 0.5}
    wires = ["A.Float64_outs * 2 -> B.Float64_ins", "A.Int32_out -> B.Int32_ins[2,1]"]
    wires.append("A.Float64_outs[2,1] -> B.Float32_ins[1,1]")
    changes = ["at 0.2 s A.Float64_ins[1,2] = -1", "at 0.2 s B.Int32_ins[2,2] = 9"]
    changes.append("at 0.3 s A.Int32_in = 4")
    record = ["B.Float64_outs", "B.Int32_outs", "B.Float32_outs"]
    result = run(System(two, wires, start, changes=changes), stop=0.5, step=0.1, record=record)
    assert result.names[1:5] == [f"B.Float64_outs[{i},{j}]" for i in (1, 2) for j in (1, 2)]
    assert result.data[0, 1:].tolist() == [22, 24, 42, 44, 0, 5, 0, 0, 21, 0, 0, 0.5]
    assert result.data[-1, 1:].tolist() == [22, -2, 42, 44, 0, 5, 4, 9, 21, 0, 0, 0.5]
    still = run(System(two, wires, start), stop=0.1, step=0.1, record=record)
    assert still.data[0, 1:].tolist() == result.data[0, 1:].tolist()


@pytest.mark.parametrize(
    ("wire", "start", "reason"),
    [
        ("A.Float64_outs -> B.Float64_in", {}, "2 x 2 elements cannot drive one element"),
        ("A.Float64_out -> B.Float64_ins", {}, "one element cannot drive 2 x 2 elements"),
        ("A.Binary_out -> B.Binary_in", {}, "A.Binary_out is a Binary, which wires cannot carry"),
        ("", {"A.Float64_ins": 1.0}, r"is an array of 2 x 2 elements: name one, Float64_ins\[1,1\]"),
        ("", {"A.rows": 3}, "A.rows is a structural parameter and cannot be given a start value"),
        ("", {"A.Binary_in": "no"}, "A.Binary_in = 'no' must be hexadecimal digits"),
        ("", {"A.Boolean_in": 2}, "A.Boolean_in = 2 must be true or false"),
        ("A.String_out -> B.Int8_in", {}, "String cannot drive Integer"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_a_sentence(
    wire: str, start: dict[str, Any], reason: str, two: dict[str, Path]
) -> None:
    with pytest.raises(SetupError, match=reason) as refused:
        connect(System(two, [wire] if wire else [], start))
    assert "\n" not in str(refused.value)


def test_going_back_brings_back_the_elements_of_an_array_that_no_wire_brings(third: Path) -> None:
    """An array is handed over whole, and so would be what an element becomes only later."""
    system = System({"A": third, "B": third}, ["B.Int8_out -> A.Int8_ins[1,1]"])
    network = connect(system)
    setup = Setup(network, RunSettings(1.0, 0.1, order=["B", "A"]))
    with closing(SystemInstance(setup)) as system_instance:
        system_instance.begin(setup)
        parts = system_instance.parts
        instance: Any = parts["A"].instance
        snapshot = Snapshot([*parts.values()])
        element, shown = (network.port(f"A.{n}[1,2]").variable for n in ("Int8_ins", "Int8_outs"))
        snapshot.take()
        instance.set(element, 7)
        snapshot.restore()
        instance.events.enter_inputs(parts["A"].inputs)
        assert instance.session.values([shown])["Int8_outs[1,2]"] == 0


def test_binary_values_are_hexadecimal_digits(third: Path) -> None:
    network = connect(System({"A": third}, start={"A.Binary_in": "DEAD00BEEF"}))
    setup = Setup(network, RunSettings(1.0, 0.1))
    with closing(SystemInstance(setup)) as system_instance:
        system_instance.begin(setup)
        part = system_instance.parts["A"]
        variables = [network.port(f"A.{name}_out").variable for name in ("Binary", "String")]
        assert part.instance.session.values(variables) == {
            "Binary_out": "dead00beef",
            "String_out": "grün",
        }
    with pytest.raises(SetupError, match=r"A.Binary_out is a Binary and cannot be recorded"):
        run(System({"A": third}), stop=1.0, step=0.1, record=["A.Binary_out"])


@pytest.mark.parametrize("step", [0.1, 0.037, 0.9])
@pytest.mark.parametrize("events", ["true", "false"])
def test_a_ball_bounces_where_it_lands(step: float, events: str, tmp_path: Path) -> None:
    """Steps are cut at each landing where the FMU has event mode, and go on."""
    fmu = pack(tmp_path / "ball.fmu", hasEventMode=events)
    result = run(
        System({"A": fmu}), stop=1.2, step=step, record=["A.h", "A.v", "A.bounces", "A.events"]
    )
    falls(result)
    landed = [ball(t)[2] for t in result["time"]]
    assert landed[-1] == 3
    assert result["A.bounces"].tolist() == landed
    assert result["A.events"].tolist() == (landed if events == "true" else [0] * len(landed))
    assert result.provenance["loop"] == "compiled"


def test_events_are_the_same_in_both_loops_and_after_going_back(
    third: Path, request: pytest.FixtureRequest
) -> None:
    system, record = System({"A": third}, start={"A.discard_above": 0.05}), ["A.h", "A.v"]
    pieces = run(system, stop=1.2, step=0.1, record=record)
    assert pieces.provenance["discarded"] > 0
    falls(pieces)
    system = System({"A": third})
    falls(run(system, stop=1.2, step=0.1, algorithm="iterated", record=record))
    quick = run(system, stop=1.2, step=0.1, record=record)
    request.getfixturevalue("interpreted")
    assert_array_equal(quick.data, run(system, stop=1.2, step=0.1, record=record).data)


@pytest.mark.parametrize(
    "settings",
    [
        {"step": 0.1, "algorithm": "strang"},
        {"step": 0.1, "algorithm": "jacobi"},
        {"step": Adaptive(1e-4, first=0.05)},
    ],
    ids=str,
)
def test_all_stop_at_an_event_that_a_wire_carries(
    settings: dict[str, Any], third: Path, tmp_path: Path
) -> None:
    """x' = number of landings; without a common stop each is late by up to a step."""
    parts = {"A": third, "B": foreign.pack(tmp_path / "B.fmu", a=0.0, x0=0.0)}
    landings = [k * math.sqrt(2.0 / G) for k in (1.0, 2.0, 2.5)]
    assert [ball(t + 1e-9)[2] for t in (*landings, 1.2)] == [1, 2, 3, 3]
    result = run(
        System(parts, ["A.hits -> B.u"]), stop=1.2, record=["A.h", "A.v", "B.y"], **settings
    )
    falls(result)
    true = [sum(max(0.0, t - landing) for landing in landings) for t in result["time"]]
    assert result["B.y"] == pytest.approx(true, abs=1e-5)
    if settings["step"] == 0.1:
        parts["A"] = pack(tmp_path / "stays.fmu", canGetAndSetFMUState="false")
        delayed = run(System(parts, ["A.hits -> B.u"]), stop=1.2, record=["B.y"], **settings)
        assert 0.01 < abs(true[-1] - delayed["B.y"][-1]) < 0.3


def test_rows_within_steps_are_intermediate_values_of_the_fmu(third: Path, tmp_path: Path) -> None:
    """Parabolas to the last digits, also beside a landing; without them a cubic cuts it off."""
    settings: dict[str, Any] = {
        "stop": 1.2,
        "step": 0.3,
        "output_step": 0.01,
        "record": ["A.h", "A.v"],
    }
    falls(run(System({"A": third}), **settings))
    blind = pack(tmp_path / "blind.fmu", providesIntermediateUpdate="false")
    true = [ball(t)[1] for t in np.arange(121) * 0.01]
    assert np.abs(run(System({"A": blind}), **settings)["A.v"] - true).max() > 1.0


@pytest.mark.parametrize(
    ("kind", "times"),
    [
        ("constant", [0.05 + 0.1 * k for k in range(10)]),
        ("fixed", [0.05 + 0.1 * k for k in range(10)]),
        ("tunable", [0.05, 0.15, 0.25, 0.35, 0.45, 0.7, 0.95]),
        ("countdown", [0.1]),
        ("changing", [0.05, 0.15, 0.25, 0.35, 0.45, 0.7, 0.95]),
    ],
)
@pytest.mark.parametrize("step", [0.05, 0.08])
def test_a_clock_ticks_at_its_times(
    kind: str, times: list[float], step: float, tmp_path: Path
) -> None:
    fmu = pack(tmp_path / "clock.fmu", TICKS.format(kind))
    system = System({"A": fmu}, inputs={"A.u": lambda t: 3.0 * t})
    result = run(system, stop=1.0, step=step, record=["A.ticks", "A.last_tick", "A.y"])
    for t, ticks, last, y in result.data:
        past = [tick for tick in times if tick <= t + 1e-9]
        assert ticks == len(past)
        assert last == pytest.approx(past[-1] if past else 0.0, abs=1e-12)
        assert y == pytest.approx(3.0 * last, abs=1.5 * step + 1e-9)


def test_a_sampled_value_reaches_further_parts_when_it_is_sampled(tmp_path: Path) -> None:
    """x' is 0 before the first tick, at 0.05 s and within a step, and 1 after it."""
    parts = {"A": pack(tmp_path / "clock.fmu", TICKS.format("constant"))}
    parts["B"] = foreign.pack(tmp_path / "B.fmu", a=0.0, x0=0.0)
    system = System(parts, ["A.y -> B.u"], {"A.u": 1.0})
    for algorithm in ("strang", "jacobi"):
        result = run(system, stop=0.8, step=0.08, algorithm=algorithm, record=["B.y"])
        assert result["B.y"][1:] == pytest.approx(result["time"][1:] - 0.05, abs=1e-9)


def test_clocks_that_cannot_tick_are_refused(tmp_path: Path) -> None:
    waits = pack(tmp_path / "waits.fmu", 'intervalVariability="triggered"')
    with pytest.raises(
        SetupError, match=r"A.clock is a triggered clock, which nothing here triggers"
    ):
        connect(System({"A": waits}))
    never = pack(tmp_path / "never.fmu", TICKS.format("constant"), hasEventMode="false")
    with pytest.raises(SetupError, match=r"A.clock is a clock of an FMU without event mode"):
        connect(System({"A": never}))


def test_a_refusal_keeps_the_rows_and_the_reason(third: Path) -> None:
    reason = r"A: doStep\(t = 0.3\d* s, h = 0.1\d* s\) returned Error: this FMU refuses"
    with pytest.raises(SimulationError, match=reason) as failed:
        run(System({"A": third}, start={"A.fail_at": 0.35}), stop=1.0, step=0.1, record=["A.h"])
    assert failed.value.result["time"] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_a_run_that_an_fmu_ends_is_complete(third: Path) -> None:
    result = run(System({"A": third}, start={"A.end_at": 0.35}), stop=1.0, step=0.1, record=["A.h"])
    assert result.provenance["status"] == "complete" and 0.3 < result["time"][-1] < 0.5
    assert result.provenance["reason"].startswith("A ended the simulation at t = ")


def test_what_knows_fmi_2_only_says_so(native: Path, tmp_path: Path) -> None:
    parts = {"motor": native / "DriveMotor.fmu", "conveyor": built("CrankConveyor")}
    system = System(parts, WIRES)
    for ask in (
        lambda: write_osp(system, tmp_path / "osp", step=1e-3),
        lambda: write_container(system, tmp_path / "c.fmu", step=1e-3),
    ):
        with pytest.raises(SetupError, match=r"conveyor is FMI 3.0; .* FMI 2.0 only"):
            ask()
    assert list(tmp_path.iterdir()) == []


def written(system: System, path: Path) -> Any:
    """The structure that `write_ssp` writes, by the standard."""
    write_ssp(system, path, stop=0.1)
    report = check_standard(path)
    assert report.passed, report.text()
    with ZipFile(path) as archive:
        return etree.fromstring(archive.read("SystemStructure.ssd"))


def test_a_package_with_fmi_3_is_written_as_ssp_2(two: dict[str, Path], tmp_path: Path) -> None:
    """Every type, arrays as arrays, and values beyond 32 bits come back."""
    kinds = [*BASES, "String", "Gear"]
    wires = [f"A.{kind}_out -> B.{kind}_in" for kind in kinds]
    start: dict[str, Any] = {f"A.{kind}_in": both[1] for kind, both in RANGES.items()}
    start |= {"A.Gear_in": "high", "A.String_in": "Größe"}
    system = System(two, [*wires, "A.Float64_outs -> B.Float64_ins"], start)
    root = written(system, tmp_path / "all.ssp")
    assert {each.get("version") for each in root.iter("{*}SystemStructureDescription")} == {"2.0"}
    names = {etree.QName(c[0]).localname for c in root.iter("{*}Connector")}
    older = {"Float64": "Real", "Int32": "Integer"}  # the same numbers, known to more tools
    assert names == {*(older.get(kind, kind) for kind in BASES), "String", "Enumeration"}
    connections = [
        c for c in root.iter("{*}Connection") if c.get("startConnector") == "Float64_outs"
    ]
    assert [c.get("startIndices") for c in connections] == [None]
    package = read_ssp(tmp_path / "all.ssp", tmp_path / "all")
    ours, theirs = connect(system), connect(package.system)
    assert {p.name: v for p, v in ours.start} == {p.name: v for p, v in theirs.start}
    ends = [sorted((w.source.name, w.target.name) for w in n.wires) for n in (ours, theirs)]
    assert ends[0] == ends[1]


def test_a_wire_between_single_elements_is_written_aloud(
    two: dict[str, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    wires = ["A.Float64_outs[1,2] * 2 -> B.Float64_ins[2,1]"]
    written(System(two, wires), tmp_path / "one.ssp")
    assert "A.Float64_outs -> B.Float64_ins: the indices of elements count from 1" in caplog.text
    package = read_ssp(tmp_path / "one.ssp", tmp_path / "one")
    assert [str(wire) for wire in package.system.wires] == [
        "A.Float64_outs[1,2] * 2.0 -> B.Float64_ins[2,1]"
    ]


SECOND: dict[str, tuple[str, str, str]] = {
    "size of a dimension": ('size="2"', 'sizeConnector="n"', "a Dimension without a size as a number"),
    "other size": ('size="2"/><ssc:Dimension size="2"/></ssd:Connector', 'size="3"/></ssd:Connector',
        "Float64_outs and Float64_ins have the sizes"),
    "values": ('value="1.0 ', 'value="', "Float64_ins has 3 values for 4 elements"),
    "range": ('<ssv:UInt8 value="[^"]*"', '<ssv:UInt8 value="256"', "UInt8_in = 256 is outside the range of UInt8"),
}  # fmt: skip


@pytest.mark.parametrize("name", SECOND)
def test_bad_arrays_and_values_are_refused(name: str, two: dict[str, Path], tmp_path: Path) -> None:
    pattern, new, message = SECOND[name]
    start = {"A.Float64_ins[1,1]": 1.0, "A.UInt8_in": 7}
    write_ssp(System(two, ["A.Float64_outs -> B.Float64_ins"], start), tmp_path / "a.ssp")

    def edit(files: dict[str, Any]) -> None:
        text = re.sub(r"\s*\n\s*| (?=/>)", "", str(files["SystemStructure.ssd"], "utf-8"))
        text, count = re.subn(pattern, new, text, count=1)
        assert count
        files["SystemStructure.ssd"] = text.encode()

    with pytest.raises(SetupError, match=message):
        read_ssp(rewritten(tmp_path / "a.ssp", tmp_path / "b.ssp", edit), tmp_path / "b")
