"""Motions by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .chart import COLORS
from .motion import Motion
from .png import pyplot

MOST, LONG = 110, 7.0


def gif(path: Path, motion: Motion) -> None:
    """The motion as a GIF that repeats itself."""
    from PIL import Image

    low, high = motion.bounds
    edge = 0.05 * max(high - low)
    wide, tall = LONG * (high - low + 2 * edge) / max(high - low + 2 * edge)
    figure = pyplot().figure(figsize=(wide, tall + 0.4))
    axes = figure.add_axes((0, 0, 1, tall / (tall + 0.4)))
    axes.set(xlim=(low[0] - edge, high[0] + edge), ylim=(low[1] - edge, high[1] + edge))
    axes.set_axis_off()
    text = figure.text(0.02, 0.98, "", va="top", fontsize=9)
    drawn = []
    for shape in motion.shapes:
        look: Any = {"color": COLORS[shape.color], "linewidth": 0.7 * shape.width}
        (line,) = axes.plot([], [], solid_capstyle="round", **look)
        name = "" if shape.label is None else shape.name
        label = axes.annotate(name, (0, 0), (6, 6), textcoords="offset points", fontsize=8)
        drawn.append((shape, line, label))
    chosen = np.unique(np.linspace(0, len(motion.times) - 1, MOST).astype(int)).tolist()
    frames: list[Any] = []
    for i in chosen:
        for shape, line, label in drawn:
            line.set_data(*shape.at(i).T)
            label.xy = shape.at(i)[shape.label or 0]
        text.set_text(motion.captions[i])
        figure.canvas.draw()
        frame = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])
        palette = {"palette": frames[0]} if frames else {"colors": 32}
        frames.append(frame.quantize(dither=Image.Dither.NONE, **palette))
    pyplot().close(figure)
    lasts = 1e3 * float(motion.times[-1] - motion.times[0]) * motion.slow / len(frames)
    more: Any = {"duration": max(20, round(lasts)), "loop": 0}
    path.parent.mkdir(parents=True, exist_ok=True)
    frames[0].save(path, save_all=True, append_images=frames[1:], **more)
