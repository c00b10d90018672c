"""How does one product turn over, and how long does each stage take?

One cup from the drop to the end, with its trajectory, angles and speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cosim import Result, System
from workbench import Figure, Run, Show, option

from . import machine as orientator
from . import show as pictures

PARTS = orientator.PARTS
OWN = ("orientator.release",)
RECORD = orientator.names((
    "stage", "reason", "phi1", "phi2", "w1", "w2", "xc", "yc", "vxc", "vyc", "v_s", "N_K",
    "contact", "E_kin", "E_pot", "t_falling", "t_joint", "t_turning", "t_released",
    "orientation_time", "S_x", "S_y", "S_k", "P_B", "P_K",
))  # fmt: skip
IMPULSES = {
    "corner_impulse": ("S_y", "landing on the corner of the catcher, down"),
    "wall_impulse": ("S_k", "landing on the wall"),
    "hook_impulse": ("P_B", "contact with the hook"),
}


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    speed: float = option("40rpm", "speed of the rotor", "rad/s", least=0.0)
    friction: float = option(0.35, "friction between cup and wall", "1", least=0.0)
    stop: float = option(orientator.LONGEST, "longest simulated time", "s", above=0.0)
    step: float = option("1ms", "finest of three communication steps", "s", above=0.0)


def system(o: Options, fmus: Mapping[str, Path]) -> System:
    return orientator.system(fmus, o.speed, o.friction, o.start)


def figures(o: Options, r: Result) -> dict[str, Figure]:
    """End, durations as far as they were reached, and impulses; the FMU tells them at the end."""

    def told(name: str, meaning: str, reached: bool) -> Figure:
        column = f"orientator.{name}"
        if not reached:
            return Figure.refused(r.units[column], ending(r), meaning)
        return Figure(float(r[column][-1]), r.units[column], 0.0, meaning)

    oriented = r["orientator.stage"][-1] == orientator.ORIENTED
    return {
        "oriented": Figure(float(oriented), "1", 0.0, "1 if the product is oriented"),
        "orientation_time": told("orientation_time", "from drop to end", oriented),
        **{
            f"t_{x}": told(f"t_{x}", f"duration of the stage {x}", r[f"orientator.t_{x}"][-1] > 0.0)
            for x in orientator.STAGES
        },
        **{name: told(x, meaning, True) for name, (x, meaning) in IMPULSES.items()},
    }


def ending(r: Result) -> str:
    """What became of the product, in words."""
    stage, reason = (
        orientator.ITEMS[x][int(r[f"orientator.{x}"][-1])] for x in ("stage", "reason")
    )
    if stage == "jammed":
        return f"the product jams: {reason}"
    return "the product is oriented" if stage == "oriented" else f"the product is still {stage}"


def verdict(o: Options, f: Mapping[str, Figure], r: Result) -> str:
    """What becomes of the product, and how long each stage takes."""
    end = ending(r)
    stages = [
        f"{x} {f[f't_{x}'].text()}" for x in orientator.STAGES if f[f"t_{x}"].error is not None
    ]
    hook = f["hook_impulse"].text()
    return (
        f"{end.capitalize()}"
        + (f" after {f['orientation_time'].text()}" if f["oriented"].value else "")
        + f". Its stages: {', '.join(stages) or 'none came to an end'}.\n"
        f"The cup lands with {f['corner_impulse'].text()} on the corner and "
        f"{f['wall_impulse'].text()} on the wall, and meets the hook with {hook}."
    )


def show(o: Options, f: Mapping[str, Figure], r: Result) -> Show:
    """Angles, speeds and velocities over time, and the cup in motion."""
    course = orientator.shortened(r)
    title, last = "One product", float(course["time"][-1])
    moving = pictures.motion(title, {"": course}, last, pictures.stages(course))
    return Show([pictures.cycle(course)], [moving])
