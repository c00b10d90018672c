"""Motions by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .chart import COLORS
from .motion import Motion
from .png import pyplot

MOST = 110


def gif(path: Path, motion: Motion) -> None:
    """The motion as a GIF that repeats itself."""
    from PIL import Image

    low, high = motion.bounds
    edge = 0.05 * max(high - low)
    wide, tall = high - low + 2 * edge
    scale = 7.0 / max(wide, tall)
    figure = pyplot().figure(figsize=(wide * scale, tall * scale + 0.4))
    axes = figure.add_axes((0, 0, 1, tall * scale / (tall * scale + 0.4)))
    axes.set(xlim=(low[0] - edge, high[0] + edge), ylim=(low[1] - edge, high[1] + edge))
    axes.set_axis_off()
    drawn = []
    for shape in motion.shapes:
        moves = len(shape.points) > 1
        look: Any = {"color": COLORS[shape.color], "linewidth": 0.7 * shape.width}
        (line,) = axes.plot(*shape.at(0).T, animated=moves, solid_capstyle="round", **look)
        name = None
        if shape.label is not None:
            at = tuple(shape.at(0)[shape.label])
            name = axes.annotate(shape.name, at, (6, 6), textcoords="offset points", fontsize=8)
            name.set_animated(moves)
        if moves:
            drawn.append((shape, line, name))
    text = figure.text(0.02, 0.98, "", va="top", fontsize=9, animated=True)
    canvas: Any = figure.canvas
    canvas.draw()
    empty = canvas.copy_from_bbox(figure.bbox)
    chosen = np.unique(np.linspace(0, len(motion.times) - 1, MOST).astype(int)).tolist()
    frames: list[Any] = []
    for i in chosen:
        canvas.restore_region(empty)
        for shape, line, name in drawn:
            line.set_data(*shape.at(i).T)
            axes.draw_artist(line)
            if name is not None:
                name.xy = shape.at(i)[shape.label]
                axes.draw_artist(name)
        text.set_text(motion.captions[i])
        figure.draw_artist(text)
        frame = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
        palette = {"palette": frames[0]} if frames else {"colors": 32}
        frames.append(frame.quantize(dither=Image.Dither.NONE, **palette))
    pyplot().close(figure)
    lasts = 1e3 * float(motion.times[-1] - motion.times[0]) * motion.slow
    path.parent.mkdir(parents=True, exist_ok=True)
    more: Any = {"duration": max(20, round(lasts / len(frames))), "loop": 0}
    frames[0].save(path, save_all=True, append_images=frames[1:], **more)
