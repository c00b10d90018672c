"""How long a live page takes: from a move of a slider to the first curve, to all numbers, and to the whole
sweep; and how large the page and its scripts are.

.venv/bin/python benchmarks/live.py results/resonance/A/report.html conveyor.spring.c=5e5 speed=44
"""

import argparse
import shutil
import statistics
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.workbench.browser import Browser, browser

PART = "document.getElementById('live-part')"
SIZES = """(async () => {
    const scripts = [...document.querySelectorAll("body script:not([type])")].map((x) => x.textContent.length);
    return scripts.reduce((a, b) => a + b, 0) + (await unpack("worker")).length;
})()"""
#: notes when the page has drawn, has filled in numbers, and is done after a move
WATCH = """(window.times = {}, new MutationObserver(() => {
    const now = performance.now() - window.from, { drawn, answered } = live_part.dataset;
    if (drawn === window.wanted) times.curve ??= now;
    if (live_part.querySelector("[data-value]")?.dataset.value !== window.before) times.numbers ??= now;
    if (answered === window.wanted) times.done ??= now;
}).observe(live_part, { subtree: true, childList: true, attributes: true }), 0)"""
MOVE = """(window.times = {{}}, window.wanted = String(Number(live_part.dataset.answered) + 1),
    window.before = live_part.querySelector("[data-value]")?.dataset.value,
    window.from = performance.now(), location.hash = "#live:{}", 0)"""
#: so many moves there and back, of which the medians are printed
REPEATS = 5


def measure(page: Browser, move: str) -> dict[str, float]:
    """Return the times [ms] from a move to the first curve, to the numbers, and to the end."""
    page.value(MOVE.format(move))
    page.until("times.done !== undefined")
    return dict(page.value("times"))


def main() -> None:
    """Open a page, move its sliders, and print what was measured."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("page", type=Path, help="report.html of a question with a live part")
    parser.add_argument(
        "moves", nargs="+", metavar="NAME=VALUE", help="moves, each from the original values"
    )
    o = parser.parse_args()
    program = shutil.which("chromium") or "chromium"
    with TemporaryDirectory() as home, browser(program, Path(home)) as page:
        page.open(o.page, 1400)
        page.until(f"{PART}.dataset.answered === '1'")
        page.value(f"(window.live_part = {PART}, 0)")
        size = o.page.stat().st_size
        print(f"page {size / 1e6:.2f} MB, scripts without plotly {page.value(SIZES) / 1e3:.1f} kB")
        page.value(WATCH)
        for move in o.moves:
            runs = []
            for _ in range(REPEATS):
                runs.append(measure(page, move))
                measure(page, "")
            medians = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
            print(f"{move}: {', '.join(f'{key} {x:.0f} ms' for key, x in medians.items())}")


if __name__ == "__main__":
    main()
