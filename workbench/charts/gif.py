"""Motions as GIF, of the drawing that the page moves."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from .motion import Motion
from .svg import still

MOST, LONG = 110, 840


def gif(path: Path, motion: Motion) -> None:
    """The motion as a GIF that repeats itself."""
    import matplotlib as mpl  # has a font on every system
    import resvg_py
    from PIL import Image

    letters = [str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")]
    chosen = np.unique(np.linspace(0, len(motion.times) - 1, MOST).astype(int)).tolist()
    frames: list[Any] = []
    for frame in chosen:
        drawn = resvg_py.svg_to_bytes(
            svg_string=still(motion, frame, LONG), skip_system_fonts=True, font_files=letters
        )
        image = Image.open(BytesIO(bytes(drawn))).convert("RGB")
        palette = {"palette": frames[0]} if frames else {"colors": 32}
        frames.append(image.quantize(dither=Image.Dither.NONE, **palette))
    lasts = 1e3 * float(motion.times[-1] - motion.times[0]) * motion.slow / len(frames)
    more: Any = {"duration": max(20, round(lasts)), "loop": 0}
    path.parent.mkdir(parents=True, exist_ok=True)
    frames[0].save(path, save_all=True, append_images=frames[1:], **more)
