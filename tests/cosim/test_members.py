"""Members of an ensemble have the rows of single runs, bit for bit, whatever happens to the others."""

from __future__ import annotations

import os
import signal
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cosim import Adaptive, Interrupted, Series, SetupError, SimulationError, System, run
from cosim.engine.settings import RunSettings
from cosim.engine.snapshot import Case
from cosim.engine.system_instance import KNOWN_TOOLS
from cosim.ensemble import Ensemble
from cosim.metrics import Largest
from cosim.prepared import Prepared
from tests.cosim.foreign import pack, single_fmu_system

WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
H = 1e-3
#: What is varied of the settings, and of what is run.
FACTORS: dict[str, Sequence[Any]] = {
    "system": ("pair", "motor alone", "table", "jump", "change"),
    "algorithm": ("strang", "jacobi", "gauss-seidel", "iterated"),
    "input_order": (0, 1, 2),
    "flavour": ("native", "fmi3", ""),
    "step": (H, Adaptive(1e-2)),
    "output_step": (None, 4 * H, 0.7 * H),
    "jobs": (1, 2),
}


def pairwise(
    factors: Mapping[str, Sequence[Any]],
    is_possible: Callable[[dict[str, Any]], bool] = lambda _: True,
) -> list[dict[str, Any]]:
    """Possible combinations in which each pair of two factors' values is there at least once, if it can be."""
    numbers: dict[Any, int] = {}
    pairs_of = []
    for row in product(*(enumerate(values) for values in factors.values())):
        choice = {name: value for name, (_, value) in zip(factors, row)}
        if is_possible(choice):
            pairs = combinations([(name, k) for name, (k, _) in zip(factors, row)], 2)
            numbered = (numbers.setdefault(pair, len(numbers)) for pair in pairs)
            pairs_of.append((sum(1 << n for n in numbered), choice))
    chosen, missing = [], (1 << len(numbers)) - 1
    while missing:
        pairs, choice = max(pairs_of, key=lambda row: (row[0] & missing).bit_count())
        chosen.append(choice)
        missing &= ~pairs
    return chosen


def drive(folder: Path, kind: str) -> System:
    """Motor and conveyor, or one of them with an input over time."""
    motor, conveyor = folder / "DriveMotor.fmu", folder / "CrankConveyor.fmu"
    if kind == "motor alone":
        return System({"motor": motor}, start={"motor.w": 40.0})
    start = {"motor.A": 8000.0, "motor.tau": 8.0, "conveyor.w": 40.0}
    parts = {"motor": motor, "conveyor": conveyor}
    if kind == "pair":
        return System(parts, WIRES, start)
    start.pop("motor.tau")
    if kind == "change":
        return System(
            parts, WIRES[1:], start | {"conveyor.tau": 9.0}, changes=["at 0.02 s conveyor.tau = 5"]
        )
    times = [0.0, 0.0203, 0.0203, 0.1] if kind == "table" else [0.0, 0.02, 0.02, 0.1]
    return System(
        parts,
        WIRES[1:],
        start,
        inputs={"conveyor.tau": Series.of({"t": times, "tau": [8.0, 20.0, 3.0, 8.0]})},
    )


@pytest.mark.parametrize("choice", pairwise(FACTORS), ids=lambda c: " ".join(map(str, c.values())))
def test_members_have_the_bits_of_single_runs(choice: dict[str, Any], fmus: Path) -> None:
    """Each pair of choices once; the last step is cut, and the start is not 0."""
    settings = {
        k: v for k, v in choice.items() if k in ("algorithm", "input_order", "step", "output_step")
    }
    settings |= {"start": 0.01, "stop": 0.0405}
    system = drive(fmus / choice["flavour"], choice["system"])
    cases = {"motor.A": [7500.0, 8000.0, 8500.0], "motor.characteristic": [0, 0, 0]}
    if "conveyor" in system.parts:
        cases |= {"conveyor.w": [39.0, 40.0, 41.0], "conveyor.rod.finite": [True, False, True]}
    with Prepared.open(system, RunSettings(**settings)) as prepared:
        ensemble = prepared.map(cases, jobs=choice["jobs"])
    assert bool(ensemble.notes) == (choice["flavour"] == "")
    for k in range(3):
        start = {**system.start, **{name: column[k] for name, column in cases.items()}}
        try:
            single = run(System(**vars(system) | {"start": start}), **settings)
        except SimulationError as error:
            assert ensemble.reasons[k] in str(error) and ensemble.reasons[k]
            single = error.result
        rows = ensemble.rows[k, : ensemble.counts[k]]
        assert rows.tobytes() == single.data.tobytes()
        assert_array_equal(ensemble.rows[k, ensemble.counts[k] :], np.nan)
        assert ensemble.result(k).data.tobytes() == single.data.tobytes()
        assert ensemble.result(k).energy == single.energy
        for bond, energy in single.energy.items():
            assert list(ensemble.runs[k].energy[bond]) == [
                energy[key] for key in ("given", "taken", "exchanged")
            ]


def ensemble_of(
    system: System, cases: Mapping[str, Any], *, jobs: int = 1, **settings: Any
) -> Ensemble:
    """The ensemble of a system over one second, in steps of 0.1 s."""
    with Prepared.open(system, RunSettings(**{"stop": 1.0, "step": 0.1} | settings)) as prepared:
        return prepared.map(cases, jobs=jobs)


@pytest.mark.parametrize("flavour", ["native", "fmi3"])
def test_what_begins_again_has_the_bits_of_new_instances(flavour: str, fmus: Path) -> None:
    """Of every FMU that is built here, after a run with other start values, and of one that failed to begin."""
    for path in sorted((fmus / flavour).glob("*.fmu")):
        system = System({"part": path})
        settings = RunSettings(0.05, H)
        with Prepared.open(system, settings) as prepared:
            start = {
                port.name: 1.01 * float(port.variable.start or 0.0)
                for v in prepared.network.descriptions["part"].modelVariables
                if v.causality == "parameter" and v.type == "Real"
                for port in [prepared.network.port(f"part.{v.name}")]
            }
            with suppress(SetupError, SimulationError):
                prepared.run(Case(start))
            again = prepared.run()
        single = run(system, stop=0.05, step=H)
        assert again.data.tobytes() == single.data.tobytes(), path.name
        facts = {"parts", "warnings", "bonds", "start_values"}
        assert {k: again.provenance[k] for k in facts} == {k: single.provenance[k] for k in facts}


@pytest.mark.parametrize("name", ["warn_at", "error_at", "fatal_at", "nan_above"])
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_member_that_fails_is_a_row_with_its_reason(name: str, jobs: int, tmp_path: Path) -> None:
    """The others go on, also after an FMU has returned Fatal; warnings carry the member."""
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    usual = 1e300
    at = 0.05 if name == "nan_above" else 0.35
    cases = {f"A.{name}": [usual, at, usual, at, usual], "A.x0": [1.0, 2.0, 3.0, 4.0, 5.0]}
    ensemble = ensemble_of(system, cases, jobs=jobs)
    assert ensemble.members.tolist() == [0, 1, 2, 3, 4]
    for k in range(5):
        start = {key: column[k] for key, column in cases.items()}
        try:
            single = run(System(system.parts, start=start), stop=1.0, step=0.1)
            assert not ensemble.reasons[k]
        except SimulationError as error:
            single = error.result
            assert ensemble.reasons[k]
        count = ensemble.counts[k]
        assert ensemble.rows[k, :count].tobytes() == single.data.tobytes()
    if name == "warn_at":
        assert ensemble.warnings == {"A: t = 0.35 s in A": [1, 3]}
    else:
        assert ensemble.failed.tolist() == [1, 3]


def test_a_crash_costs_one_member(tmp_path: Path) -> None:
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    cases = {"A.crash_at": [1e300, 0.35, 1e300], "A.x0": [1.0, 2.0, 3.0]}
    ensemble = ensemble_of(system, cases, jobs=2)
    assert ensemble.failed.tolist() == [1]
    assert "was killed by signal SIGSEGV (an FMU crashed)" in ensemble.reasons[1]
    assert ensemble["A.y"][[0, 2], 0].tolist() == [1.0, 3.0]


def test_a_start_value_that_cannot_be_is_a_reason(fmus: Path) -> None:
    cases = {"motor.T": [0.05, -1.0, 0.06, np.nan, 0.06]}
    for jobs in (1, 2):
        ensemble = ensemble_of(drive(fmus / "native", "pair"), cases, stop=0.01, step=H, jobs=jobs)
        assert ensemble.failed.tolist() == [1, 3]
        assert "motor.T [s] = -1.0 must be" in ensemble.reasons[1]
        assert "must be a finite number" in ensemble.reasons[3]


@pytest.mark.parametrize("jobs", [1, 2])
def test_no_reset_of_an_fmu_of_another_tool_is_trusted(jobs: int, tmp_path: Path) -> None:
    """The first reset brings back its start, as a trial shows, and the second does not, as it cannot show."""
    system = single_fmu_system(pack(tmp_path / "A.fmu", wears=True))
    cases = {"A.x0": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}
    ensemble = ensemble_of(system, cases, jobs=jobs, record=["A.y"])
    assert ensemble["A.y"][:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert "new instances" in ensemble.notes[0]


@pytest.mark.parametrize(
    ("cases", "reason"),
    [
        ({"motor.Z": [1.0]}, "motor has no variable 'Z'"),
        ({"motor.A": [1.0, 2.0], "motor.T": [1.0]}, "columns of one length"),
        ({"motor.A": []}, "there are no cases"),
        ({}, "columns of one length"),
        ({"motor.A": [[1.0]]}, "columns of one length"),
    ],
)
def test_wrong_cases_are_refused(cases: dict[str, Any], reason: str, fmus: Path) -> None:
    with pytest.raises(SetupError, match=reason):
        ensemble_of(drive(fmus / "native", "motor alone"), cases)


def test_figures_and_frames(fmus: Path) -> None:
    cases = {"motor.A": [7500.0, 8000.0, np.nan]}
    ensemble = ensemble_of(drive(fmus / "native", "pair"), cases, stop=0.1, step=H)
    frame = ensemble.frame({"torque": Largest("motor.tau")})
    assert list(frame) == ["motor.A", "torque", "reason"] and np.isnan(frame["torque"][2])
    assert frame["torque"][0] >= ensemble["motor.tau"][0].max()


@pytest.fixture
def ctrl_c_is_heard() -> Iterator[None]:
    """Ctrl-C is a signal to this process although the tests may run where it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c_is_heard")
def test_ctrl_c_keeps_what_is_done(fmus: Path) -> None:
    """It is heard within the C loop, which returns every 50 ms."""
    pressed: list[float] = []

    def press(share: float) -> None:
        if share > 0.0 and not pressed:
            pressed.append(share)
            os.kill(os.getpid(), signal.SIGINT)

    settings = RunSettings(1.0, 1e-4, output_step=0.1)
    with (
        Prepared.open(drive(fmus / "native", "pair"), settings) as prepared,
        pytest.raises(Interrupted) as caught,
    ):
        prepared.map({"motor.A": np.linspace(7000.0, 8000.0, 2000)}, progress=press)
    done: Ensemble = caught.value.result
    assert 0 < len(done) < 2000 and not len(done.failed)


def writable(binary: bytes) -> int:
    """The bytes of a 64-bit ELF library that may be written after it has been loaded and relocated."""
    begin, size, count = (
        *struct.unpack_from("<Q", binary, 0x20),
        *struct.unpack_from("<HH", binary, 0x36),
    )
    headers = [struct.unpack_from("<IIQQQQQQ", binary, begin + k * size) for k in range(count)]
    load, relocated, writes = 1, 0x6474E552, 2
    spans = [(h[3], h[3] + h[6]) for h in headers if h[0] == load and h[1] & writes]
    fixed = [(h[3], h[3] + h[6]) for h in headers if h[0] == relocated]
    return sum(
        end - begin - sum(max(0, min(end, e) - max(begin, b)) for b, e in fixed)
        for begin, end in spans
    )


def native_binaries(fmus: Path) -> Iterator[tuple[str, str, bytes]]:
    """Name, tool and binary of each native FMU."""
    for path in [*(fmus / "native").glob("*.fmu"), *(fmus / "fmi3").glob("*.fmu")]:
        with ZipFile(path) as archive:
            description = archive.read("modelDescription.xml").decode()
            for name in archive.namelist():
                if name.endswith(".so") and ("linux64" in name or "x86_64-linux" in name):
                    yield name, description, archive.read(name)


def test_fmus_that_may_run_in_threads_have_no_variables_of_their_own(fmus: Path) -> None:
    """What is written would be shared by instances in several threads."""
    binaries = list(native_binaries(fmus))
    assert len(binaries) >= 10  # of this machine, in FMI 2.0
    for name, description, binary in binaries:
        assert f'generationTool="{KNOWN_TOOLS[0]}' in description
        assert writable(binary) == 0, name


def test_wrong_steps_and_stops_are_refused(fmus: Path) -> None:
    settings = RunSettings(0.1, H, output_step=4 * H)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"stops": [0.1] * 3}, "3 stops for 2 cases"),
        ({"stops": [0.1, 0.0]}, "must be after start"),
        ({"steps": [H, 3 * H]}, "rows must be a multiple of it apart"),
    ]
    with Prepared.open(drive(fmus / "native", "pair"), settings) as prepared:
        for varied, reason in wrong:
            with pytest.raises(SetupError, match=reason):
                prepared.map(2, **varied)
        for jobs in (0, -1):
            with pytest.raises(SetupError, match="must be at least 1"):
                prepared.map(2, jobs=jobs)


def test_warnings_of_bonds_are_of_the_members_whose_runs_have_them(fmus: Path) -> None:
    system, steps = drive(fmus / "native", "pair"), [2e-3, 2e-4, 1e-3, 2e-3]
    settings: dict[str, Any] = {"stop": 0.5, "algorithm": "jacobi"}
    plan = RunSettings(step=2e-3, output_step=2e-3, **settings)
    with Prepared.open(replace(system, start={}), plan) as prepared:
        ((text, members),) = prepared.map(4, steps=steps).warnings.items()
    assert "created or removed" in text
    runs = [run(replace(system, start={}), step=step, **settings) for step in steps]
    assert members == [k for k, result in enumerate(runs) if result.warnings] == [0, 3]
