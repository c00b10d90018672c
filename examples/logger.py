"""What a logger makes of a motion: the counts of an encoder, the torque that an inverter estimates, and a file of both."""

import argparse
from collections.abc import Callable
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Samples = NDArray[np.float64]
#: Spacing of the rows [s]. Chosen: the cycle of a logger.
SAMPLE = 0.002
#: Counts of the encoder per turn. Convention: a power of 2.
COUNTS = 16384
#: Resolution of the torque [%]. Chosen: a decimal.
RESOLUTION = 0.1


def row_ends_and_middles(first: float, stop: float) -> Samples:
    """Begin, middle and end of every row [s], two for each row and one more."""
    return first + SAMPLE / 2 * np.arange(2 * round((stop - first) / SAMPLE) + 1)


def mean_speed(angle: Samples, counts: int = COUNTS) -> Samples:
    """What an encoder shows over each row [rpm], from the angles [rad] at the ends and middles of all rows."""
    return np.diff(np.floor(angle[::2] * counts / (2 * pi))) / counts / SAMPLE * 60


def percent(torque: Samples, rated: float, noise: float, seed: int) -> Samples:
    """What an inverter shows in the middle of each row [%], from the torques [N.m] at the ends and middles of all rows."""
    shown = 100 * torque[1::2] / rated
    shown = shown + np.random.default_rng(seed).normal(0.0, noise, len(shown))
    return RESOLUTION * (shown / RESOLUTION).round()


def write(record: Callable[[int], pd.DataFrame], meaning: str, default: str) -> None:
    """Write a record to the file that the command line names."""
    parser = argparse.ArgumentParser(description=meaning.partition("\n")[0])
    parser.add_argument("file", nargs="?", type=Path, default=default, help="default: %(default)s")
    parser.add_argument("seed", nargs="?", type=int, default=1, help="of the noise; default: 1")
    options = parser.parse_args()
    options.file.parent.mkdir(parents=True, exist_ok=True)
    rows = record(options.seed)
    rows.to_csv(options.file, index=False)
    print(f"{options.file}: {len(rows)} rows")
