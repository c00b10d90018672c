"""Motions by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .motion import Motion
from .png import outlines, pyplot

MOST, LONG, CAPTION = 110, 7.0, 0.4


def gif(path: Path, motion: Motion) -> None:
    """The motion as a GIF that repeats itself."""
    from PIL import Image

    low, high = motion.bounds
    edge = 0.05 * max(high - low)
    size = high - low + 2 * edge
    wide, tall = LONG * size / max(size)
    figure = pyplot().figure(figsize=(wide, tall + CAPTION))
    axes = figure.add_axes((0, 0, 1, tall / (tall + CAPTION)))
    chosen = np.unique(np.linspace(0, len(motion.times) - 1, MOST).astype(int)).tolist()
    frames: list[Any] = []
    for frame in chosen:
        axes.clear()
        outlines(axes, motion, frame)
        for shape in motion.shapes:
            if shape.label is not None:
                at = shape.at(frame)[shape.label]
                axes.annotate(shape.name, at, (6, 6), textcoords="offset points", fontsize=8)
        axes.set(xlim=(low[0] - edge, high[0] + edge), ylim=(low[1] - edge, high[1] + edge))
        axes.annotate(motion.captions[frame], (0.02, 1.0), xycoords="axes fraction", fontsize=9)
        figure.canvas.draw()
        image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])
        palette = {"palette": frames[0]} if frames else {"colors": 32}
        frames.append(image.quantize(dither=Image.Dither.NONE, **palette))
    pyplot().close(figure)
    lasts = 1e3 * float(motion.times[-1] - motion.times[0]) * motion.slow / len(frames)
    more: Any = {"duration": max(20, round(lasts)), "loop": 0}
    path.parent.mkdir(parents=True, exist_ok=True)
    frames[0].save(path, save_all=True, append_images=frames[1:], **more)
