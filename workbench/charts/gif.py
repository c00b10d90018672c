"""Motions as GIF, of the drawing that the page moves."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from .motion import Motion
from .svg import still

#: Frames of a GIF at most; chosen: a motion of 10 s then has 11 frames a second.
MAX_FRAMES = 110
#: The longer side of a GIF [px]; chosen: what a page of text has.
LONGER_SIDE_PX = 840
#: Colours of a GIF; chosen: lines of eight colours with their soft edges.
PALETTE_SIZE = 32
#: Shortest time of a frame [ms]; a convention of browsers, which slow down faster GIFs.
MIN_FRAME_MS = 20


def gif(path: Path, motion: Motion) -> None:
    """The motion as a GIF that repeats itself."""
    import matplotlib as mpl  # has a font on every system
    import resvg_py
    from PIL import Image

    letters = [str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")]
    chosen = np.unique(np.linspace(0, len(motion.times) - 1, MAX_FRAMES).astype(int)).tolist()
    frames: list[Any] = []
    for frame in chosen:
        content = resvg_py.svg_to_bytes(
            svg_string=still(motion, frame, LONGER_SIDE_PX),
            skip_system_fonts=True,
            font_files=letters,
        )
        image = Image.open(BytesIO(bytes(content))).convert("RGB")
        palette = {"palette": frames[0]} if frames else {"colors": PALETTE_SIZE}
        frames.append(image.quantize(dither=Image.Dither.NONE, **palette))
    lasts = 1e3 * float(motion.times[-1] - motion.times[0]) * motion.slow / len(frames)
    more: Any = {"duration": max(MIN_FRAME_MS, round(lasts)), "loop": 0}
    path.parent.mkdir(parents=True, exist_ok=True)
    frames[0].save(path, save_all=True, append_images=frames[1:], **more)
