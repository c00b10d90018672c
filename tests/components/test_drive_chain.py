"""Motor, controller, gearbox and shaft with a load, coupled as FMUs and integrated as one system."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from components.crank_conveyor import model as conveyor
from components.DC_motor import model as motor
from components.gearbox import model as gearbox
from components.shaft_link import model as link
from components.speed_controller import model as controller
from components.unbalance_exciter import model as exciter
from cosim import System, run
from tests.oracle import joined, part

CHAIN = {
    "motor": ("DCMotor", motor, {}),
    "controller": ("SpeedController", controller, {"w_ref": 100.0}),
    "gear": ("Gearbox", gearbox, {"w_a": 0.0}),
}
WIRES = (
    "controller.tau * 2.5 => motor.v", "gear.w_a -> motor.w", "gear.w_a -> controller.w",
    "motor.tau -> gear.tau_a", "link.tau_a -> gear.tau_b", "gear.w_b -> link.w_a",
    "load.w -> link.w_b", "link.tau_b -> load.tau",
)  # fmt: skip
LOADS = {
    "CrankConveyor": (conveyor, {"w": 0.0, "crank.r": 0.004}, {"b": 0.0, "twist": 0.0}),
    "UnbalanceExciter": (exciter, {"w": 0.0}, {"b": 0.002, "twist": -0.001}),
}


@pytest.mark.parametrize("name", LOADS)
def test_the_coupled_chain_converges_to_the_reference_solution(name: str, fmus: Path) -> None:
    """From rest to the set speed, of order 1 and 2 as feedthrough has it; no wire carries a sign."""
    load, load_starts, shaft = LOADS[name]
    chain = CHAIN | {"link": ("ShaftLink", link, shaft), "load": (name, load, load_starts)}
    parts = {word: part(model, **load_starts) for word, (_, model, load_starts) in chain.items()}
    system = System(
        {word: fmus / "native" / f"{fmu}.fmu" for word, (fmu, _, _) in chain.items()},
        WIRES,
        {
            f"{word}.{n}": value
            for word, (_, _, load_starts) in chain.items()
            for n, value in load_starts.items()
        },
    )

    def feed(x: dict[str, Any]) -> list[Any]:
        w = x["gear"].w_a
        controller_inputs, ends = controller.Inputs(100.0, w), link.Inputs(w / 5.0, x["load"].w)
        v = (
            2.5
            * controller.outputs(parts["controller"].p, 0.0, x["controller"], controller_inputs).tau
        )
        T = link.outputs(parts["link"].p, 0.0, x["link"], ends).tau_b
        gear = gearbox.Inputs(0.2 * x["motor"].i, -T)
        return [motor.Inputs(v, w), controller_inputs, gear, ends, load.Inputs(T)]

    t = np.linspace(0.0, 1.0, 101)
    wanted = joined(parts, feed, t, rtol=1e-10, atol=1e-11, max_step=2e-3)["load"].w
    assert wanted[-1] > 15.0
    for order, last in ((0, 3e-3), (1, 1e-4)):
        speeds = [
            run(system, stop=1.0, step=step, output_step=0.01, input_order=order)["load.w"]
            for step in (1e-3, 5e-4, 2.5e-4)
        ]
        errors = [np.abs(w - wanted).max() / wanted.max() for w in speeds]
        assert errors[-1] < last
        assert all(fine < (0.55, 0.3)[order] * coarse for coarse, fine in pairwise(errors))
