"""The benchmark of `diagnose` complains of each demand that is not met."""

import math

from benchmarks.damping import MAX_REFUSED, Case, complaints

#: Conveyors of which the largest allowed share can be refused: derived, one of 20 is 5 %.
CONVEYORS = 20


def case(kind: str, seed: int, ratio: float) -> Case:
    """A stated damping ratio, by its difference from the truth over its error."""
    return Case(kind, seed, True, 0.1, 0.1, ratio, math.nan, "")


def refused(kind: str, seed: int) -> Case:
    """A system for which nothing is stated."""
    return Case(kind, seed, False, math.nan, math.nan, math.nan, math.nan, "a reason")


def test_each_demand_has_its_complaint() -> None:
    limit = round(MAX_REFUSED * CONVEYORS)
    good = [case("linear", 1, 0.9), refused("linear", 2), refused("centre", 3)]
    good += [case("conveyor", seed, 1.0) for seed in range(limit, CONVEYORS)]
    good += [refused("conveyor", seed) for seed in range(limit)]
    assert not complaints(good)
    assert not complaints([])
    for wrong, complaint in (
        (case("linear", 7, 1.1), "linear 7: the damping ratio 0.1 is 1.1 times its error"),
        (case("conveyor", 8, math.nan), "conveyor 8: the damping ratio 0.1 is nan times its error"),
        (case("centre", 9, 0.1), "centre 9: a damping ratio is stated, and it has none"),
        (refused("conveyor", 10), "9.52 % of the conveyors are refused, more than 5 %"),
    ):
        (line,) = complaints([*good, wrong])
        assert line.startswith(complaint)
