"""One product through the orientator: what its FMU says at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from cosim import Result, System
from workbench import Figure, Number, Question, Reader, RunOptions, option

from . import machine as orientator

STAGES_PASSED = orientator.STAGES[: orientator.ORIENTED]
#: Impulse: output, meaning, and the stage that ends with it.
IMPULSES = {
    "corner_impulse": ("S_y", "impulse of the landing on the catcher's corner, down", "falling"),
    "wall_impulse": ("S_k", "impulse of the landing on the wall", "falling"),
    "hook_impulse": ("P_B", "impulse of the contact with the hook", "joint"),
}
#: The reason of a jam in which the catcher stops before the product reaches the hook.
STOPPED = orientator.REASONS.index("catcher stopped")
BY_STEP = "it depends on the step of the run whether this product jams"


def last(output: str) -> Reader:
    """Return a reader of what the FMU says at the end."""
    return Reader("last", f"orientator.{output}")


class Passage(Question, RunOptions):
    """The rotor's speed, the friction of its wall, and how the run is made."""

    parts: ClassVar[Mapping[str, str]] = orientator.PARTS
    fixed_starts = ("orientator.release",)
    numbers: ClassVar[Any] = (
        Number("oriented", last("oriented"), meaning="oriented: 1, or not: 0"),
        Number(
            "orientation_time", last("orientation_time"), meaning="time from drop to end", when="figures.oriented",
            otherwise="not oriented",
        ),
        *(
            Number(
                f"t_{x}", last(f"t_{x}"), meaning=f"duration of the stage {x}", when=f"figures.t_{x} > 0",
                otherwise="not reached",
            )
            for x in STAGES_PASSED
        ),
        *(Number(name, last(output), meaning=meaning) for name, (output, meaning, _) in IMPULSES.items()),
    )  # fmt: skip

    speed: float = option("40rpm", "speed of the rotor", "rad/s", least=0.0)
    friction: float = option(0.35, "friction between cup and wall", "1", least=0.0)
    stop: float = option(orientator.LONGEST, "longest simulated time", "s", above=0.0)
    step: float = option("1ms", "finest of three communication steps", "s", above=0.0)

    def system(self, fmus: Mapping[str, Path]) -> System:
        """Return the orientator that turns at the speed of the options."""
        return orientator.system(fmus, self.speed, self.friction, self.start)

    def more_figures(self, f: Mapping[str, Figure], r: Any) -> Mapping[str, Figure]:
        """Return as not determined what the product does not come to."""
        result: Result = r
        end, oriented = ending(result), f["oriented"]
        is_sure = oriented.error is not None and oriented.error < 1.0
        lost = {} if oriented.value else {"orientation_time": end}
        lost |= {} if is_sure else {"orientation_time": BY_STEP}
        lost |= {f"t_{x}": end for x in STAGES_PASSED if not f[f"t_{x}"].value}
        stopped = int(result["orientator.reason"][-1]) == STOPPED
        for name, (_, _, landing) in IMPULSES.items():
            if f"t_{landing}" in lost or (name == "hook_impulse" and stopped):
                lost[name] = f"it does not come to that: {end}"
        return {
            name: Figure.undetermined(f[name].unit, why, f[name].meaning)
            for name, why in lost.items()
        }


def ending(r: Result) -> str:
    """What became of the product, in words."""
    stage, reason = (int(r[f"orientator.{name}"][-1]) for name in ("stage", "reason"))
    if reason:
        return f"the product jams: {orientator.REASONS[reason]}"
    still = "" if stage == orientator.ORIENTED else "still in the stage "
    return f"the product is {still}{orientator.STAGES[stage]}"
