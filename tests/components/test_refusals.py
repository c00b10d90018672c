"""What no machine can be is refused by name, value and bound, and the process lives on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.hosts.host import Unit

OFF = "the follower can be off the cam only with follower.lifts"
#: Refusals of start values that are each within their own bounds, which another test tries.
REFUSED: dict[str, dict[str, dict[str, Any]]] = {
    "IronDrive": {
        "cam angles exceed one revolution: cam.rise + cam.top + cam.ret = 8.1": {"cam.top": 5.0},
        "cam triangle cannot close: cam.R_b = 0.06 m must be > 0.06 m": {"cam.R_b": 0.06},
        "cam triangle cannot close: cam.R_b = 0.1 m must be > 0.06 m and, with cam.h = 0.14 m":
            {"cam.h": 0.14},
        "friction: -1 < K_down <= 0 <= K_up violated: friction.K_down = -1.0,": {"friction.K_down": -1.0},
        "K_up violated: friction.K_down = 0.1, friction.K_up = 0.089": {"friction.K_down": 0.1},
        "K_up violated: friction.K_down = -0.0747, friction.K_up = -0.1": {"friction.K_up": -0.1},
        "rocker end must stay on the far side of the sprocket: sprocket.C + rocker.l_K cos(alpha) = -0":
            {"sprocket.C": 0.02},
        "link reaches the sprocket: link.l = 0.4 m of a run of 0.37": {"link.l": 0.4},
        "link reaches the sprocket: its end is within sprocket.R": {"sprocket.C": 0.03, "wrap": 1},
        "chain too short: hanging part vanishes: H = -": {"chain.l": 0.25},
        "dead centre: beta - alpha = -1": {"rocker.alpha0": 4.0},
        "spring slack: stretch = -0.01 m with spring.e_0 = -0.01 m at phi = 0.0": {"spring.e_0": -0.01},
        "spring slack: stretch = -0.0": {"spring.side": -1, "spring.e_0": 0.05},
        "chain slack at standstill: T_iron = -": {"spring.side": -1, "spring.c": 2000.0},
        "cam follower lifts off at phi = 3.1853 rad, omega = 9.0 rad/s: N = -": {"phi": 3.1853, "w_cam": 9.0},
        OFF: {"gap": 0.1},
        f"gap = 0.0 rad, w_gap = 0.1 rad/s: {OFF}": {"w_gap": 0.1},
        f"gap = 0.0 rad, w_gap = -0.1 rad/s: {OFF}": {"w_gap": -0.1, "follower.lifts": True},
    },
    "GravityOrientator": {
        "chute.R = 0.19 m must be above catcher.l cos(catcher.phi) + cup.d = 0.1958": {"chute.R": 0.19},
        "catcher.h = 0.05 m must be below cup.h = 0.048 m": {"catcher.h": 0.05},
        "cup.l = 0.07 m must be below cup.h + cup.d/2 = 0.068 m": {"cup.l": 0.07},
        "catcher.l = 0.06 m must be longer": {"catcher.l": 0.06},
        "cup.h = 0.005 m must be above cup.d/2 tan(catcher.phi/2) = 0.00535": {
            "cup.h": 0.005, "cup.l": 0.004, "catcher.h": 0.003},
        "catcher.h = 0.045 m must be below cup.d / sin(catcher.phi) = 0.04": {
            "cup.d": 0.02, "catcher.h": 0.045},
        "cup.J = 1e-07 kg.m2 must be above 1.": {"cup.J": 1e-7},
        "neglected.J_a = 5e-05 kg.m2 must be below 2 cup.J = 4.8e-05 kg.m2": {
            "neglected.J_a": 5e-5, "neglected.mu_side": 0.3},
        "xc = 0.3 m cannot be set: continuous output": {"xc": 0.3},
        "vxc = 1.0 m/s cannot be set: continuous output": {"vxc": 1.0},
    },
    "SlottedLink": {
        "crank.r = 0.01 m must be below link.l = 0.01 m": {"link.swings": True, "link.l": 0.01},
    },
    "Gearbox": {"i = 0.0 must not be 0": {"i": 0.0}},
}  # fmt: skip


@pytest.mark.parametrize(("name", "reason"), [(n, r) for n, rows in REFUSED.items() for r in rows])
def test_what_cannot_be_is_refused_by_name_value_and_bound(
    name: str, reason: str, both: Path
) -> None:
    unit = Unit(both / f"{name}.fmu", "unit 7")
    refusal = unit.refusal(lambda u: u.start(**REFUSED[name][reason]))
    assert "unit 7: " in refusal
    assert reason in refusal
    unit.fmi.reset()
    unit.start().step(0.0, 0.01).fmi.freeInstance()
