"""The golden dump: all that the project does today, so that a rebuild can be compared with it.

.venv/bin/python benchmarks/golden.py dump DIR [--only KIND,KIND] [--jobs 2]
.venv/bin/python benchmarks/golden.py compare OLD NEW [--bits | --within-error] [--reasons FILE]

`dump` writes a JSON file for each kind of items. An item that fails is an entry like any other; a dump that
was interrupted goes on where it ended. `compare` prints for every item whether it is equal, within error or
changed, and exits with status 1 if a change has no reason. A line of the file of reasons reads
`questions/resonance*: The search for the peak became a root of the derivative.`
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.golden_commands import ENVIRONMENT, ROOT
from benchmarks.golden_compare import compare, read, reasons
from benchmarks.golden_items import KINDS

#: what entries are made of; the FMUs are built from it
SOURCES = (
    "build_fmus.py",
    "components",
    "cosim",
    "examples",
    "fmukit",
    "gallery",
    "scenarios",
    "workbench",
)
#: packages that decide about digits or texts
LIBRARIES = ("fmpy", "matplotlib", "numpy", "pandas", "plotly", "scipy", "ziglang")
#: longest time that an entry may take [s]: five times what the longest took on a busy machine of two cores
PATIENCE = 900.0


def dump(folder: Path, kinds: Sequence[str], jobs: int) -> int:
    """
    Write the entries that a folder lacks, and those that failed again.

    Parameters
    ----------
    folder : Path
        Where the JSON files are.
    kinds : sequence of str
        The kinds to write, keys of `KINDS`.
    jobs : int
        How many entries are made at a time, each in a process of its own.

    Returns
    -------
    int
        The exit status: 0, or 1 if an entry failed.

    Raises
    ------
    SystemExit
        If the folder holds a dump of other sources, or the FMUs cannot be built.
    """
    folder.mkdir(parents=True, exist_ok=True)
    claim(folder)
    build = [sys.executable, "build_fmus.py", "--flavour", "all"]
    if subprocess.run(build, cwd=ROOT, check=False, stdout=subprocess.DEVNULL).returncode:
        sys.exit("error: the FMUs could not be built: run build_fmus.py --flavour all")
    failures = sum(fill(folder, kind, jobs) for kind in kinds)
    return min(1, failures)


def fill(folder: Path, kind: str, jobs: int) -> int:
    """Write the entries of a kind that a folder lacks; return how many failed."""
    path = folder / f"{kind}.json"
    entries, seconds = read(path), read(folder / "seconds.json")
    names, _ = child(kind)
    if isinstance(names, dict):
        write(path, {"the list of items": names})
        print(f"{kind}  failed: {names['failure']}", flush=True)
        return 1
    tasks = [name for name in names if "failure" in entries.get(name, {"failure": ""})]
    with ThreadPoolExecutor(jobs) as pool:
        try:
            futures = {pool.submit(child, kind, item): item for item in tasks}
            for count, future in enumerate(as_completed(futures), 1):
                item, (entry, duration) = futures[future], future.result()
                entries[item], seconds[f"{kind}/{item}"] = entry, round(duration, 1)
                write(path, entries)
                write(folder / "seconds.json", seconds)
                note = f"  failed: {entry['failure']}" if "failure" in entry else ""
                print(f"{kind} {count}/{len(tasks)}  {item}  {duration:.1f} s{note}", flush=True)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    write(path, {name: entries[name] for name in names})
    return sum("failure" in entries[name] for name in names)


def claim(folder: Path) -> None:
    """Write which sources a dump is of; SystemExit for a folder with a dump of others."""
    path = folder / "about.json"
    about = {
        "commit": git("log", "-1", "--format=%H", "--", *SOURCES).strip(),
        "changes": git("status", "--short", "--", *SOURCES).splitlines(),
        "sources": fingerprint(*SOURCES),
        "instrument": fingerprint("benchmarks/golden*.py"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "libraries": {name: version(name) for name in LIBRARIES},
    }
    before = read(path)
    if before and before["sources"] != about["sources"]:
        sys.exit(
            f"error: {folder} holds a dump of other sources, of {before['commit']}: name another folder"
        )
    write(path, before or about)


def git(*arguments: str) -> str:
    """What git prints in the project."""
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout


def fingerprint(*patterns: str) -> str:
    """A hash of the files of the project below folders or with names like a pattern, committed or not."""
    listed = git("ls-files", "-z", "--cached", "--others", "--exclude-standard", *patterns)
    total = hashlib.sha256()
    for name in sorted(set(listed.split("\0"))):
        if name and (ROOT / name).is_file():
            total.update(f"{name}\0".encode() + (ROOT / name).read_bytes())
    return total.hexdigest()


def child(kind: str, item: str = "") -> tuple[Any, float]:
    """What a process of its own makes, and how long it took [s]: the entry of an item, or the list of all
    items of a kind. If it fails, the only key is "failure", with the reason.
    """
    begin = time.monotonic()
    with TemporaryDirectory(prefix="golden_", ignore_cleanup_errors=True) as folder:
        process = subprocess.Popen(
            [sys.executable, str(Path(__file__).resolve()), "entry", kind, item, folder], cwd=ROOT,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
            env=os.environ | ENVIRONMENT | {"TMPDIR": folder},
        )  # fmt: skip
        try:
            output, errors = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return {"failure": f"no end within {PATIENCE:g} s"}, time.monotonic() - begin
    duration = time.monotonic() - begin
    try:
        content = json.loads(output.splitlines()[-1])
    except (IndexError, ValueError):
        last = errors.strip().splitlines()[-1:]
        return {"failure": f"exit status {process.returncode}: {''.join(last)}"}, duration
    return content, duration


def write(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file, sorted; it is complete at any time."""
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False)
    part = path.with_suffix(".part")
    part.write_text(text + "\n", encoding="utf-8")
    part.replace(path)


def kinds(text: str) -> list[str]:
    """List the kinds of a text such as "help,names"; raises ArgumentTypeError for what is no kind."""
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in KINDS:
            raise argparse.ArgumentTypeError(f"{name!r} must be one of {', '.join(KINDS)}")
    return names


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    dump_parser = commands.add_parser("dump", help="write a dump of the project as it is")
    dump_parser.add_argument("folder", type=Path, metavar="DIR")
    dump_parser.add_argument(
        "--jobs", type=int, default=2, help="entries made at a time (default: 2)"
    )
    comparison = commands.add_parser("compare", help="compare two dumps")
    comparison.add_argument("old", type=Path, metavar="OLD")
    comparison.add_argument("new", type=Path, metavar="NEW")
    rule = comparison.add_mutually_exclusive_group()
    rule.add_argument("--bits", action="store_true", help="nothing may differ")
    rule.add_argument(
        "--within-error", action="store_true",
        help="a figure may differ by the sum of both errors (default)",
    )  # fmt: skip
    comparison.add_argument(
        "--reasons", type=Path, metavar="FILE", help="lines KIND/ITEM: SENTENCE"
    )
    for command in (dump_parser, comparison):
        command.add_argument("--only", type=kinds, default=list(KINDS), metavar="KIND,KIND")
    entry = commands.add_parser("entry", help="print one entry, or the items of a kind")
    entry.add_argument("kind", choices=KINDS)
    entry.add_argument("item", help="empty for the list of items")
    entry.add_argument("folder", type=Path, metavar="DIR", help="an empty folder")
    o = parser.parse_args(arguments)
    if o.command == "dump" and o.jobs < 1:
        parser.error(f"--jobs {o.jobs} must be at least 1")
    if o.command == "dump":
        return dump(o.folder, o.only, o.jobs)
    if o.command == "entry":
        kind = KINDS[o.kind]
        print(json.dumps(kind.entry(o.item, o.folder) if o.item else kind.items()))
        return 0
    for folder in (o.old, o.new):
        if not (folder / "about.json").is_file():
            sys.exit(f"error: {folder} holds no dump")
    return compare(o.old, o.new, bits=o.bits, sentences=reasons(o.reasons), kinds=o.only)


if __name__ == "__main__":
    sys.exit(main())
