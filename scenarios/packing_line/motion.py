"""Iron and orientator side by side, in the picture and on the live page."""

from cosim import Result, System
from workbench.charts.motion import shifted
from workbench.live import Caption, LiveMotion

from ..iron import motion as iron_motion
from ..orientator import machine as orientator
from ..orientator import motion as orientator_motion

NOTE = "The conveyor is left out."
#: Place of the orientator beside the iron [m]; chosen so that neither hides the other.
ASIDE = (0.5, 0.2)
#: How many times slower than the line the motion runs; a convention.
SLOWER = 4.0


def live_motion(result: Result, line: System, window: str) -> LiveMotion:
    """Iron and orientator side by side, over a window of the run."""
    iron = iron_motion.live_motion("", result, line, SLOWER)
    cups = orientator_motion.live_motion("", result, SLOWER)
    return LiveMotion(
        "The last cycle: the iron drive and the orientator it releases",
        lambda at: [*iron.draw(at), *shifted(cups.draw(at), *ASIDE)],
        [*iron.coordinates, *cups.coordinates],
        [*iron.captions, Caption("orientator", "orientator.stage", texts=orientator.STAGES)],
        SLOWER,
        NOTE,
        window,
    )
