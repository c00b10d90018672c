"""What would make an answer good: machines of closed form, whose remedies are known exactly, and the drive by its theory."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cosim import SetupError
from scenarios.project import PROJECT
from tests.conftest import ROOT, fmus_of
from workbench import Context, Figure, Findings, Judgement, Question, Slider, cli, option
from workbench.answer import option_values
from workbench.export import print_and_write
from workbench.find import Find
from workbench.remedies import Range, Remedies, Search, search_for, values_until, with_remedies
from workbench.run import answer

#: Natural frequency, damping ratio and stall of an oscillator at excitation w; its amplification must be below LIMIT.
LIMIT, STALL, ERROR = 2.0, 5.5, 1e-6


class Oscillator(Question):
    """An oscillator with a natural frequency of sqrt(c / m), whose motor stalls at high speeds."""

    at_once = 8
    w: float = option(1.05, "excitation", "rad/s", above=0.0)
    c: float = option(1.0, "stiffness", "N/m", above=0.0)
    m: float = option(1.0, "mass", "kg", above=0.0)
    zeta: float = option(0.1, "damping ratio", "1", above=0.0, most=0.2)
    paint: float = option(1.0, "colour", "1")
    sliders = (
        *(Slider(x, 0.5, 2.0) for x in ("w", "c", "m", "paint")),
        Slider("zeta", 0.05, 0.12),
    )

    def solve(self, context: Context) -> Findings:
        if self.w * self.m > STALL:
            raise SetupError("it stalls")
        r = self.w / math.sqrt(self.c / self.m)
        gain = 1.0 / math.hypot(1.0 - r * r, 2.0 * self.zeta * r)
        error = ERROR if context.certifies else 0.0
        lag = math.degrees(math.atan2(2.0 * self.zeta * r, 1.0 - r * r))
        return Findings(
            {
                "gain": Figure(gain + error / 2.0, "1", error),
                "lag": Figure(lag, "deg", 1e-6),
                "price": Figure(self.c, "1", 0.0),
            }
        )

    def judgements(self, f: Mapping[str, Figure], _r: Any) -> list[Judgement]:
        return [
            Judgement("gain below its limit", f["gain"], most=LIMIT),
            Judgement("lag", f["lag"]),
            Judgement("on resonance", also=[Judgement("lag", f["lag"], 45.0, 135.0)], is_wanted=False),
            Judgement("price below its limit", f["price"], most=2.0),
        ]  # fmt: skip


def oscillator(**values: float) -> Question:
    return Oscillator.parse(values)


def ratios(level: float, zeta: float) -> tuple[float, float]:
    """Where the amplification is at a level: (1 - r^2)^2 + 4 zeta^2 r^2 = 1 / level^2."""
    half = 1.0 - 2.0 * zeta * zeta
    root = math.sqrt(half * half - 1.0 + 1.0 / level**2)
    return math.sqrt(half - root), math.sqrt(half + root)


def search(o: Question, context: Context = Context({})) -> Search:  # noqa: B008
    (found,) = type(o).solve_all(context, [o])
    return search_for(o, context, found, o.sliders, option_values(o))


def by_input(found: Remedies) -> dict[tuple[str, bool], Any]:
    return {(x.varied.name, x.is_upper): x for x in found.found}


def test_remedies_are_where_the_closed_solution_turns_rounded_to_its_safe_side() -> None:
    gain, resonance = search(oscillator()).remedies()
    low, high = ratios(LIMIT, 0.1)
    found = by_input(gain)
    truth = {
        ("w", False): low, ("w", True): high,
        ("c", False): (1.05 / high) ** 2, ("c", True): (1.05 / low) ** 2,
        ("m", False): (low / 1.05) ** 2, ("m", True): (high / 1.05) ** 2,
    }  # fmt: skip
    assert set(found) == set(truth)
    for key, x in truth.items():
        away = (found[key].value - x) * (1 if key[1] else -1)
        assert (
            0.0 <= away <= found[key].error < 3e-3 * x
        )  # on the safe side; one error before it, it is not yet good
        assert float(f"{found[key].value:.4g}") == found[key].value
    assert [x.name for x in gain.without] == ["zeta"]  # up to 0.2 by its bound; paint has no effect
    assert gain.without[0].high == 0.2
    sizes = [abs(x.change) for x in gain.found]
    assert sizes == sorted(sizes)
    lag = by_input(resonance)
    for side, tangent in ((False, 1.0), (True, -1.0)):  # 2 zeta r = +- (1 - r^2)
        r = -tangent * 0.1 + math.sqrt(1.01)
        assert abs(lag["w", side].value - r) <= lag["w", side].error < 1e-3


def test_a_remedy_set_into_the_machine_turns_the_judgement_and_one_error_before_it_does_not() -> (
    None
):
    s = search(oscillator())
    for k, each in enumerate(s.remedies()):
        for x in each.found:
            sign = 1 if x.is_upper else -1
            for value, is_good in ((x.value, True), (x.value - 1.5 * sign * x.error, False)):
                o = s.question.with_value(x.varied.name, value)
                (found,) = type(o).solve_all(Context({}), [o])
                assert (s.judge(o, found)[s.wanted[k]].good is True) == is_good


def test_a_stall_is_no_remedy_and_another_judgement_that_turns_is_said() -> None:
    gain = search(oscillator(w=1.05))
    found = by_input(gain.remedies()[0])
    assert found["m", True].until == pytest.approx(3.0)  # w m = 5.5 lies beyond the range
    heavy = by_input(search(oscillator(w=2.5, m=0.16)).remedies()[0])
    assert heavy["w", True].until == pytest.approx(7.5)
    stalling = by_input(search(oscillator(w=2.4, c=5.76)).remedies()[0])
    assert stalling["w", True].until == pytest.approx(STALL, rel=1e-4)
    assert found["c", True].turns == ["price below its limit: no"]
    assert not found["c", False].turns


def test_an_answer_says_its_remedies_in_words_table_and_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    got = answer(Oscillator, oscillator(), {})
    print_and_write(got, tmp_path, most_steps=math.inf)
    printed = capsys.readouterr().out
    low, high = ratios(LIMIT, 0.1)
    lines = printed.splitlines()
    first = lines.index("Gain below its limit: yes with any one of these changes:")
    line = f"  w (excitation) below {math.floor(low * 1e4) / 1e4} or above {math.ceil(high * 1e3) / 1e3} rad/s, now 1.05"
    assert line in lines[first + 1 : first + 4]
    assert lines[first + 4] == "  not with any zeta from 0.03333 to 0.2"
    up = by_input(got.search.remedies()[0])["w", True].value
    effect = next(x for x in lines if x.startswith(f"With w = {up:g} rad/s: "))
    lag = Oscillator.parse({"w": up}).solve(Context({})).figures["lag"]
    assert f"{lag.brief()}, now " in effect
    content = json.loads((tmp_path / f"{got.scenario}.json").read_text())
    assert line in content["verdict"]
    rows = content["remedies"]
    assert {x["name"] for x in rows} == {"w", "c", "m", "zeta"}
    assert len((tmp_path / "remedies.csv").read_text().splitlines()) == len(rows) + 1


def test_what_a_remedy_turns_to_no_is_said_unasked_and_what_it_changes_where_it_is_asked_for() -> (
    None
):
    got = answer(Oscillator, oscillator(), {})
    (short, brief), (asked, long) = (with_remedies(got, x) for x in (1e9, math.inf))
    assert short.verdict == asked.verdict
    for lines in (short.verdict.splitlines(), brief, long):
        costly = [x for x in lines if x.startswith("But with c = ")]
        assert len(costly) == 1 and "price below its limit: no" in costly[0]
    changes = [[x for x in lines if ", now " in x and "ith " in x[:8]] for lines in (brief, long)]
    assert not changes[0] and changes[1]


def test_a_search_of_more_steps_is_left_and_said_and_a_good_answer_has_none() -> None:
    got = answer(Oscillator, oscillator(), {})
    same, lines = with_remedies(got, 0.999 * got.search.steps)
    assert same is got
    assert "--remedies" in lines[0]
    assert with_remedies(got, got.search.steps)[0].verdict != got.verdict
    python = replace(got, provenance={"flavour": "python"})
    assert with_remedies(python, 9.99 * got.search.steps)[0] is python
    assert with_remedies(answer(Oscillator, oscillator(w=0.5), {}), math.inf)[1] == []
    idle = replace(got.search, ranges=[x for x in got.search.ranges if x.name == "paint"])
    assert with_remedies(replace(got, search=idle), math.inf)[1] == []


@pytest.mark.parametrize(
    ("name", "inputs", "is_sought"),
    [
        ("resonance", 14, True), ("orbit", 7, True), ("orientator_cycle", 8, True), ("iron_cycle", 4, True),
        ("iron_bounce", 5, False), ("speed_step", 6, False), ("iron_start", 5, False), ("sommerfeld", 3, False),
    ],
)  # fmt: skip
def test_what_is_sought_unasked_follows_from_the_steps_of_a_question(
    name: str, inputs: int, is_sought: bool
) -> None:
    varied = [Range(f"input {k}", "", 1.0, 0.5, 2.0) for k in range(inputs)]
    o = PROJECT.load(name).parse({})
    steps = Search(o, Context({}), varied, lambda *_: [], [0]).steps
    assert (steps <= cli.SEARCH_STEPS) == is_sought


def vary(name: str, low: float, high: float) -> Find:
    return Find(name, low, high, "", unit="rad/s")


def test_values_until_a_figure_has_a_level_or_is_within_a_bound() -> None:
    lines = values_until(
        oscillator(), Context({}), "lag = 90deg", [vary("w", 0.5, 3.0), vary("zeta", 0.05, 0.2)]
    )
    assert "w = 1.00000" in lines[0]
    assert "not by zeta" in lines[1]
    low, high = ratios(LIMIT, 0.1)
    down, up = math.floor(low * 1e4) / 1e4, math.ceil(high * 1e3) / 1e3
    line, *_ = values_until(oscillator(), Context({}), "gain <= 2", [vary("w", 0.5, 3.0)])
    assert line == f"Gain <= 2: yes with w below {down:g} or above {up:g} rad/s, now 1.05"
    down, up = math.floor(high * 1e3) / 1e3, math.ceil(low * 1e4) / 1e4
    line, *_ = values_until(oscillator(), Context({}), "gain >= 2", [vary("w", 0.5, 3.0)])
    assert line == f"Gain >= 2: yes with w between {up:g} and {down:g} rad/s, now 1.05"
    lines = values_until(
        oscillator(), Context({}), "gain >= 2", [vary("c", 0.9, 1.1), vary("paint", 1.0, 2.0)]
    )
    assert "yes with any c from 0.9 to 1.1" in lines[0]
    assert lines[1] == "gain >= 2: no effect of paint"
    (line,) = values_until(oscillator(), Context({}), "gain >= 2", [vary("paint", 1.0, 2.0)])
    assert line == "gain >= 2: no effect of paint"
    with pytest.raises(SetupError, match="has no figure 'gian'"):
        values_until(oscillator(), Context({}), "gian <= 2", [vary("w", 0.5, 3.0)])
    with pytest.raises(SetupError, match="must read"):
        values_until(oscillator(), Context({}), "gain 2", [vary("w", 0.5, 3.0)])


def test_the_lag_that_puts_the_resonance_at_a_speed_is_that_of_the_formula() -> None:
    """(22) without ripple: nu^2 = (B + alpha r^2 / 2) / (4 theta T); what ripple adds is of its second order."""
    from scenarios.conveyor.questions import resonance

    o, context = resonance.Resonance.parse({"set": "A"}), Context(fmus_of(resonance))
    (line,) = values_until(o, context, "lag_operating = 90 deg", [vary("motor.T", 0.03, 0.12)])
    value = float(line.partition("motor.T = ")[2].partition(" ")[0])
    assert value == pytest.approx(0.0625, rel=2e-4)


def test_the_speeds_that_make_a_drive_safe_are_those_between_which_it_is_not() -> None:
    from scenarios.conveyor.questions import resonance

    o, context = resonance.Resonance.parse({"set": "A"}), Context(fmus_of(resonance))
    (full,) = type(o).solve_all(context, [o])
    sliders = [Slider("speed", 20.0, 66.0)]
    values = option_values(o, {"speed": 40.0} | full.defaults)
    found = by_input(search_for(o, context, full, sliders, values).remedies()[0])
    for name, is_upper in (("avoid_from", False), ("avoid_to", True)):
        assert (
            abs(found["speed", is_upper].value - full.figures[name].value)
            <= found["speed", is_upper].error
        )


def quoted(page: str, heading: str) -> list[tuple[str, list[str]]]:
    """The commands below a heading, and the lines that the page quotes of each."""
    after = (ROOT / "docs" / page).read_text().partition(f"## {heading}\n")[2]
    text = re.split(r"\n##+ ", after)[0]
    blocks = re.findall(r"```sh\n\.venv/bin/scenarios (.*)\n```\n\n((?:>.*\n)+)", text)
    return [(x, [y[2:] for y in lines.splitlines() if y[2:]]) for x, lines in blocks]


@pytest.mark.parametrize(
    ("page", "heading", "number"),
    [
        ("drive.md", "From *avoid* to *safe*", 2),
        ("scenarios.md", "What would make an answer good", 2),
        ("scenarios.md", "Machines that scatter", 1),
    ],
)
def test_pages_quote_remedies_as_they_are(
    page: str, heading: str, number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    commands = quoted(page, heading)
    assert len(commands) == number
    for command, lines in commands:
        words = shlex.split(command)
        out = [] if words[0] == "find" else ["--out", str(tmp_path / words[1])]
        assert cli.main([*words, *out], PROJECT, "scenarios") == 0
        printed = capsys.readouterr().out
        assert all(line in printed for line in lines)
