"""A run that begins with the state of a paused one is the rest of the run in one go, bit for bit."""

from __future__ import annotations

import math
import pickle
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cosim import (
    Adaptive,
    Case,
    Prepared,
    RunSettings,
    Series,
    SetupError,
    SimulationError,
    System,
)
from cosim.ensemble import Cases, joined
from cosim.prepared import How
from tests.cosim import foreign, third
from tests.cosim.test_anyone import hide_compiled_loop
from tests.cosim.test_members import WIRES, H, drive, pairwise

#: What is varied of the settings, and of what is run.
FACTORS: dict[str, Sequence[Any]] = {
    "system": ("pair", "motor alone", "table", "jump", "change", "kilo"),
    "algorithm": ("strang", "jacobi", "gauss-seidel", "iterated"),
    "input_order": (0, 1, 2),
    "flavour": ("native", "fmi3", ""),
    "step": (H, 4 * H, Adaptive(1e-2), Adaptive(1e-2, control="energy")),
    "more": ({}, {"output_step": 4 * H}, {"substeps": {"motor": 3}}),
    "until": (0.02, 0.0203, 0.035),
}
LIFE = ("steps", "restores", "live_states", "gets_after_set")
CLOCK = 'intervalVariability="changing" intervalDecimal="0.1" shiftDecimal="0.05"'


def require_rest(
    prepared: Prepared, until: float, copy: Callable[[Any], Any], *, but: Sequence[str] = ()
) -> None:
    """A paused run and its rest have the rows and the energy of one run, but for these columns."""
    whole, (first, state) = prepared.run(), prepared.run_until(until)
    rest = prepared.run(Case(begin=copy(state)))
    assert until <= state.time == first["time"][-1] == rest["time"][0]
    compared = [name for name in whole.names if name.partition(".")[2] not in but]
    rows = np.concatenate([first.frame[compared], rest.frame[compared][1:]])
    own = rest.data[0] == first.data[-1]
    assert own[[name in compared for name in whole.names]].all()
    if prepared.setup.settings.output_step is not None:
        rows = rows[np.isin(rows[:, 0], whole["time"])]
    assert_array_equal(rows, whole.frame[compared])
    assert rest.energy == whole.energy
    breaks = [*first.breaks.tolist(), *rest.breaks.tolist()]
    joints = [k for k, pair in enumerate(breaks[1:]) if breaks[k][1] == pair[0] == state.time]
    for k in reversed(joints):
        breaks[k : k + 2] = [[breaks[k][0], breaks[k + 1][1]]]
    assert breaks == whole.breaks.tolist()
    steps = [result.provenance["steps"] for result in (first, rest, whole)]
    assert steps[0] + steps[1] == steps[2] and min(steps) > 0


def of_kind(folder: Path, kind: str) -> System:
    """A system of `drive`, or the pair with a wire that has a factor and an offset."""
    if kind != "kilo":
        return drive(folder, kind)
    pair = drive(folder, "pair")
    return replace(pair, wires=["motor.tau * 0.5 + 2 -> conveyor.tau", WIRES[1]])


def is_possible(choice: dict[str, Any]) -> bool:
    """Rows lie at steps, and what follows energy has a bond."""
    step = choice["step"]
    if not isinstance(step, Adaptive):
        return True
    has_bond = choice["system"] == "pair"
    return "output_step" not in choice["more"] and (step.control is None or has_bond)


@pytest.mark.parametrize(
    "choice",
    pairwise(FACTORS, is_possible),
    ids=lambda c: " ".join(map(str, c.values())),
)
def test_the_rest_of_a_run_has_its_bits(choice: dict[str, Any], fmus: Path) -> None:
    """Each pair of choices once; the last step is cut, the start is not 0, and the state is read from bytes."""
    settings = dict(choice)
    system = of_kind(fmus / settings.pop("flavour"), settings.pop("system"))
    until = settings.pop("until")
    settings |= settings.pop("more")
    with Prepared.open(system, RunSettings(start=0.01, stop=0.0405, **settings)) as prepared:
        require_rest(prepared, until, lambda state: pickle.loads(pickle.dumps(state)))


@pytest.mark.parametrize(
    ("flaw", "settings"),
    [
        ({}, {"step": Adaptive(1e-3)}),
        ({}, {"algorithm": "iterated"}),
        ({"commits": True}, {}),
        ({"pause_at": 0.734}, {"input_order": 2}),
        ({"longest_step": 0.03}, {}),
    ],
    ids=str,
)
def test_other_fmus_go_on_in_their_instances(
    flaw: dict[str, Any], settings: dict[str, Any], tmp_path: Path
) -> None:
    """They cannot serialise their state; steps that they discard, and changes before, at and after the state."""
    parts = {name: foreign.pack(tmp_path / f"{name}.fmu", x0=100.0, **flaw) for name in "AB"}
    kinds = ("integer", "boolean", "enumeration", "string")
    wires = ["A.y -> B.u", "B.y -> A.u", *(f"A.{k}_out -> B.{k}_in" for k in kinds)]
    changes = ["at 0.33 s A.a = -2", "at 0.5 s A.a = -3", "at 0.77 s A.boolean_in = true"]
    start = foreign.idle("AB", *(wire.split("-> ")[1] for wire in wires))
    plan = RunSettings(**{"stop": 1.0, "step": 0.1, "algorithm": "gauss-seidel", **settings})
    with Prepared.open(System(parts, wires, start, changes=changes), plan) as prepared:
        require_rest(prepared, 0.5, lambda state: state, but=LIFE)


@pytest.mark.parametrize("step", [0.01, 0.03, Adaptive(1e-3)], ids=str)
@pytest.mark.parametrize("clock", ["", CLOCK], ids=["no clock", "clock"])
@pytest.mark.parametrize("serializes", ["true", "false"])
def test_events_and_clocks_go_on(step: Any, clock: str, serializes: str, tmp_path: Path) -> None:
    """A ball bounces at 0.45 s and later, and a clock ticks; inputs that event mode takes are remembered."""
    ball = third.pack(tmp_path / "ball.fmu", clock, canSerializeFMUState=serializes)
    system = System({"A": ball, "B": ball}, ["A.h -> B.u", "A.bounces -> B.Int32_in"])
    with Prepared.open(system, RunSettings(stop=1.3, step=step)) as prepared:
        is_read = serializes == "true"
        require_rest(prepared, 0.6, lambda s: pickle.loads(pickle.dumps(s)) if is_read else s)


def refused(call: Callable[[], object]) -> str:
    """The reason why a call is refused."""
    with pytest.raises(SetupError) as error:
        call()
    return str(error.value)


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"step": 0.003}, "start=0.02"),
        ({"stop": 0.02}, "stop after"),
        ({"start": 0.03}, "start=0.0"),
        ({"step": 0.02, "stop": 0.03}, "at most the time from the state"),
        ({"output_step": 0.7 * H}, "output_step=None"),
        ({"input_order": 1}, "motor: .*input_order = 0"),
        ({"flavour": "fmi3"}, "another FMU"),
        ({"kind": "motor alone"}, "conveyor, motor; this system has motor"),
        ({"kind": "table"}, "motor: .*other wires"),
        ({"changes": ["at 0.01 s motor.T = 0.04"]}, "motor.T is 0.0625 in the state"),
    ],
    ids=str,
)
def test_a_run_that_a_state_does_not_fit_is_refused(
    what: dict[str, Any], reason: str, fmus: Path
) -> None:
    plan = RunSettings(0.04, H)
    with Prepared.open(drive(fmus / "native", "pair"), plan) as prepared:
        begin = Case(begin=prepared.run_until(0.02).state)
    settings = {"flavour": "native", "kind": "pair", "changes": [], **what}
    system = drive(fmus / settings.pop("flavour"), settings.pop("kind"))
    system = replace(system, changes=settings.pop("changes"))
    with Prepared.open(system, replace(plan, **settings)) as prepared:
        assert re.search(reason, refused(partial(prepared.run, begin)))


def test_what_is_no_case_with_a_state_or_no_time_to_pause_is_refused(fmus: Path) -> None:
    system, plan = drive(fmus / "native", "pair"), RunSettings(0.04, H, stop_time_defined=True)
    with Prepared.open(system, plan) as prepared:
        paused = prepared.run_until(0.02)
        begin = Case(begin=paused.state)
        assert "begin=paused.state" in refused(lambda: prepared.run(Case(begin=paused)))  # type: ignore[arg-type]
        for case in (paused, paused.state, {"motor.A": 8e3}):
            assert "write Case(start)" in refused(partial(prepared.run, case))
            assert "write Case(start)" in refused(partial(prepared.run_until, 0.03, case))
        for cases in ([begin], begin, paused.state):
            assert "run(Case(begin=state))" in refused(partial(prepared.map, cases))
        both = Case({"motor.A": 8e3}, begin=paused.state)
        assert "start (motor.A)" in refused(lambda: prepared.run(both))
        assert "a time in s" in refused(lambda: prepared.run_until("20 ms"))  # type: ignore[arg-type]
        assert "stop = 0.04 s" in refused(lambda: prepared.run_until(0.05))
        assert "after the start at 0.02 s" in refused(lambda: prepared.run_until(0.02, begin))
    with Prepared.open(system, RunSettings(0.05, H)) as prepared:
        assert "at most 0.04 s" in refused(lambda: prepared.run(begin))
    with Prepared.open(system, replace(plan, output_step=0.7 * H)) as prepared:
        assert "output_step=None" in refused(lambda: prepared.run_until(0.02))


def test_an_fmu_that_cannot_serialise_its_state_begins_one_run(tmp_path: Path) -> None:
    one = foreign.single_fmu_system(foreign.pack(tmp_path / "A.fmu"))
    with Prepared.open(one, RunSettings(1.0, 0.1)) as prepared:
        live = Case(begin=prepared.run_until(0.5).state)
        prepared.run(live)
        assert "A: its FMU does not have canSerializeFMUstate" in refused(
            lambda: prepared.run(live)
        )
        live = Case(begin=prepared.run_until(0.5).state)
    with Prepared.open(one, RunSettings(1.0, 0.1)) as prepared:
        assert "hand it out again" in refused(lambda: prepared.run(live))
    stateless = foreign.pack(tmp_path / "B.fmu", canGetAndSetFMUstate=False)
    with Prepared.open(foreign.single_fmu_system(stateless), RunSettings(1.0, 0.1)) as prepared:
        assert "B cannot save its state" in refused(lambda: prepared.run_until(0.5))


def test_no_start_value_of_the_system_is_passed_over(fmus: Path) -> None:
    """The state brings them all: other ones are refused, but where a case of the same system has replaced them."""
    system, plan = drive(fmus / "native", "pair"), RunSettings(0.04, H)
    with Prepared.open(system, plan) as prepared:
        usual = Case(begin=prepared.run_until(0.02).state)
        varied = Case(begin=prepared.run_until(0.02, Case({"motor.A": 7e3, "motor.T": 0.05})).state)
        assert prepared.run(varied).provenance["start_values"]["motor.A"] == 7e3

    def reason(case: Case, **start: float) -> str:
        changed = {f"motor.{name}": value for name, value in start.items()}
        with Prepared.open(replace(system, start={**system.start, **changed}), plan) as prepared:
            return refused(lambda: prepared.run(case))

    assert "motor.A = 7000.0 in the system, and 8000.0 at the start" in reason(usual, A=7e3)
    declared = reason(usual, T=0.2)
    assert "motor.T = 0.2 in the system, and 0.0625 at the start" in declared
    assert "changes=['at 0.02 s motor.T = 0.2']" in declared
    assert "motor.A = 9000.0 in the system, and 7000.0 at the start" in reason(varied, A=9e3)
    fewer = {name: value for name, value in system.start.items() if name != "motor.A"}
    with Prepared.open(replace(system, start=fewer | {"motor.T": 0.0625}), plan) as prepared:
        assert prepared.run(usual).provenance["start_values"]["motor.A"] == 8e3


def two_decays(folder: Path, rate: float) -> dict[str, Path]:
    """A decays by this rate [1/s] and B by 1 / s; neither can serialise its state."""
    return {
        "A": foreign.pack(folder / f"A{rate}.fmu", a=-rate),
        "B": foreign.pack(folder / "B.fmu"),
    }


def test_a_refused_begin_leaves_states_that_can_begin_once(tmp_path: Path) -> None:
    """Another FMU, and another input over time of the part that comes last, are seen before any part has taken its state."""
    parts, plan = two_decays(tmp_path, 1.0), RunSettings(1.0, 0.1)
    other = [
        (System(two_decays(tmp_path, 5.0)), "A: the state is of another FMU"),
        (System(parts, inputs={"B.u": lambda _: 0.0}), "B: the state is of a system with"),
    ]
    with Prepared.open(System(parts), plan) as prepared:
        state = prepared.run_until(0.5).state
        for system, text in other:
            with Prepared.open(system, plan) as changed:
                assert text in refused(partial(changed.run, Case(begin=state)))
        assert prepared.run(Case(begin=state))["time"][-1] == 1.0


@pytest.mark.parametrize("until", [0.42, 0.45])
def test_no_run_goes_on_where_an_fmu_has_ended_the_simulation(until: float, tmp_path: Path) -> None:
    one = foreign.single_fmu_system(foreign.pack(tmp_path / "A.fmu", end_at=0.47))
    with Prepared.open(one, RunSettings(1.0, 0.1)) as prepared:
        with pytest.raises(SimulationError, match="there is no state"):
            prepared.run_until(until)
        assert prepared.run_until(0.4).state.time == pytest.approx(0.4)


def test_steps_after_a_state_are_those_of_the_new_settings(fmus: Path) -> None:
    """The longest step holds from the first one on; FMUs keep the tolerance that they were told, and the result says it."""
    pair = drive(fmus / "native", "pair")
    with Prepared.open(pair, RunSettings(0.04, Adaptive(1e-1))) as prepared:
        begin = Case(begin=prepared.run_until(0.02).state)
    with Prepared.open(pair, RunSettings(0.04, Adaptive(1e-3, longest=1e-4))) as prepared:
        rest = prepared.run(begin)
    assert np.diff(rest["time"]).max() <= 1e-4 * (1 + 1e-9)
    assert rest.provenance["tolerance"] == rest.provenance["parts"]["motor"]["tolerance"] == 0.1
    assert begin.begin is not None
    assert rest.provenance["begin"] == {"time": begin.begin.time, "start": 0.0}


def followed(folder: Path, *rows: tuple[float, float]) -> System:
    """The conveyor alone, whose torque follows a table: times [s] and torques [N.m]."""
    t, tau = zip(*rows)
    return replace(drive(folder, "table"), inputs={"conveyor.tau": Series.of({"t": t, "tau": tau})})


def test_an_input_with_another_past_jumps_at_the_state(fmus: Path) -> None:
    """There, not within the step behind it, as where its own table jumps; one with the same past does not."""
    native, plan = fmus / "native", RunSettings(0.04, H, record=["conveyor.tau", "conveyor.w"])
    slow, fast = (followed(native, (0.0, w), (0.04, w)) for w in (1.0, 50.0))
    with Prepared.open(slow, plan) as prepared:
        begin = Case(begin=prepared.run_until(0.02).state)
        unchanged = prepared.run(begin)
    assert unchanged.breaks.size == 0 and (np.diff(unchanged["time"]) > 0.0).all()
    jumping = followed(native, (0.0, 1.0), (0.02, 1.0), (0.02, 50.0), (0.04, 50.0))
    results = []
    for system in (fast, jumping):
        with Prepared.open(system, plan) as prepared:
            results.append(prepared.run(begin))
    other, own = results
    assert other["conveyor.tau"][:3].tolist() == [1.0, 50.0, 50.0]
    assert other.breaks.tolist() == [[0.02, 0.02]]
    assert_array_equal(other.data, own.data)


def test_a_parameter_keeps_what_the_state_has_only_if_the_system_says_so(fmus: Path) -> None:
    """A change before the state that the new system does not make is refused; at the state it may change to anything."""
    system, plan = drive(fmus / "native", "pair"), RunSettings(0.04, H)
    changed = replace(system, changes=["at 0.01 s motor.T = 0.04"])
    with Prepared.open(changed, plan) as prepared:
        begin = Case(begin=prepared.run_until(0.02).state)
        own = prepared.run(begin)
    for start in ({}, {"motor.T": 0.0625}):
        usual = replace(system, start={**system.start, **start})
        with Prepared.open(usual, plan) as prepared:
            text = refused(partial(prepared.run, begin))
        assert "motor.T is 0.04 in the state at t = 0.02 s, and 0.0625 in this system" in text
    kept = replace(system, changes=["at 0.02 s motor.T = 0.04"])
    with Prepared.open(kept, replace(plan, start=0.02)) as prepared:
        rest = prepared.run(begin)
    assert rest["motor.tau"][-1] == pytest.approx(own["motor.tau"][-1], rel=1e-9)


@pytest.mark.parametrize("step", [1e-3, 5e-3, 2e-3, 1e-4])
@pytest.mark.parametrize("stop", [0.04, 0.021])
def test_a_break_goes_on_to_its_end_with_any_steps(step: float, stop: float, fmus: Path) -> None:
    """The input jumps inside the step from 0.02 to 0.021 s, which breaks the next one too."""
    rows = ((0.0, 1.0), (0.0203, 1.0), (0.0203, 50.0), (0.05, 50.0))
    system = followed(fmus / "native", *rows)
    with Prepared.open(system, RunSettings(stop, 1e-3)) as prepared:
        first, state = prepared.run_until(0.0205)
    assert first.breaks == pytest.approx(np.array([[0.02, 0.021]]))
    with Prepared.open(system, RunSettings(0.041, step, start=state.time)) as prepared:
        rest = prepared.run(Case(begin=state))
    assert rest.breaks == pytest.approx(np.array([[0.021, 0.022]]))


def test_the_last_step_of_the_same_run_may_be_longer_than_what_is_left(fmus: Path) -> None:
    with Prepared.open(drive(fmus / "native", "pair"), RunSettings(0.04, 0.03)) as prepared:
        require_rest(prepared, 0.03, lambda state: state)


@pytest.mark.parametrize("flavour", ["native", "", "crash apart"])
@pytest.mark.parametrize("jobs", [1, 2])
def test_members_that_begin_with_a_state_are_single_runs(
    flavour: str, jobs: int, fmus: Path
) -> None:
    """With other steps and stops, in this process, in threads and in processes of their own."""
    settings = RunSettings(stop=0.05, step=H, record=["motor.tau", "conveyor.w"])
    folder = fmus / "native" if flavour else fmus
    steps, stops = [H, H / 2, Adaptive(1e-3), H], [0.05, 0.04, 0.05, 0.045]
    with Prepared.open(of_kind(folder, "change"), settings) as prepared:
        state = prepared.run_until(0.02).state
        if flavour == "crash apart":
            how = How(jobs, isolated=True, steps=steps, stops=stops)
            cases = replace(Cases.of(len(steps), prepared.network), begin=state)
            ensemble = joined(list(prepared.blocks(cases, how)))
        else:
            ensemble = prepared.map(len(steps), begin=state, jobs=jobs, steps=steps, stops=stops)
        again = prepared.map(2, jobs=jobs)
        setup = prepared.setup
    assert not any([*ensemble.reasons, *again.reasons])
    for k, (step, stop) in enumerate(zip(steps, stops)):
        own = replace(settings, step=step, stop=stop)
        with Prepared.open(setup.network.system, own) as prepared:
            single = prepared.run(Case(begin=state))
        assert_array_equal(ensemble.result(k).data, single.data)
        assert ensemble.result(k).provenance["begin"] == single.provenance["begin"]
    assert again.result(0)["time"][0] == 0.0


def test_what_cannot_begin_many_runs_is_refused_before_the_first(
    fmus: Path, tmp_path: Path
) -> None:
    with Prepared.open(
        of_kind(fmus / "native", "pair"), RunSettings(stop=0.05, step=H)
    ) as prepared:
        state = prepared.run_until(0.02).state
        text = refused(lambda: prepared.map({"motor.A": [7e3, 8e3]}, begin=state))
        assert "leave out start (motor.A)" in text
        text = refused(lambda: prepared.map(2, begin=state, steps=[H, 0.7 * H]))
        assert "no step of" in text
    lives = two_decays(tmp_path, 1.0)
    with Prepared.open(System(lives), RunSettings(stop=1.0, step=0.1)) as prepared:
        state = prepared.run_until(0.5).state
        text = refused(lambda: prepared.map(2, begin=state))
        assert "the state of A, B cannot be serialised" in text


@pytest.mark.parametrize("until", [0.22, 0.33, 0.42])
def test_the_loop_in_c_leaves_instances_at_the_time_that_steps_in_python_do(
    until: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There they take inputs by event mode, with the event that is due then."""
    ball = third.pack(tmp_path / "ball.fmu", CLOCK)
    system = System({"A": ball, "B": ball}, ["A.h -> B.u"])
    settings = RunSettings(stop=1.3, step=0.01, record=["A.h", "B.y"])
    for loop in ("compiled", "Python"):
        if loop == "Python":
            hide_compiled_loop(monkeypatch)
        with Prepared.open(system, settings) as prepared:
            result, state = prepared.run_until(until)
        assert result.provenance["loop"].startswith(loop)
        for part in state.parts.values():
            assert part.fmu.events.now == pytest.approx(state.time, abs=1e-12)
            assert part.fmu.events.due == pytest.approx(math.ceil(10 * until - 0.5) / 10 + 0.05)


@pytest.mark.parametrize(
    "damage", [{"parts": None}, {"parts": {"motor": None}}, {"time": None}, {"inputs_before": 3}]
)
def test_a_state_of_which_something_is_taken_is_refused(
    damage: dict[str, Any], native: Path
) -> None:
    system = System({"motor": native / "DriveMotor.fmu"})
    with Prepared.open(system, RunSettings(stop=0.1, step=0.01)) as prepared:
        state = replace(prepared.run_until(0.05).state, **damage)
        with pytest.raises(SetupError, match="the state that run_until hands out"):
            prepared.run(Case(begin=state))
