"""Iron and orientator side by side, in the picture and on the live page."""

from cosim import Result, System
from workbench.charts.motion import Motion, rows, shifted
from workbench.live import Caption, LiveMotion

from ..iron import motion as iron_motion
from ..orientator import machine as orientator
from ..orientator import motion as orientator_motion

NOTE = "The conveyor is left out."
#: Place of the orientator beside the iron [m]; chosen so that neither hides the other.
ASIDE = (0.5, 0.2)
#: Frames of a cycle; a convention.
FRAMES = 360
#: How many times slower than the line the motion runs; a convention.
SLOWER = 4.0


def motion(r: Result, line: System, first: int, last: int) -> Motion:
    """Iron and orientator side by side between two rows."""
    picked = rows(r["time"], float(r["time"][first]), float(r["time"][last]), FRAMES)
    shapes, captions = iron_motion.draw_rows(r, line, picked)
    more, stages = orientator_motion.draw_rows(r, picked)
    captions = [f"{caption}; orientator {stage}" for caption, stage in zip(captions, stages)]
    title = "One cycle: the iron drive and the orientator it releases"
    return Motion(
        title, r["time"][picked], SLOWER, captions, [*shapes, *shifted(more, *ASIDE)], NOTE
    )


def live_motion(result: Result, line: System, window: str) -> LiveMotion:
    """Return the motion of the live page, over a window of the run."""
    draw_iron = iron_motion.live_shapes(result, line)
    draw_orientator = orientator_motion.live_shapes(result)
    return LiveMotion(
        "The last cycle: the iron drive and the orientator it releases",
        lambda at: [*draw_iron(at), *shifted(draw_orientator(at), *ASIDE)],
        [*iron_motion.coordinates(result), *orientator_motion.coordinates(result)],
        [
            *iron_motion.CAPTIONS,
            Caption("orientator", "orientator.stage", texts=orientator.STAGES),
        ],
        SLOWER,
        NOTE,
        window,
    )
