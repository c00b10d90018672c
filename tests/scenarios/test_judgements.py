"""Judgements: each turns on a machine for which it must, and says what its figures and bounds say."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.conftest import LONG, QUICK, ask, plain
from workbench.answer import Answer
from workbench.export import content
from workbench.figure import Figure
from workbench.judgement import Holds, Judgement, lines, share_text

YES, NO, OPEN = Holds

SWEEP: dict[str, Any] = {"speeds": "34:46:7", "steps_per_rev": 128}
#: A feeder with 320 kg on 900 kN/m and a soft motor of 5.5 kW, damped so strongly that nothing is amplified.
FEEDER = {
    "conveyor.trough.m": 320.0, "conveyor.crank.r": 0.008, "conveyor.spring.c": 9e5, "motor.T": 0.0147,
    "motor.characteristic": "kloss", "motor.kloss.tau_b": 350.0, "motor.kloss.w_s": 45.81, "motor.kloss.s_b": 0.2165,
}  # fmt: skip
LIFTED = {"iron.rocker.m": 40.0, "iron.rocker.gamma": -1.5}
JAMMED = {"speed": "62.5rpm", "friction": 0.5}
RECORD = QUICK["identify"]

#: Question, the beginning of a judgement, and for each answer options with which it must be given.
TURNS: list[tuple[str, str, dict[Holds, dict[str, Any]]]] = [
    ("resonance", "torque ripple below", {YES: SWEEP | {"limit": 150.0}, NO: SWEEP,
                                          OPEN: SWEEP | {"algorithm": "jacobi"}}),
    ("resonance", "on resonance", {YES: SWEEP, NO: SWEEP | {"speed": 45.0}, OPEN: SWEEP | {"algorithm": "jacobi"}}),
    ("resonance", "on resonance", {YES: SWEEP, NO: {"speeds": "40:60:9", "speed": "420rpm", "start": FEEDER}}),
    ("run_up", "the linear motor passes", {YES: {"stop": 0.3}, NO: {"stop": 0.3, "speed": 20.0}}),
    ("run_up", "the induction motor passes", {YES: {}, NO: {"start": {"motor.kloss.tau_b": 1.0}}}),
    ("mean_values", "after a step of the supply", {
        YES: {"speeds": "40", "speed": 40.0, "start": {"motor.T": 2e-4}, "steps_per_rev": 1024},
        NO: {"speeds": "40", "speed": 40.0, "start": {"motor.T": 4e-3}, "steps_per_rev": 1024}}),
    ("iron_cycle", "", {YES: {"speed": 7.0, "samples": 180}, NO: {"speed": 9.0, "samples": 180}}),
    ("iron_cycle", "", {YES: {"samples": 180}, NO: {"samples": 180, "start": LIFTED}}),
    ("iron_start", "the cam completes", {YES: {"stop": 1.5}, NO: {"motor_A": -4.0, "step": 2e-3}}),
    ("iron_start", "the stall torque of the motor", {YES: {"motor_A": 0.35, "stop": 0.1}, NO: {"motor_A": 0.05}}),
    ("iron_bounce", "", {YES: {"speeds": "70rpm", "speed": "70rpm", "samples": 360},
                         NO: {"speeds": "70rpm", "speed": "80rpm", "samples": 360}}),
    ("iron_orders", "with a motor lag of 80 ms", {YES: {"speeds": "2"}, NO: {"speeds": "5"},
                                             OPEN: {"speeds": "0.3", "start": {"motor.B": 1e-4}}}),
    ("orientator_cycle", "the product is oriented", {YES: {"speed": "50rpm"}, NO: JAMMED}),
    ("orientator_cycle", "the product is oriented", {NO: {}}),
    ("orientator_cycle", "the wall pushes at all times", {YES: JAMMED, NO: {}}),
    ("packing_line", "the line keeps pace", {YES: QUICK["packing_line"], NO: QUICK["packing_line"] | {"gear": 2.2}}),
    ("speed_step", "the load reaches", {YES: {"stop": 0.2}, NO: {"stop": 0.2, "speed": 200.0}}),
    ("speed_step", "the mean speed over a turn", {YES: {}, NO: {"start": {"controller.T_i": 0.05}},
                                                 OPEN: {"stop": 0.2}}),
    ("resonance_map", "", {YES: QUICK["resonance_map"] | {"limit": 500.0}, NO: QUICK["resonance_map"] | {"limit": 1.0}}),
    ("rod_force", "the spring of", {YES: QUICK["rod_force"] | {"set": "B"}, NO: QUICK["rod_force"] | {"steps_per_rev": 256},
                                     OPEN: QUICK["rod_force"]}),
    ("sommerfeld", "the motor passes", {YES: QUICK["sommerfeld"], NO: {"supplies": "15,18", "hold": 2.0}}),
    ("identify", "torque ripple below", {YES: RECORD | {"rated_torque": 1000.0}, NO: RECORD | {"rated_torque": 8.0}}),
    ("iron_identify", "the follower stays", {YES: QUICK["iron_identify"]}),
    ("orientator_identify", "the fastest product", {YES: QUICK["orientator_identify"]}),
]  # fmt: skip
#: Questions whose answers take many seconds of processor time.
SLOW = {*LONG, "resonance_map", "rod_force", "iron_orders", "orientator_identify"}


@pytest.mark.parametrize(
    ("name", "begin", "options", "wanted"),
    [
        pytest.param(name, begin, options, answer, marks=[pytest.mark.slow] if name in SLOW else [])
        for name, begin, cases in TURNS
        for answer, options in cases.items()
    ],
)
def test_a_judgement_turns_where_the_machine_does(
    name: str, begin: str, options: dict[str, Any], wanted: Holds
) -> None:
    answer = ask(name, **options)
    judgement = next(x for x in answer.judgements if x.what.startswith(begin) and x.answer)
    assert judgement.answer is wanted, judgement.text()
    holds(answer)


@pytest.mark.parametrize("name", [x for x in QUICK if x not in LONG])
def test_an_answer_says_what_its_judgements_say(name: str) -> None:
    assert plain(name).judgements
    holds(plain(name))


@pytest.mark.slow
def test_no_resonance_matters_only_where_none_does() -> None:
    """Of three motor lags at two speeds, two add to a torque order; at the lower speed alone, none does."""
    some = ask("iron_orders", speeds="2,5")
    assert [x.answer for x in some.judgements[:3]] == [NO, NO, YES]
    assert "No resonance" not in some.verdict
    none = ask("iron_orders", speeds="2")
    assert none.verdict.startswith("No resonance matters; with a motor lag of")
    assert none.verdict.count("No resonance") == 1


def test_a_product_that_needs_a_pull_of_its_wall_is_not_oriented() -> None:
    """The first line says so, and a study can ask for both."""
    for speed, is_pushed in (("40rpm", False), ("50rpm", True)):
        answer = ask("orientator_cycle", speed=speed)
        assert answer.figures["oriented"].value == 1.0
        assert answer.figures["oriented_by_pushing"].value == is_pushed
        assert answer.judgements[0].good is is_pushed
        assert ("only if its wall can pull" in answer.judgements[0].headline()) is not is_pushed


@pytest.mark.parametrize(
    ("question", "options"), [("speed_step", {"stop": 0.2}), ("run_up", {"stop": 0.3})]
)
def test_a_time_is_no_share_of_the_run(question: str, options: dict[str, Any]) -> None:
    first = ask(question, **options).judgements[0]
    assert first.answer is YES and "after 0." in first.headline() and "%)" not in first.headline()


def test_a_share_near_its_bound_is_not_the_bound() -> None:
    shares = {
        0.99453: "99 %",
        0.9995: "99.95 %",
        1.0: "100 %",
        1.00012: "100.01 %",
        0.45: "45 %",
        0.0123: "1.2 %",
    }
    assert {share: share_text(share) for share in shares} == shares


def test_a_sentence_states_its_own_limit_and_a_short_run_what_to_do() -> None:
    short = ask("speed_step", stop=0.2).judgements
    assert short[1].what.endswith("overshoots its set speed by less than 0.1 %")
    assert "a longer run shows more" in short[1].why_open


def test_figures_of_a_drive_that_is_held_together_are_told() -> None:
    slow, fast = (ask("iron_cycle", speed=speed, samples=180) for speed in (7.0, 9.0))
    assert "held together" not in slow.figures["run_force_max"].meaning
    assert fast.figures["run_force_max"].meaning.endswith("of a drive that is held together")


def holds(answer: Answer) -> None:
    """An answer has a line for each judgement, which its figures bear out, in JSON as well."""
    assert answer.verdict.splitlines() == lines(answer.judgements)
    record = json.loads(json.dumps(content(answer)["judgements"]))
    assert [x["answer"] for x in record] == [x.answer and str(x.answer) for x in answer.judgements]
    for judgement, text in zip(answer.judgements, answer.verdict.splitlines()):
        assert text[:1] == text[:1].upper() and len(text) < 400
        for each in (judgement, *judgement.also):
            if each.figure and each.figure.error is None and each.answer is OPEN:
                assert each.why_open == each.figure.reason


@pytest.mark.parametrize(
    ("value", "error", "bounds", "told"),
    [
        (1.0, 1.5, {"most": -1.0}, "no, 1.0 ± 1.5 N (at most -1)"),
        (-200.0, 230.0, {"most": 100.0}, "yes, -200 ± 230 N (at most 100)"),
        (1.0, 1.5, {"least": 3.0}, "no, 1.0 ± 1.5 N (at least 3)"),
        (-1.0, 1.5, {"least": -3.0}, "yes, -1.0 ± 1.5 N (at least -3)"),
        (1.0, 1.5, {"least": -1.0, "most": 3.0}, "yes, 1.0 ± 1.5 N (-1 to 3)"),
        (1.0, 1.5, {"most": 3.0}, "yes, below 2.5 N in size (limit 3 N)"),
        (-1.0, 1.5, {"most": 3.0}, "yes, below 2.5 N in size (at most 3)"),
    ],
)
def test_what_decides_is_told_with_its_sign(
    value: float, error: float, bounds: dict[str, float], told: str
) -> None:
    assert Judgement("a force", Figure(value, "N", error), **bounds).text() == f"A force: {told}"


def test_all_that_must_hold_holds_together() -> None:
    value = Figure(2.0, "1", 0.1)
    yes, no = Judgement("a", value, most=3.0), Judgement("b", value, most=1.0)
    unsure = Judgement("c", value, most=2.05)
    refused = Judgement("d", Figure.undetermined("1", "it sticks"), most=1.0)
    for parts, wanted in (
        ((yes, yes), YES), ((yes, unsure), OPEN), ((unsure, no), NO), ((refused, no), NO), ((yes, refused), OPEN),
    ):  # fmt: skip
        assert Judgement("all", also=parts).answer is wanted
    assert Judgement("all", also=(yes, refused)).why_open == "it sticks"
    assert Judgement("all", also=(unsure, no)).text() == "All: no, b 2.00 ± 0.10, limit 1 (200 %)"


def test_forces_beyond_the_lift_off_are_not_stated() -> None:
    carried = [
        x
        for x in ask("iron_cycle", speed=9.0, samples=180).judgements
        if "pull of the chain" in x.what
    ]
    assert carried and all(x.figure and x.figure.error is None for x in carried)
