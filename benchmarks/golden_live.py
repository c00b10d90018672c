"""The figures that pages with sliders compute in a browser."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from benchmarks.golden_commands import Entry, execute

if TYPE_CHECKING:
    from tests.workbench.browser import Browser

#: questions whose page has sliders: options of a short answer, and two positions of the sliders
SLIDERS: dict[str, tuple[str, list[Mapping[str, float]]]] = {
    "iron_bounce": ("", [{"speed": 11.0, "iron.follower.e": 0.6}, {"speed": 9.0}]),
    "iron_cycle": (
        "",
        [{"speed": 9.0, "iron.iron.m": 2.0}, {"speed": 3.0, "iron.spring.c": 900.0}],
    ),
    "iron_start": ("", [{"motor_A": 2.0, "iron.iron.m": 7.0}, {"motor_A": 5.0}]),
    "orientator_cycle": ("", [{"friction": 0.1, "speed": 6.0}, {"friction": 0.8, "speed": 9.0}]),
    "packing_line": ("", [{"gear": 2.2}, {"iron_speed": 5.0, "iron.iron.m": 6.0, "speed": 50.0}]),
    "resonance": (
        "--speeds 34,38,40,42,46 --steps-per-rev 128",
        [
            {"conveyor.spring.c": 5e5, "speed": 44.0},
            {"conveyor.trough.d": 9000.0, "motor.B": 320.0},
        ],
    ),
    "run_up": ("", [{"motor.T": 0.03, "conveyor.spring.c": 5e5}, {"speed": 45.0}]),
    "sommerfeld": ("--supplies 18:32:8", [{"motor.R": 4.5}, {"exciter.mount.d": 150.0}]),
    "speed_step": ("", [{"shaft.c": 3000.0, "controller.K": 1.0}, {"ratio": 4.0, "speed": 30.0}]),
}
LIVE_PART = "document.getElementById('live-part')"
FIGURES = f"""Object.fromEntries([...{LIVE_PART}.querySelectorAll('tr[data-figure]')].map(row => {{
    const cell = row.querySelector('td');
    return [row.dataset.figure, {{ text: cell.textContent, ...cell.dataset }}]; }}))"""
SENTENCES = f"[...{LIVE_PART}.querySelectorAll('.verdict p')].map(p => p.textContent)"
#: a convention of this dump: the least width of a page that shows everything side by side [px]
WIDTH = 1000
#: a convention of this dump: how often a page may take all of the browser's patience, a minute, for an answer
ATTEMPTS = 5


def live_items() -> list[str]:
    """The questions with sliders."""
    return list(SLIDERS)


def live_entry(item: str, folder: Path) -> Entry:
    """The figures that a page computes in a browser, as it opens and at two positions of its sliders."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if program is None:
        return {"absence": "no chromium is installed"}
    try:
        from tests.workbench.browser import browser
    except ImportError as error:
        return {"absence": f"no page can be driven: {error}"}
    options, positions = SLIDERS[item]
    arguments = [
        "-m",
        "scenarios",
        "run",
        item,
        *options.split(),
        "--flavour",
        "native",
        "--jobs",
        "1",
    ]
    answer = execute([*arguments, "--out", str(folder / "out")], folder)
    page = folder / "out" / "report.html"
    if not page.is_file():
        return {"absence": "the question wrote no page", "command": answer}
    entry: Entry = {}
    with browser(program, folder / "browser") as screen:
        screen.open(page, WIDTH)
        if not screen.value(f"Boolean({LIVE_PART})"):
            return {"absence": "the page has no live part"}
        for count, position in enumerate([{}, *positions], 1):
            text = "&".join(f"{name}={value!r}" for name, value in position.items())
            if text:
                screen.value(f"location.hash = '#live:{quote(text)}'")
            await_answer(screen, count)
            cells = screen.value(FIGURES)
            entry[text or "as it opens"] = {
                "figures": {name: live_figure(cell) for name, cell in cells.items()},
                "verdict": screen.value(SENTENCES),
            }
    return entry


def await_answer(screen: Browser, count: int) -> None:
    """Wait until a page has answered `count` times; RuntimeError if it does not."""
    for patience in range(ATTEMPTS):
        try:
            screen.until(f"{LIVE_PART}.dataset.answered === '{count}'")
        except RuntimeError:
            if patience + 1 == ATTEMPTS:
                raise
        else:
            return


def live_figure(cell: Mapping[str, str]) -> Entry:
    """The value and the error of a figure in a page; only the text where one of them is not there."""
    value, error = cell.get("value"), cell.get("error")
    if not (value and error):
        return {"text": cell["text"]}
    return {"value": float(value), "error": float(error)}
