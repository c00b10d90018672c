"""Whether two pictures show the same."""

from pathlib import Path

import numpy as np
from PIL import Image

VISIBLE, SHARE = 48, 2e-4


def differ(first_path: Path, second_path: Path) -> str:
    """What is different between two pictures, "" if nothing that can be seen: figures that move in
    their last digits move no line by a pixel."""
    first, second = (
        np.asarray(Image.open(path).convert("RGB"), int) for path in (first_path, second_path)
    )
    if first.shape != second.shape:
        return f"{first.shape} and {second.shape} pixels"
    share = float((abs(first - second).max(axis=-1) > VISIBLE).mean())
    return f"{share:.2%} of the pixels differ" if share > SHARE else ""
