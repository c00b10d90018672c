"""Motions in SVG, which browsers animate by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from .chart import COLORS, Samples
from .motion import Motion

WIDE, EDGE, TALL = 1000.0, 28.0, 460.0
SCREENS = {"wide": (928.0, 12.0), "narrow": (358.0, 9.0)}


def scale_of(motion: Motion) -> float:
    """Units of the drawing in a metre."""
    low, high = motion.bounds
    return float(WIDE / (high[0] - low[0]))


def svg(motion: Motion) -> str:
    """The motion again and again over its ghosts, with letters of a size for wide and narrow screens."""
    low, high = motion.bounds
    scale = scale_of(motion)
    size = scale * (high - low) + 2 * EDGE
    since = motion.times - motion.times[0]
    times = ";".join(f"{share:.6g}" for share in since / since[-1])
    clock = f'dur="{since[-1] * motion.slow:.6g}s" repeatCount="indefinite" keyTimes="{times}"'

    def element(tag: str, look: str, inside: str, moving: Mapping[str, Samples]) -> str:
        """An element whose attributes move if they have several frames, shape (frames, n)."""
        for name, values in moving.items():
            frames = [" ".join(f"{x:g}" for x in row) for row in np.round(values, 1)]
            look += f' {name}="{frames[0]}"'
            if len(frames) > 1:
                inside += f'<animate attributeName="{name}" {clock} values="{";".join(frames)}"/>'
        return f"<{tag} {look}>{inside}</{tag}>"

    ghosts, lines, names = "", "", ""
    for shape in motion.shapes:
        placed = (shape.points - [low[0], high[1]]) * [scale, -scale] + EDGE
        points, name = placed.reshape(len(placed), -1), escape(shape.name)
        look = f'stroke="{COLORS[shape.color]}" stroke-width="{shape.width:g}"'
        tag = "polygon" if shape.closed else "polyline"
        lines += element(tag, look, f"<title>{name}</title>", {"points": points})
        if len(points) > 1:
            for frame in motion.ghosts:
                ghosts += element(tag, f'{look} opacity="0.22"', "", {"points": points[[frame]]})
        if shape.label is not None:
            x, y = placed[:, shape.label, :1], placed[:, shape.label, 1:]
            side = 'dx="-.5em" text-anchor="end"' if x.max() > 0.8 * WIDE else 'dx=".5em"'
            names += element("text", f'{side} dy="-.5em"', name, {"x": x, "y": y})
    letters = [
        f"--{screen}: {height / min(wide / size[0], TALL / size[1]):.1f}px"
        for screen, (wide, height) in SCREENS.items()
    ]
    label = escape(f"{motion.title}: {', '.join(shape.name for shape in motion.shapes)}")
    return (
        f'<svg role="img" aria-label="{label}" viewBox="0 0 {size[0]:.1f} {size[1]:.1f}" '
        f'style="{"; ".join(letters)}">{ghosts}{lines}{names}</svg>'
    )
