"""Motions in SVG, which browsers animate by themselves: the one drawing of page, live page and GIF."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from .model import Samples
from .motion import Motion, Shape
from .style import COLORS

#: Width of a drawing in its own units; a convention of this project.
UNITS_ACROSS = 1000.0
#: Free space around a drawing, in its own units; chosen: names at its edge stay inside.
EDGE = 28.0
#: Height of a drawing on a page at most [px]; the same number stands in the page's style.
MAX_HEIGHT_PX = 460.0
#: Height of the line for the caption of a still [half px]; chosen: twice its letters.
CAPTION = 60.0
#: Width of a drawing that stands alone [px]; chosen: that of a text column.
DRAWING_WIDTH = 620
#: Free height above a drawing that stands alone [px]; chosen.
DRAWING_TOP = 14
#: How opaque a ghost is on a page; chosen: the moving shape stands out.
GHOST_OPACITY = 0.22
#: How opaque a ghost is in a drawing that stands alone; chosen: darker, as nothing moves there.
DRAWING_GHOST_OPACITY = 0.35
#: Share of the width beyond which a name is written to the left of its point; chosen.
NAME_TURNS_AT = 0.8
#: Colour of letters; that of `style.COLORS["black"]`, which the page's style turns with the screen.
LETTER = COLORS["black"]
HALO = 'stroke="#fff" stroke-width=".25em" paint-order="stroke"'
SCREENS = {"wide": (928.0, 12.0), "narrow": (358.0, 9.0)}


class Symbol(NamedTuple):
    """A symbol of the equations, "l_K", beside the middle of some points of a shape.

    It is shifted so many pixels to the right and up.
    """

    text: str
    shape: str
    points: Sequence[int]
    shift: tuple[float, float] = (0.0, 8.0)


def svg(motion: Motion) -> str:
    """The motion again and again over its ghosts, with letters of a size for wide and narrow screens."""
    size, _, shapes = scaled_to_drawing(motion)
    since = motion.times - motion.times[0]
    times = ";".join(f"{share:.6g}" for share in since / since[-1])
    clock = f'dur="{since[-1] * motion.slow:.6g}s" repeatCount="indefinite" keyTimes="{times}"'
    ghosts = [
        _line(shape, placed[[frame]], "", f' opacity="{GHOST_OPACITY}"')
        for shape, placed in shapes
        if len(placed) > 1
        for frame in motion.ghosts
    ]
    lines = [_line(shape, placed, clock) for shape, placed in shapes]
    names = [_name_beside(shape, placed, clock) for shape, placed in shapes]
    label = escape(f"{motion.title}: {', '.join(shape.name for shape in motion.shapes)}")
    return (
        f'<svg role="img" aria-label="{label}" viewBox="0 0 {size[0]:.1f} {size[1]:.1f}" '
        f'style="{font_size_css(size)}">{"".join([*ghosts, *lines, *names])}</svg>'
    )


def still(motion: Motion, frame: int, pixels: float) -> str:
    """A frame below its caption as a picture, on its longer side so many pixels long."""
    size, _, shapes = scaled_to_drawing(motion)
    unit = max(size) / pixels
    now = [(shape, placed[[min(frame, len(placed) - 1)]]) for shape, placed in shapes]
    lines = [_line(shape, placed, "", thick=unit) for shape, placed in now]
    names = [_name_beside(shape, placed, "") for shape, placed in now]
    wide, tall = size[0], size[1] + CAPTION * unit / 2
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide / unit:.0f}" '
        f'height="{tall / unit:.0f}" viewBox="0 {size[1] - tall:.1f} {wide:.1f} {tall:.1f}">'
        f'<rect y="{size[1] - tall:.1f}" width="100%" height="100%" fill="white"/>{"".join(lines)}'
        f'<g font-family="DejaVu Sans" font-size="{11 * unit:.1f}" {HALO}>{"".join(names)}'
        f'<text x="{EDGE}" y="0">{escape(motion.captions[frame])}</text></g></svg>'
    )


def drawing(motion: Motion, symbols: Sequence[Symbol]) -> str:
    """Return the first frame over its ghosts, as a picture that stands alone.

    The ghosts have words beside them; symbols take the place of the names of their shapes.
    """
    size, _, shapes = scaled_to_drawing(motion)
    unit = (1.2 if motion.ghosts else 1.0) * size[0] / DRAWING_WIDTH
    tall, symbolic = round(size[1] / unit) + DRAWING_TOP, {symbol.shape for symbol in symbols}
    lines = [
        _line(shape, placed[[frame]], "", f' opacity="{DRAWING_GHOST_OPACITY}"', thick=unit)
        for frame in motion.ghosts
        for shape, placed in shapes
        if len(placed) > 1
    ]
    lines += [_line(shape, placed[:1], "", thick=unit) for shape, placed in shapes]
    texts = [
        _name_beside(shape, placed[:1], "")
        for shape, placed in shapes
        if shape.name not in symbolic
    ]
    moving = [placed for _, placed in shapes if len(placed) > 1]
    texts += [
        f'<text x="{size[0]:.1f}" y="{moving[0][frame, :, 1].mean():.1f}">{escape(text)}</text>'
        for frame, text in motion.ghosts.items()
    ]
    points_of_shape = {shape.name: placed[0] for shape, placed in shapes}
    for text, name, points, (right, up) in symbols:
        x, y = points_of_shape[name][list(points)].mean(axis=0) + np.array([right, -up]) * unit
        low = re.sub(r"_(\w+)", rf'<tspan dy="{4 * unit:.1f}" font-size="70%">\1</tspan>', text)
        look = f'text-anchor="middle" fill="{LETTER}" font-style="italic"'
        texts.append(f'<text x="{x:.1f}" y="{y:.1f}" {look}>{low}</text>')
    inside = "\n".join([*lines, f"<g {HALO}>", *texts, "</g>"])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {DRAWING_WIDTH} {tall}" font-family="serif" '
        f'stroke-linejoin="round" stroke-linecap="round">\n<rect width="{DRAWING_WIDTH}" height="{tall}" '
        f'fill="#fff"/>\n<g transform="translate(0 {DRAWING_TOP}) scale({1 / unit:.6f})" '
        f'font-size="{17 * unit:.1f}">\n{inside}\n</g>\n</svg>\n'
    )


class ScaledDrawing(NamedTuple):
    """A drawing: width and height, units in a metre, and every shape with its points, shape (frames or 1, n, 2)."""

    size: Samples
    scale: float
    shapes: list[tuple[Shape, Samples]]


def scaled_to_drawing(motion: Motion) -> ScaledDrawing:
    """Return a motion in the units of its drawing."""
    low, high = motion.bounds
    scale = float(UNITS_ACROSS / (high[0] - low[0]))
    corner, directions = np.array([low[0], high[1]]), np.array([scale, -scale])
    placed = [(shape, (shape.points - corner) * directions + EDGE) for shape in motion.shapes]
    return ScaledDrawing(scale * (high - low) + 2 * EDGE, scale, placed)


def font_size_css(size: Sequence[float] | Samples) -> str:
    """The size of letters on wide and narrow screens in a drawing of that size, for its style."""
    return "; ".join(
        f"--{screen}: {height / min(wide / size[0], MAX_HEIGHT_PX / size[1]):.1f}px"
        for screen, (wide, height) in SCREENS.items()
    )


def _line(shape: Shape, placed: Samples, clock: str, more: str = "", thick: float = 1.0) -> str:
    """A shape as it moves, with its name for those who point at it or do not see it."""
    look = (
        f'fill="none" stroke="{COLORS[shape.color]}" stroke-width="{shape.width * thick:g}"{more}'
    )
    inside = "" if more else f"<title>{escape(shape.name)}</title>"
    tag = "polygon" if shape.closed else "polyline"
    return _element(tag, look, inside, {"points": placed.reshape(len(placed), -1)}, clock)


def _name_beside(shape: Shape, placed: Samples, clock: str) -> str:
    """The name of a shape beside it, if it is to be read."""
    if shape.label is None:
        return ""
    x, y = placed[:, shape.label, :1], placed[:, shape.label, 1:]
    side = 'dx="-.5em" text-anchor="end"' if x.max() > NAME_TURNS_AT * UNITS_ACROSS else 'dx=".5em"'
    return _element("text", f'{side} dy="-.5em"', escape(shape.name), {"x": x, "y": y}, clock)


def _element(tag: str, look: str, inside: str, moving: Mapping[str, Samples], clock: str) -> str:
    """An element whose attributes move if they have several frames, shape (frames, n)."""
    for name, values in moving.items():
        frames = [" ".join(f"{x:g}" for x in row) for row in np.round(values, 1)]
        look += f' {name}="{frames[0]}"'
        if len(frames) > 1:
            inside += f'<animate attributeName="{name}" {clock} values="{";".join(frames)}"/>'
    return f"<{tag} {look}>{inside}</{tag}>"
