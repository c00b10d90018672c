"""The master with FMUs of anyone: every type, every capability missing, every way to fail."""

from __future__ import annotations

import json
import logging
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import platform_tuple

from cosim import (
    ALGORITHMS,
    Adaptive,
    Interrupted,
    SetupError,
    SimulationError,
    System,
    run,
    run_isolated,
)
from cosim.fmu.library import LOADED
from cosim.isolated import _error_with_rows
from cosim.scratch import MARK, _folder_of
from tests.conftest import DESCRIPTION, ROOT, described, restore_ctrl_c, rewritten
from tests.cosim.foreign import BINARY, Value, library, pack
from tests.coupling_theory import Ideal, LinearPart, Scheme

Make = Callable[..., Path]
Diary = Callable[[], list[str]]
CLOSED = ["freed A", "freed B", "terminated A", "terminated B"]
H = 0.1
EXPLICIT = ("jacobi", "gauss-seidel", "strang")
LOOPS = {"compiled": {}, "Python": {"output_step": H * 0.37}}
KINDS: dict[str, Callable[[int], float]] = {
    "integer": lambda n: n,
    "boolean": lambda n: n % 2,
    "enumeration": lambda n: (1, 2, 5)[n % 3],
    "string": lambda n: n,
}


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """A foreign FMU with these start values and capabilities."""

    def foreign(**start: Value) -> Path:
        path = tmp_path / f"{len(list(tmp_path.glob('*.fmu')))}.fmu"
        return pack(path, diary=str(tmp_path / "diary.txt"), **start)

    return foreign


@pytest.fixture
def diary(tmp_path: Path) -> Diary:
    """What the foreign FMUs noted of their ends."""
    return lambda: events(tmp_path / "diary.txt")


@pytest.fixture(autouse=True)
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of temporary files; only FMUs that are kept for the next run are left in it."""
    library()
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    _folder_of.cache_clear()
    yield folder
    clear_copies()
    assert [path for path in folder.glob("*/*") if path.name != MARK] == []
    _folder_of.cache_clear()


@pytest.fixture(autouse=True)
def loop_in_python(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """No loop in C for tests of that in Python."""
    callspec = getattr(request.node, "callspec", None)
    if callspec and callspec.params.get("loop") == "Python":
        hide_compiled_loop(monkeypatch)


def hide_compiled_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the loop in C be missing."""

    def missing() -> None:
        raise OSError("not there")

    monkeypatch.setattr("cosim.engine.loop.compiled_library", missing)


def clear_copies() -> None:
    """Let go of the FMUs that are kept for the next run."""
    for fmu in list(LOADED.values()):
        fmu.forget()


def system(parts: dict[str, Path], *wires: str, **settings: Any) -> System:
    """Parts and wires; every input that is not wired stays at its start value."""
    inputs = ("u", "integer_in", "boolean_in", "string_in", "enumeration_in")
    start = dict(zip(inputs, (0.0, 0, False, "", 1)))
    wired = {wire.split("-> ")[1] for wire in wires}
    rest = {f"{p}.{i}": start[i] for p in parts for i in inputs if f"{p}.{i}" not in wired}
    return System(parts, wires, rest | settings.pop("start", {}), **settings)


def ring(parts: dict[str, Path], **settings: Any) -> System:
    """Two parts that hear each other's y."""
    first, second = parts
    return system(parts, f"{first}.y -> {second}.u", f"{second}.y -> {first}.u", **settings)


def held(x: float, u: float, h: float, a: float = -1.0) -> float:
    """x after h of x' = a x + u with u held."""
    return x * math.exp(a * h) + u * math.expm1(a * h) / a


def events(diary: Path) -> list[str]:
    return diary.read_text().splitlines() if diary.exists() else []


def stepped(algorithm: str) -> dict[str, Any]:
    """Settings for an algorithm, or for adaptive steps of this control."""
    if algorithm in ALGORITHMS:
        return {"step": H, "algorithm": algorithm}
    return {"step": Adaptive(1e-2, first=0.01, longest=H, control=algorithm), "algorithm": "strang"}


def failed(system: System, **settings: Any) -> SimulationError:
    """The error of a run that fails on its way."""
    with pytest.raises(SimulationError) as caught:
        run(system, **settings)
    return caught.value


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("kind", KINDS)
def test_discrete_wires_are_delayed_as_they_must(kind: str, algorithm: str, make: Make) -> None:
    """What A counts comes to B and from there to C: with Jacobi one step late each.

    Strang's B and C hear A half a step before its end.
    """
    parts = {"A": make(counts=True), "B": make(), "C": make()}
    wires = [f"{a}.{kind}_out -> {b}.{kind}_in" for a, b in ("AB", "BC")]
    outputs = {p: f"{p}.spelled" if kind == "string" else f"{p}.{kind}_out" for p in "ABC"}
    start = {f"{p}.string_in": "0" for p in "A"}
    result = run(
        system(parts, *wires, start=start), stop=6 * H, step=H, algorithm=algorithm,
        record=[*outputs.values()],
    )  # fmt: skip
    begin = {"integer": 0, "boolean": 0, "enumeration": 1, "string": 0}[kind]
    per_step = 2 if algorithm == "strang" else 1
    delays = {"jacobi": (0, 1, 2), "strang": (0, 1, 1)}.get(algorithm, (0, 0, 0))
    for part, delay in zip("ABC", delays):
        counts = [per_step * n - delay for n in range(7)]
        expected = [KINDS[kind](n) if n > 0 else begin for n in counts]
        assert result[outputs[part]].tolist() == expected, part


@pytest.mark.parametrize("gear", [5, "high"])
def test_start_values_of_every_type_arrive(gear: Value, make: Make, tmp_path: Path) -> None:
    diary = tmp_path / "ä 100 %.txt"
    start: dict[str, Value] = {"A.u": 2.5, "A.integer_in": -(2**31), "A.boolean_in": True}
    start |= {"A.string_in": "12 ö", "A.enumeration_in": gear, "A.a": 0.0, "A.diary": str(diary)}
    result = run(system({"A": make()}, start=start), stop=H, step=H)
    last = {name: result[f"A.{name}"][-1] for name in ("integer_out", "boolean_out", "spelled")}
    assert last == {"integer_out": -(2**31), "boolean_out": 1, "spelled": 12}
    assert result["A.enumeration_out"].tolist() == [5, 5]
    assert result["A.y"].tolist() == [1.0, pytest.approx(1.0 + 2.5 * H, rel=1e-14)]
    assert result.provenance["parts"]["A"]["parameters"]["diary"] == str(diary)
    assert events(diary) == ["terminated A", "freed A"]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("integer_in", 2**31, "A.integer_in = 2147483648 must be a 32-bit integer"),
        ("integer_in", 10**400, "must be a 32-bit integer"),
        ("integer_in", 0.5, "A.integer_in = 0.5 must be a whole number"),
        ("boolean_in", 2, "A.boolean_in = 2 must be true or false"),
        ("integer_in", True, "A.integer_in = True must be a whole number"),
        ("boolean_in", "maybe", "A.boolean_in = 'maybe' must be true or false"),
        ("string_in", 7, "A.string_in = 7 must be of type String"),
        ("enumeration_in", 3, "A.enumeration_in = 3 must be one of 1 (low), 2 (middle), 5 (high)"),
        ("enumeration_in", "top", "A.enumeration_in = 'top' must be one of low, middle, high"),
        ("u", math.inf, "A.u = inf must be a finite number"),
    ],
)
def test_start_values_of_wrong_type_fail(name: str, value: Value, message: str, make: Make) -> None:
    with pytest.raises(SetupError, match=re.escape(message)):
        run(system({"A": make()}, start={f"A.{name}": value}), stop=H, step=H)


def test_parts_have_their_resources_times_and_tolerance(make: Make) -> None:
    """What a part is told before the start; an adaptive run hands its own tolerance over."""
    names = ("start_time", "stop_time", "stop_time_defined", "tolerance", "tolerance_defined")
    for settings, tolerance in (
        ({"step": H}, 0.0),
        ({"step": H, "tolerance": 1e-5}, 1e-5),
        ({"step": Adaptive(1e-3)}, 1e-3),
        ({"step": Adaptive(1e-3), "tolerance": 1e-7}, 1e-7),
    ):
        chain = system({"A": make(), "B": make()}, "A.token -> B.string_in", "A.y -> B.u")
        result = run(chain, start=-2.5, stop=9.0, stop_time_defined=True, **settings)
        values = [result[f"B.{name}"][-1] for name in names]
        assert values == [-2.5, 9.0, 1.0, tolerance, tolerance > 0.0]
        assert result.provenance["parts"]["B"]["tolerance"] == (tolerance or None)
    with pytest.raises(SetupError, match=r"tolerance = -1.0 must be above 0"):
        run(chain, stop=1.0, step=H, tolerance=-1.0)


def test_the_stop_time_is_passed_on_only_where_it_is_requested_or_needed(make: Make) -> None:
    """FMUs of some tools compute all up to a defined stop time in their first step."""
    ahead = system({"A": make(runs_ahead=True)})
    result = run(ahead, stop=1.0, step=H)
    assert result["A.stop_time_defined"][-1] == 0.0 and not result.warnings
    assert result["A.y"] == pytest.approx(np.exp(-result["time"]), rel=1e-13)
    result = run(ahead, stop=1.0, step=H, stop_time_defined=True)
    assert result["A.y"][1:] == pytest.approx(math.exp(-1.0), rel=1e-13)
    needs = system({"A": make(needs_stop=True, x0=3.0), "B": make()}, "A.y -> B.u")
    result = run(needs, stop=1.0, step=H)
    flags = [result[f"{name}.stop_time_defined"][-1] for name in "AB"]
    assert flags == [1.0, 0.0] and result["A.stop_time"][-1] == 1.0
    assert result["A.y"] == pytest.approx(3.0 * np.exp(-result["time"]), rel=1e-13)
    (warning,) = result.warnings
    assert "does not initialise without a stop time" in warning and "is needed" in warning
    with pytest.raises(SetupError, match="error at t = 0 s"):
        run(system({"A": make(needs_stop=True, error_at=0.0)}), stop=1.0, step=H)


def test_the_tolerance_that_an_fmu_states_is_passed_on(make: Make, tmp_path: Path) -> None:
    stated = '<DefaultExperiment tolerance="1e-4"/><ModelVariables>'
    fmu = rewritten(make(), tmp_path / "stated.fmu", described(("<ModelVariables>", stated)))
    both = system({"A": fmu, "B": make()})
    for tolerance, tolerances in ((None, [1e-4, 0.0]), (1e-7, [1e-7, 1e-7])):
        result = run(both, stop=1.0, step=H, tolerance=tolerance)
        assert [result[f"{name}.tolerance"][-1] for name in "AB"] == tolerances
        assert result.provenance["parts"]["A"]["tolerance"] == tolerances[0]


@pytest.mark.parametrize("wired", [True, False])
def test_inputs_are_set_while_initialising(wired: bool, make: Make) -> None:
    """Some FMUs insist on it, be the input wired or given as a start value."""
    parts = {"A": make(), "B": make(needs_input=True)}
    chain = system(parts, *(["A.y -> B.u"] if wired else []))
    result = run(chain, stop=H, step=H, algorithm="jacobi")
    assert result["B.y"][-1] == pytest.approx(held(1.0, float(wired), H), rel=1e-13)


@pytest.mark.parametrize(
    ("tool", "message"),
    [
        (False, "A: instantiate failed: A finds no resources at file:"),
        (True, "it needs SimTool 7 to run"),
    ],
)
def test_an_fmu_without_its_resources_or_its_tool_is_refused(
    tool: bool, message: str, make: Make, tmp_path: Path
) -> None:
    """The token comes from the resource folder; without it the FMU does not start."""
    fmu = make(needsExecutionTool=tool)
    assert len(run(system({"A": fmu}), stop=H, step=H).data) == 2
    tools = described(('modelName="', 'generationTool="SimTool 7" modelName="'))
    named = rewritten(fmu, tmp_path / "named", tools)
    bare = rewritten(named, tmp_path / "bare", lambda files: files.pop("resources/token.txt"))
    with pytest.raises(SetupError, match=message):
        run(system({"A": bare}), stop=H, step=H)


@pytest.mark.parametrize("copy", [True, False])
def test_an_fmu_that_lives_only_once_is_not_taken_twice(copy: bool, make: Make) -> None:
    fmu = make(canBeInstantiatedOnlyOncePerProcess=True)
    other = fmu.with_name("copy.fmu")
    other.write_bytes(fmu.read_bytes())
    with pytest.raises(
        SetupError, match="B: its FMU allows only one instance per process, and A is"
    ):
        run(system({"A": fmu, "B": other if copy else fmu}), stop=H, step=H)
    for _ in range(2):
        run(system({"A": fmu}), stop=H, step=H)


LONGEST = 0.04
PIECES = {False: (0.04, 0.04, 0.02), True: (0.025, 0.0375, 0.0375)}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
@pytest.mark.parametrize("stubborn", [True, False])
def test_all_take_a_step_in_pieces(stubborn: bool, algorithm: str, loop: str, make: Make) -> None:
    """A discards what is longer than it likes; B hears it and integrates piece by piece.

    A tells how far it came, a stubborn one does not and the steps are halved.
    """
    parts = {"A": make(longest_step=LONGEST, stubborn=stubborn), "B": make(x0=0.0)}
    result = run(
        system(parts, "A.y -> B.u"), stop=20 * H, step=H, algorithm=algorithm,
        record=["A.y", "B.y"], **LOOPS[loop],
    )  # fmt: skip
    pieces = PIECES[stubborn]
    units = {
        "A": LinearPart([[-1]], [[0]], [[1]], [1], [0.0]),
        "B": LinearPart([[-1]], [[1]], [[1]], [0], ["A.1"]),
    }
    expected = Ideal(units).states(Scheme(algorithm), pieces * 20)[:: len(pieces)]
    at = np.isin(result["time"].round(9), np.round(H * np.arange(21), 9))
    got = result.data[at][:, 1:] if loop == "compiled" else result.data[[0, -1]][:, 1:]
    wanted = expected if loop == "compiled" else expected[[0, -1]]
    assert got == pytest.approx(wanted, rel=1e-12, abs=1e-15)
    assert result.provenance["discarded"] > 0
    assert "discards" in result.provenance["loop"]


def test_a_part_that_took_its_steps_for_good_says_so_when_another_discards(make: Make) -> None:
    """A run that goes back only then has promised not to until then."""
    parts = {"A": make(pause_at=0.25), "B": make(commits=True)}
    with pytest.raises(SimulationError, match=r"B: SetFMUstate .* before 0\.1.* was excluded"):
        run(ring(parts), stop=1.0, step=H, algorithm="jacobi")


@pytest.mark.parametrize("algorithm", EXPLICIT)
def test_a_part_that_discards_after_the_rest_stepped_is_run_again(
    algorithm: str, make: Make
) -> None:
    """The steps since the last checkpoint are repeated, their rows and energies are not."""
    h, pause, count = 1e-3, 2.5003, 3000
    parts = {"A": make(pause_at=pause), "B": make(x0=0.0)}
    settings: dict[str, Any] = {"stop": count * h, "step": h, "algorithm": algorithm}
    result = run(ring(parts, bonds=["A.y * B.y"]), **settings)
    assert result.provenance["discarded"] > 0
    assert result["time"].tolist() == pytest.approx(h * np.arange(count + 1))
    x = {p: LinearPart([[-1]], [[1]], [[1]], [p == "A"], [f"{q}.1"]) for p, q in ("AB", "BA")}
    sizes = [h] * 2500 + [pause - 2500 * h, 2501 * h - pause] + [h] * (count - 2501)
    ideal, scheme = Ideal(x), Scheme(algorithm)
    got = [result[f"{name}.y"][-1] for name in "AB"]
    assert got == pytest.approx(ideal.states(scheme, sizes)[-1], rel=1e-11)
    given, _ = ideal.energy(scheme, sizes, ("A.1", "B.1"))
    assert result.energy["A.y * B.y"]["given"] == pytest.approx(given, rel=1e-9)
    plain = {"A": make(), "B": make(x0=0.0)}
    assert run(ring(plain), **settings).provenance["loop"] == "compiled"


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize(
    "missing", ["canGetAndSetFMUstate", "canHandleVariableCommunicationStepSize"]
)
@pytest.mark.parametrize("who", ["A", "B"])
def test_where_no_part_can_go_back_a_discarded_step_ends_the_run(
    who: str, missing: str, loop: str, make: Make, diary: Diary
) -> None:
    lacks = {name: {missing: name != who} for name in "AB"}
    parts = {"A": make(longest_step=LONGEST, **lacks["A"]), "B": make(**lacks["B"])}
    error = failed(system(parts, "A.y -> B.u"), stop=1.0, step=H, algorithm="jacobi", **LOOPS[loop])
    text = str(error)
    assert text.startswith("A: doStep(t = 0.0 s, h = 0.1 s) returned Discard: step 1 ends at t = ")
    assert "it computed up to t = 0.04 s" in text
    assert "every part must be able to restore its state and to vary its step" in text
    assert text.endswith("stopped at t = 0.0 s, 1 row kept")
    assert sorted(diary()) == CLOSED


def test_a_part_that_takes_no_step_however_short_ends_the_run(make: Make) -> None:
    parts = {"A": make(longest_step=1e-9, stubborn=True), "B": make()}
    error = failed(system(parts, "A.y -> B.u"), stop=1.0, step=H)
    assert "it takes no step from t = 0.0 s, however short; stopped at t = 0.0 s" in str(error)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("loop", LOOPS)
def test_a_warning_is_logged_once_and_recorded(
    loop: str, algorithm: str, make: Make, caplog: pytest.LogCaptureFixture
) -> None:
    parts = {"A": make(x0=0.0, warn_at=0.55), "B": make(warn_at=0.0)}
    with caplog.at_level(logging.WARNING, "cosim"):
        result = run(ring(parts), stop=1.0, step=H, algorithm=algorithm, **LOOPS[loop])
    warnings = ["B: t = 0 s in B", "A: t = 0.55 s in A"]
    assert [record.getMessage() for record in caplog.records] == warnings
    assert result.warnings == sorted(warnings)
    assert result.provenance["status"] == "complete"


STEP_RETURNED = r"A: doStep\(t = \S+ s, h = \S+ s\) returned "
ENDINGS: dict[str, tuple[str, list[str]]] = {
    "error": (rf"{STEP_RETURNED}Error: error at t = 0\.55 s, step", [CLOSED[0], *CLOSED[1::2]]),
    "fatal": (rf"{STEP_RETURNED}Fatal: A broke down at t = 0\.55 s;", CLOSED[1::2]),
}


@pytest.mark.parametrize("algorithm", [*ALGORITHMS, "doubling", "energy"])
@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("ending", ENDINGS)
def test_what_ends_meanwhile_is_named_and_the_rest_is_closed(
    ending: str, loop: str, algorithm: str, make: Make, diary: Diary, tmp_path: Path
) -> None:
    """Nothing is called on an FMU after Fatal, nor on another instance of it; the rows stay."""
    message, closed = ENDINGS[ending]
    parts = {"A": make(talks=True, **{f"{ending}_at": 0.55}), "B": make()}
    pair, path = ring(parts, bonds=["A.y * B.y"]), tmp_path / "run.csv"
    settings = stepped(algorithm)
    error = failed(pair, stop=1.0, csv=path, record=["A.y"], **settings, **LOOPS[loop])
    assert re.match(message, str(error))
    assert 0.3 < error.result.data[-1, 0] <= 0.55
    facts = json.loads((tmp_path / "run.partial.json").read_text())
    assert facts["status"] == "failed" and facts["reason"] in str(error)
    assert np.array_equal(read(tmp_path / "run.partial.csv"), error.result.data)
    assert sorted(diary()) == closed


@pytest.mark.parametrize("algorithm", [*ALGORITHMS, "doubling", "energy"])
@pytest.mark.parametrize("loop", LOOPS)
def test_a_run_that_an_fmu_ends_is_complete(
    loop: str, algorithm: str, make: Make, diary: Diary, tmp_path: Path
) -> None:
    """Of coupled parts, up to the last communication point before it."""
    parts = {"A": make(end_at=0.55), "B": make()}
    pair, path = ring(parts, bonds=["A.y * B.y"]), tmp_path / "run.csv"
    settings = stepped(algorithm)
    result = run(pair, stop=1.0, csv=path, record=["A.y"], **settings, **LOOPS[loop])
    facts = json.loads((tmp_path / "run.json").read_text())
    assert facts["status"] == result.provenance["status"] == "complete"
    assert re.match(r"A ended the simulation at t = 0\.55 s: .* the last row is", facts["reason"])
    assert 0.3 < result.data[-1, 0] <= facts["reached"] <= 0.55
    assert np.array_equal(read(path), result.data)
    assert sorted(diary()) == CLOSED


@pytest.mark.parametrize("loop", LOOPS)
def test_the_last_row_of_a_single_fmu_that_ends_is_that_of_its_end(loop: str, make: Make) -> None:
    result = run(system({"A": make(end_at=0.55)}), stop=1.0, step=H, **LOOPS[loop])
    assert result["time"][-1] == result.provenance["reached"] == pytest.approx(0.55)
    assert result["A.y"][-1] == pytest.approx(math.exp(-0.55), rel=1e-12)


@pytest.mark.parametrize("loop", LOOPS)
def test_after_fatal_no_instance_is_called(loop: str, make: Make, diary: Diary) -> None:
    fmu, other = make(), make(b=2.0)
    start = {"A.fatal_at": 0.55}
    parts = {"A": fmu, "B": fmu, "C": other}
    failed(system(parts, "A.y -> B.u", start=start), stop=1.0, step=H, **LOOPS[loop])
    assert diary() == ["terminated C", "freed C"]


@pytest.mark.parametrize("ending", ["error", "fatal", "nan"])
def test_what_breaks_while_initialising_is_refused(
    ending: str, make: Make, diary: Diary, tmp_path: Path
) -> None:
    parts = {"A": make(), "B": make(**{f"{ending}_at": 0.0})}
    reason = {
        "error": "B: exitInitializationMode: error at t = 0 s, step 0",
        "fatal": "B: exitInitializationMode: B broke down at t = 0 s",
        "nan": "B.y = nan at t = 0.0 s must be a finite number",
    }[ending]
    with pytest.raises(SetupError, match=re.escape(reason)):
        run(ring(parts), stop=1.0, step=H, csv=tmp_path / "run.csv")
    left = {"error": ["freed B", "terminated A", "freed A"], "fatal": ["terminated A", "freed A"]}
    assert diary() == left.get(ending, ["freed B", "freed A"])
    assert list(tmp_path.glob("run*")) == []


@pytest.mark.parametrize(
    ("algorithm", "wired"),
    [*product(ALGORITHMS, (True, False)), ("doubling", True), ("energy", True)],
)
@pytest.mark.parametrize("loop", LOOPS)
def test_what_is_no_number_is_named_with_its_time(
    loop: str, algorithm: str, wired: bool, make: Make, diary: Diary
) -> None:
    """Whether it comes over a wire or is recorded only."""
    parts = {"A": make(), "B": make(nan_at=0.55)}
    settings = stepped(algorithm)
    coupled = system(
        parts, "A.y -> B.u", *(["B.y -> A.u"] if wired else ["B.z -> A.u"]),
        bonds=[f"A.y * B.{'y' if wired else 'z'}"],
    )  # fmt: skip
    record = ["A.y"] if wired else ["B.y"]
    error = failed(coupled, stop=1.0, record=record, **settings, **LOOPS[loop])
    match = re.match(r"B\.y = nan at t = (\S+) s must be a finite number; ", str(error))
    assert match is not None, str(error)
    assert 0.55 <= float(match[1]) <= 0.65
    assert np.isfinite(error.result.data).all()
    assert 0.44 < error.result.data[-1, 0] < 0.55
    assert sorted(diary()) == CLOSED


STEADY, STATELESS = "canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate"


@pytest.mark.parametrize("algorithm", EXPLICIT)
@pytest.mark.parametrize("loop", LOOPS)
def test_parts_without_capabilities_run_like_parts_with_them(
    loop: str, algorithm: str, make: Make
) -> None:
    """Also in steps of one size each, be it a half or a third of the communication step."""
    settings: dict[str, Any] = {"stop": 3.0, "step": 0.3, "algorithm": algorithm}
    settings |= {"substeps": {"B": 3}, "record": ["A.y", "B.y"]} | LOOPS[loop]
    plain, *same = (
        run(ring({"A": make(x0=0.0, **less), "B": make(**less)}), **settings).data
        for less in ({}, {STEADY: False}, {STATELESS: False})
    )
    assert np.array_equal(plain, same[0]) and np.array_equal(plain, same[1])
    assert abs(plain[-1, 1] - 0.5 * (1 - math.exp(-6.0))) < 0.1


@pytest.mark.parametrize(
    ("lacks", "settings", "message"),
    [
        (STEADY, {"stop": 1.05, "step": H}, "stop = 1.05 s must be a whole number of steps of 0.1"),
        (STEADY, {"step": Adaptive(1e-3)}, "adaptive steps: B cannot vary its step"),
        (STATELESS, {"step": H, "algorithm": "iterated"}, "iterated needs the FMU state, which B c"),
        (STATELESS, {"step": Adaptive(1e-3, control="doubling")}, "doubling needs the FMU state, which B"),
        (STATELESS, {"step": Adaptive(1e-3)}, "by energy needs a power bond, and the system has none"),
    ],
)  # fmt: skip
def test_parts_that_can_do_less_are_refused_what_they_cannot(
    lacks: str, settings: dict[str, Any], message: str, make: Make
) -> None:
    parts = {"A": make(), "B": make(**{lacks: False})}
    with pytest.raises(SetupError, match=message):
        run(ring(parts), **{"stop": 1.0} | settings)


@pytest.mark.parametrize("step", [0.33333334, 0.3, 0.4])
def test_the_last_step_ends_at_the_stop_time(step: float, make: Make) -> None:
    """Some FMUs refuse to go a little beyond the stop time that they were told."""
    result = run(system({"A": make()}), stop=1.0, step=step)
    assert result["A.last_step"][-1] == pytest.approx(1.0 - result["time"][-2], rel=1e-12)
    assert result["A.y"][-1] == pytest.approx(math.exp(-1.0), rel=1e-13)


def test_parts_without_a_state_step_adaptively_by_energy(make: Make) -> None:
    parts = {"A": make(x0=0.0), "B": make(canGetAndSetFMUstate=False)}
    result = run(ring(parts, bonds=["A.y * B.y"]), stop=2.0, step=Adaptive(1e-3))
    assert result.provenance["control"] == "energy"
    assert result["A.y"][-1] == pytest.approx(0.5 * (1 - math.exp(-4.0)), abs=2e-3)
    assert len(set(np.diff(result["time"]).round(6))) > 5


EXCHANGES: dict[str, dict[str, Any]] = {
    **{f"{a}, order {n}": {"algorithm": a, "input_order": n} for a in ALGORITHMS for n in (0, 2)},
    "doubling": {"algorithm": "jacobi", "input_order": 1, "step": Adaptive(1e-3, control="doubling")},
    "energy": {"algorithm": "jacobi", "step": Adaptive(1e-2, control="energy")},
    "discarding": {"algorithm": "gauss-seidel"},
}  # fmt: skip


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("exchange", EXCHANGES)
def test_cached_and_fresh_outputs_agree(exchange: str, loop: str, make: Make, diary: Diary) -> None:
    """To the bit; and no output is read after an input was set without a step between."""
    settings = {"step": H} | EXCHANGES[exchange] | LOOPS[loop]
    longest = 0.06 if exchange == "discarding" else 1e9
    wires = ["A.z -> B.u", "B.y -> A.u", "A.integer_out -> B.integer_in"]
    runs = []
    for fresh in (False, True):
        parts = {"A": make(x0=0.0, fresh=fresh), "B": make(fresh=fresh, longest_step=longest)}
        coupled = system(parts, *wires, bonds=["A.z * B.y"], start={"A.integer_in": 4})
        runs.append(run(coupled, stop=2.0, **settings))
    first, second = runs
    assert np.array_equal(first.data, second.data)
    for part in "AB":
        assert not first[f"{part}.gets_after_set"].any()
        assert first[f"{part}.steps"][-1] >= 3
    assert abs(first["A.z"][-1] - first["A.z"][0]) > 0.1
    assert sorted(diary()) == sorted(2 * CLOSED)


def moving(make: Make, order: int, **capabilities: Value) -> tuple[System, Callable[[Any], Any]]:
    """A source that runs as t^order, what listens to it (x' = u - x), and what it must show."""
    rises = {"a": 0.0, "x0": 0.0}
    source = {"S": make(u=1.0, **rises)}
    if order == 2:
        source["P"] = make(**rises)
    last = list(source)[-1]
    wires = ["S.y -> P.u"] * (order == 2) + [f"{last}.y -> B.u"]
    parts = source | {"B": make(x0=0.0, **capabilities)}

    def exact(t: Any) -> Any:
        ramp = t - 1 + np.exp(-t)
        return ramp if order == 1 else t**2 / 2 - ramp

    return system(parts, *wires, start={"S.u": 1.0}), exact


@pytest.mark.parametrize("algorithm", [*ALGORITHMS])
@pytest.mark.parametrize("order", [1, 2])
def test_moving_inputs_are_exact_for_capable_parts(order: int, algorithm: str, make: Make) -> None:
    """A ramp or a parabola, through its derivatives; Jacobi knows it after a step or two."""
    coupled, exact = moving(make, order)
    result = run(coupled, stop=2.0, step=H, algorithm=algorithm, input_order=order, record=["B.y"])
    error = result["B.y"] - exact(result["time"])
    is_exact = order == 1 or algorithm in ("gauss-seidel", "iterated")
    if is_exact:
        assert np.abs(error).max() < 1e-13
    else:
        decay = error[1] * np.exp(-(result["time"][1:] - H))
        assert error[1:] == pytest.approx(decay, abs=1e-13)
        assert abs(error[1]) < H**3 / 2


def test_moving_inputs_know_nothing_of_a_discarded_step(make: Make) -> None:
    """B hears A on straight lines between the ends of the pieces that it accepts."""
    parts = {"A": make(maxOutputDerivativeOrder=0), "B": make(x0=0.0, longest_step=LONGEST)}
    result = run(
        system(parts, "A.y -> B.u"), stop=1.0, step=H, algorithm="gauss-seidel", input_order=1,
        record=["B.y"],
    )  # fmt: skip
    t, x, expected = 0.0, 0.0, [0.0]
    for _ in range(10):
        for h in PIECES[False]:
            u, slope = math.exp(-t), (math.exp(-t - h) - math.exp(-t)) / h
            x, t = held(x, u, h) + slope * (h + math.expm1(-h)), t + h
        expected.append(x)
    assert result["B.y"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_moving_inputs_are_means_for_other_parts(order: int, make: Make) -> None:
    """x' = u - x with the mean of the source over each step."""
    coupled, exact = moving(make, order, canInterpolateInputs=False)
    result = run(
        coupled, stop=2.0, step=H, algorithm="gauss-seidel", input_order=order, record=["B.y"]
    )
    x, expected = 0.0, [0.0]
    for n in range(20):
        a, b = n * H, (n + 1) * H
        mean = (b ** (order + 1) - a ** (order + 1)) / (order * (order + 1)) / H
        x = held(x, mean, H)
        expected.append(x)
    assert result["B.y"] == pytest.approx(expected, rel=1e-12)
    assert 1e-5 < np.abs(result["B.y"] - exact(result["time"])).max() < 1e-2


@pytest.mark.parametrize(("derivative_order", "is_delayed"), [(0, True), (1, False)])
def test_output_derivatives_serve_the_first_step(
    derivative_order: int, is_delayed: bool, make: Make
) -> None:
    """Without them, Jacobi can but hold the ramp's first value over the first step."""
    source = make(a=0.0, x0=0.0, u=1.0, maxOutputDerivativeOrder=derivative_order)
    parts = {"S": source, "B": make(a=0.0, x0=0.0)}
    coupled = system(parts, "S.y -> B.u", start={"S.u": 1.0})
    result = run(coupled, stop=1.0, step=H, algorithm="jacobi", input_order=1, record=["B.y"])
    missing = result["time"] ** 2 / 2 - result["B.y"]
    expected = H**2 / 2 if is_delayed else 0.0
    assert missing[1:] == pytest.approx(np.full(10, expected), abs=1e-15)


@pytest.mark.parametrize("algorithm", ["iterated", "doubling", "jacobi"])
def test_every_state_is_freed(algorithm: str, make: Make, diary: Diary) -> None:
    parts, record = {"A": make(x0=0.0), "B": make()}, ["A.live_states", "A.restores"]
    result = run(ring(parts), stop=2.0, record=record, **stepped(algorithm))
    assert 0 < result["A.live_states"].max() <= 3
    assert sorted(diary()) == CLOSED


FMI1 = """<fmiModelDescription fmiVersion="1.0" modelName="foreign" modelIdentifier="foreign"
 guid="{1}" numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables/><Implementation>
<CoSimulation_StandAlone><Capabilities/></CoSimulation_StandAlone></Implementation>
</fmiModelDescription>"""
FMI3 = """<fmiModelDescription fmiVersion="3.0" modelName="foreign" instantiationToken="{1}">
<CoSimulation modelIdentifier="foreign"/>
<ModelVariables><Float64 name="time" valueReference="0" causality="independent"/></ModelVariables>
<ModelStructure/></fmiModelDescription>"""
EVERYTHING = r"(?s)\A.*\Z"
EXCHANGE = ("<CoSimulation.*?/>", '<ModelExchange modelIdentifier="foreign"/>')
REFUSED: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "FMI 1.0": (described((EVERYTHING, FMI1)), "is FMI 1.0; this master runs co-simulation by FMI 2.0"),
    "no binary of FMI 3.0": (described((EVERYTHING, FMI3)), f"has no binary for this platform, binaries/{platform_tuple}/foreign"),
    "model exchange only": (described(EXCHANGE), "offers model exchange only; this master runs co-simulation by FMI 2.0 and 3.0: export it"),
    "wrong GUID": (described(("guid=.*?}", 'guid="{1}')), "A: instantiate failed: the GUID {1} is not {"),
    "no binary": (lambda files: files.update({"binaries/win32/foreign.dll": files.pop(BINARY)}), f"has no binary for this platform, {BINARY}; it is for win32"),
    "no library": (lambda files: files.update({BINARY: b"no library"}), "A: Failed to load shared library"),
    "no description": (lambda files: files.pop(DESCRIPTION), "is not a valid FMU: it has no modelDescription.xml"),
    "malformed XML": (described(("</ModelVariables>", "")), "is not a valid FMU: modelDescription.xml is not XML: Opening and ending tag mismatch"),
    "two of a name": (described(('name="integer_in"', 'name="u"')), "it has two variables named u"),
}  # fmt: skip
DAMAGED: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "truncated": (lambda data: data[: len(data) // 2], "is not a valid FMU: it cannot be opened as a zip file: File is not a zip file"),
    "flipped": (lambda data: data.replace("grün".encode(), b"green"), "A.fmu cannot be unpacked: "),
    "no file": (lambda _: b"", "there is no file"),
}  # fmt: skip


def spoiled(path: Path, defect: str) -> tuple[Path, str]:
    """An FMU with a defect of REFUSED or DAMAGED, and what is said of it."""
    intact = pack(path.with_suffix(".whole"))
    if defect in REFUSED:
        edit, message = REFUSED[defect]
        return rewritten(intact, path, edit), message
    damage, message = DAMAGED[defect]
    if data := damage(rewritten(intact, path, lambda _: None).read_bytes()):
        path.write_bytes(data)
    else:
        path.unlink()
    return path, message


@pytest.mark.parametrize("defect", [*REFUSED, *DAMAGED])
def test_what_is_no_fmu_says_why(
    defect: str, make: Make, diary: Diary, tmp_path: Path, scratch: Path
) -> None:
    folder = Path.cwd()
    fmu, message = spoiled(tmp_path / "A.fmu", defect)
    parts = {"B": make(), "A": fmu}
    with pytest.raises(SetupError) as caught:
        run(system(parts), stop=1.0, step=H)
    text = str(caught.value)
    assert message in text
    assert re.match("part A: .*A.fmu |A: |part A: there", text)
    assert "\n" not in text
    assert Path.cwd() == folder
    assert diary() in ([], ["freed B"])
    clear_copies()
    loaded = Path("/proc/self/maps")
    assert not loaded.exists() or str(scratch) not in loaded.read_text()


def read(path: Path) -> Any:
    """The rows of a CSV file."""
    return np.array([row.split(",") for row in path.read_text().splitlines()[1:]], dtype=float)


def test_an_isolated_run_is_the_same_run(
    make: Make, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """To the bit; its progress and its warnings come over."""
    coupled = ring({"A": make(x0=0.0, warn_at=1.0), "B": make()}, bonds=["A.y * B.y"])
    shares: list[float] = []
    settings: dict[str, Any] = {"stop": 100.0, "step": H, "output_step": 0.03}
    plain = run(coupled, **settings)
    caplog.clear()
    result = run_isolated(coupled, csv=tmp_path / "run.csv", progress=shares.append, **settings)
    assert np.array_equal(result.data, plain.data)
    assert (result.names, result.units) == (plain.names, plain.units)
    assert result.energy == plain.energy
    assert [record.getMessage() for record in caplog.records] == ["A: t = 1 s in A"]
    assert shares == sorted(shares)
    assert len(shares) > 1
    assert shares[-1] == 1.0
    assert sorted(path.name for path in tmp_path.glob("run*")) == ["run.csv", "run.json"]


@pytest.mark.parametrize(
    ("loop", "ending", "says"),
    [
        ("compiled", "crash", "was killed by signal SIGSEGV (an FMU crashed)"),
        ("Python", "exit", "ended with exit code 3 (an FMU ended it)"),
    ],
)
def test_an_fmu_that_ends_its_process_leaves_the_rows(
    ending: str, says: str, loop: str, make: Make, tmp_path: Path
) -> None:
    """All but those of the last moment, in a file that says what happened."""
    path, h, at = tmp_path / "run.csv", 1e-3, {"compiled": 200.0, "Python": 30.0}[loop]
    parts = {"A": make(**{f"{ending}_at": at}), "B": make(x0=0.5)}
    settings: dict[str, Any] = {"step": h, "record": ["A.y", "B.y"], "algorithm": "jacobi"}
    settings |= {"output_step": 2.5 * h} if loop == "Python" else {}
    with pytest.raises(SimulationError) as caught:
        run_isolated(ring(parts), csv=path, stop=2 * at, **settings)
    rows = read(tmp_path / "run.partial.csv")
    reached = float(rows[-1, 0])
    assert str(caught.value) == (
        f"the process that ran the parts A, B {says} after t = {reached!r} s, "
        f"{len(rows)} rows in run.partial.csv"
    )
    assert 0.0 < reached < at
    facts = json.loads((tmp_path / "run.partial.json").read_text())
    assert (facts["status"], facts["reached"]) == ("failed", reached)
    assert facts["reason"] in str(caught.value)
    assert facts["parts"]["A"]["parameters"][f"{ending}_at"] == at
    assert np.array_equal(caught.value.result.data, rows)
    assert caught.value.result.energy == {}
    short = run(ring(parts), stop=round(rows[9, 0] + 5 * h, 4), **settings)
    assert np.array_equal(short.data[:10], rows[:10])


def test_an_fmu_that_dies_immediately_leaves_present_files(make: Make, tmp_path: Path) -> None:
    (tmp_path / "run.partial.csv").write_text("an earlier run")
    (tmp_path / "run.partial.json").write_text("{}")
    parts = {"A": make(crash_at=0.0)}
    with pytest.raises(SetupError, match=r"SIGSEGV \(an FMU crashed\) before the first step"):
        run_isolated(system(parts), csv=tmp_path / "run.csv", stop=1.0, step=H)
    assert (tmp_path / "run.partial.csv").read_text() == "an earlier run"


@pytest.mark.parametrize("fails", [True, False])
def test_an_fmu_may_end_its_process_at_the_close(fails: bool, make: Make, tmp_path: Path) -> None:
    """The rows are complete, or as far as the run came; what failed first is said first."""
    parts = {"A": make(crash_at_end=True, nan_at=0.55 if fails else 9.0)}
    with pytest.raises(SimulationError) as caught:
        run_isolated(system(parts), csv=tmp_path / "run.csv", stop=1.0, step=H, record=["A.y"])
    text, dead = str(caught.value), "the process that ran the parts A was killed by signal SIGSEGV"
    if fails:
        assert text.startswith(f"A.y = nan at t = 0.6 s must be a finite number; {dead}")
        assert text.endswith("after t = 0.5 s, 6 rows in run.partial.csv")
    else:
        assert text.startswith(f"{dead} (an FMU crashed) when it closed them after t = 1.0 s")
    facts = caught.value.result.provenance
    assert facts["status"] == ("failed" if fails else "complete")
    assert len(caught.value.result.data) == (6 if fails else 11)


def test_errors_of_an_isolated_run_are_those_of_a_run(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    with pytest.raises(SetupError, match="'euler' must be one of"):
        run_isolated(system({"A": make()}), csv=path, stop=1.0, step=H, algorithm="euler")
    assert list(tmp_path.glob("run*")) == []
    broken = system({"A": make(error_at=0.55)})
    with pytest.raises(SimulationError, match=r"A: doStep.*error at t = 0.55 s") as caught:
        run_isolated(broken, csv=path, stop=1.0, step=H)
    assert len(caught.value.result.data) == 6
    assert caught.value.result.provenance["status"] == "failed"


def test_a_row_that_was_being_written_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "run.partial.csv"
    path.write_text("time,A.y\n0.0,1.0\n0.5,2.0\n1.")
    path.with_suffix(".json").write_text('{"status": "running", "start": 0.0, "units": {}}')
    error = _error_with_rows(path, "killed", ["A: hot"], pressed=True)
    assert str(error) == "killed after t = 0.5 s, 2 rows in run.partial.csv"
    assert isinstance(error, Interrupted)
    assert error.result.warnings == ["A: hot"]
    assert error.result.data.tolist() == [[0.0, 1.0], [0.5, 2.0]]


def test_rows_reach_their_file_while_a_run_goes_on(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However few there are, and with the facts of a run that is not over."""
    hide_compiled_loop(monkeypatch)
    row_counts: list[int] = []

    def progress(share: float) -> None:
        time.sleep(0.06)
        facts = json.loads((tmp_path / "run.partial.json").read_text())
        assert facts["status"] == "running"
        row_counts.append(len(read(tmp_path / "run.partial.csv")))

    fine = {"record": ["A.y"], "output_step": H / 2, "csv": tmp_path / "run.csv"}
    run(system({"A": make()}), stop=1.0, step=H, progress=progress, **fine)
    assert row_counts[-1] >= 10
    assert sorted(path.name for path in tmp_path.glob("run*")) == ["run.csv", "run.json"]


def test_an_error_of_the_caller_ends_an_isolated_run(
    make: Make, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def progress(share: float) -> None:
        raise ZeroDivisionError

    path = tmp_path / "run.csv"
    with pytest.raises(ZeroDivisionError):
        run_isolated(system({"A": make()}), csv=path, stop=1e9, step=H, progress=progress)
    facts = json.loads((tmp_path / "run.partial.json").read_text())
    assert facts["status"] == "failed"
    assert len(read(tmp_path / "run.partial.csv")) > 1
    assert "Traceback" not in capfd.readouterr().err


SCRIPT = """
import os, signal, sys
from pathlib import Path
from cosim import System, child, run_isolated

FMU, CSV, DIARY, WHOM, *DUE = sys.argv[1:]
PARTIAL, send = Path(CSV).with_suffix(".partial.csv"), os.killpg if WHOM == "all" else os.kill
IS_DUE = {"early": lambda: True, "rows": lambda: PARTIAL.exists() and PARTIAL.stat().st_size,
          "hangs": lambda: Path(DIARY).exists() and "hangs A" in Path(DIARY).read_text()}
look = child.wait

def look_and_interrupt(*arguments):
    if DUE and IS_DUE[DUE[0]]():
        DUE.pop(0)
        send(os.getpid(), signal.SIGINT)
    return look(*arguments)

if __name__ == "__main__":
    child.wait = look_and_interrupt
    start = {"A.u": 0.0, "A.integer_in": 0, "A.boolean_in": False, "A.string_in": "",
             "A.enumeration_in": 1}
    run_isolated(System({"A": Path(FMU)}, (), start), csv=Path(CSV), stop=1e7, step=0.1,
                 output_step=0.25, record=["A.y"])
"""


@pytest.mark.parametrize(
    ("whom", "due"), [("all", ["early"]), ("parent", ["rows"]), ("all", ["hangs", "early"])]
)
def test_ctrl_c_ends_an_isolated_run(
    whom: str, due: list[str], make: Make, tmp_path: Path, scratch: Path
) -> None:
    """Be it heard by all processes or by the first, which sends it to itself as it looks at its child; one that hangs takes a second."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    hangs = "hangs" in due
    files = [make(hang_at=3e3 if hangs else 1e300), tmp_path / "run.csv", tmp_path / "diary.txt"]
    done = subprocess.run(
        [sys.executable, script, *files, whom, *due], start_new_session=True, capture_output=True,
        check=False, text=True, timeout=600, preexec_fn=restore_ctrl_c,
        env=os.environ | {"TMPDIR": str(scratch), "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stderr.count("Traceback") == 1, done.stderr
    said = "killed by signal SIGKILL" if hangs else "interrupted by the user; stopped at"
    assert said in done.stderr
    facts = json.loads((tmp_path / "run.partial.json").read_text())
    assert facts["status"] == "interrupted"
    rows = read(tmp_path / "run.partial.csv")
    assert facts["reached"] == rows[-1, 0]
    assert len(rows) > ("rows" in due)
