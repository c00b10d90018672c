"""How long a live page takes: its first answer, an answer after a move, and what it shows meanwhile.

.venv/bin/python benchmarks/live.py results/resonance/A/report.html conveyor.spring.c=5e5
"""

import argparse
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.workbench.browser import browser

ANSWERED = "document.getElementById('live-part').dataset.answered === '{}'"
WATCH = """(window.seen = { frames: [], long: [] },
    new PerformanceObserver(list => seen.long.push(...list.getEntries().map(x => x.duration)))
        .observe({ type: "longtask" }),
    requestAnimationFrame(function next(t) { seen.frames.push(t); requestAnimationFrame(next); }), 0)"""
MOVE = """(seen.frames.length = seen.long.length = 0, seen.from = performance.now(),
    location.hash = "#live:{}", 0)"""
TOLD = """({ took: performance.now() - seen.from, frames: seen.frames.length, long: seen.long.sort((a, b) => b - a),
    first: performance.getEntriesByName("first-contentful-paint")[0]?.startTime })"""


def main() -> None:
    """Open a page, move its sliders, and print what was measured."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("page", type=Path, help="report.html of a question with a live part")
    parser.add_argument("moves", nargs="+", metavar="NAME=VALUE", help="one move after the other")
    o = parser.parse_args()
    program = shutil.which("chromium") or "chromium"
    with TemporaryDirectory() as home, browser(program, Path(home)) as shown:
        shown.open(o.page, 1000)
        shown.until(ANSWERED.format(1))
        shown.value(WATCH)
        for number, move in enumerate(o.moves, 2):
            shown.value(MOVE.format(move))
            shown.until(ANSWERED.format(number))
            told = shown.value(TOLD)
            share = told["frames"] / told["took"] * 1e3
            print(f"first picture {told['first']:.0f} ms; {move}: {told['took']:.0f} ms, "
                  f"{share:.0f} pictures/s, tasks over 50 ms: "
                  f"{', '.join(f'{x:.0f}' for x in told['long']) or 'none'}")  # fmt: skip


if __name__ == "__main__":
    main()
