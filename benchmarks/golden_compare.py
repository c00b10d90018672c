"""How two golden dumps differ: every item is equal, within error or changed, with or without a reason."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

#: most differences of an item that are printed
MOST_LINES = 6
#: most letters of a value that are printed
MOST_LETTERS = 120
EQUAL, WITHIN, CHANGED = "equal", "within error", "changed"
ONLY = {"old": "only in OLD", "new": "only in NEW"}
VALUE = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
#: a number in a text, with its error where it has one
NUMBER = re.compile(rf"(?<![\w.])({VALUE})(?:\s*(?:±|\+-)\s*({VALUE}))?")

Items = dict[str, Any]


class Difference(NamedTuple):
    """A difference at a path within an entry; `status` is WITHIN or CHANGED.

    `share` is the distance of two figures as a share of the sum of their errors, `growth` the new error over
    the old one; both are 0 where there is no figure.
    """

    path: str
    status: str
    text: str
    share: float = 0.0
    growth: float = 0.0


def read(path: Path) -> Items:
    """The content of a JSON file; empty if there is none."""
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def differences(old: Any, new: Any, *, bits: bool, path: str = "") -> Iterator[Difference]:
    """
    Yield where two entries differ, or two values at a path within them.

    Parameters
    ----------
    old, new : JSON data
        What stands in the two dumps. Two values that are not a number are equal.
    bits : bool
        Whether nothing may differ. Otherwise a figure, and a number with its error in a text, may differ
        by the sum of both errors, and the rows of an item that has figures may have another hash.
    path : str
        Where the values are, keys with slashes between them.
    """
    if json.dumps(old, sort_keys=True) == json.dumps(new, sort_keys=True):
        return
    if isinstance(old, dict) and isinstance(new, dict):
        if not bits and {"value", "error"} <= old.keys() & new.keys():
            yield from figures(old, new, path)
            return
        by_figures = not bits and bool(old.get("figures") and new.get("figures"))
        for key in sorted(old.keys() | new.keys()):
            where = f"{path}/{key}".lstrip("/")
            if key not in old or key not in new:
                yield Difference(where, CHANGED, ONLY["old" if key in old else "new"])
            elif by_figures and key == "tables":
                yield from rows(old[key], new[key], where)
            else:
                yield from differences(old[key], new[key], bits=bits, path=where)
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield Difference(path, CHANGED, f"{len(old)} entries became {len(new)}")
        for i, (a, b) in enumerate(zip_longest(old, new), 1):
            yield from differences(a, b, bits=bits, path=f"{path}/{i}")
    elif isinstance(old, str) and isinstance(new, str) and not bits:
        yield from texts(old, new, path)
    else:
        yield Difference(path, CHANGED, f"{short(old)} -> {short(new)}")


def figures(old: Items, new: Items, path: str) -> Iterator[Difference]:
    """Two figures that are not equal: all but value and error must be."""
    for key in sorted((old.keys() | new.keys()) - {"value", "error"}):
        if old.get(key) != new.get(key):
            text = f"{short(old.get(key))} -> {short(new.get(key))}"
            yield Difference(f"{path}/{key}", CHANGED, text)
    values, errors = (old["value"], new["value"]), (old["error"], new["error"])
    if repr(values[0]) != repr(values[1]) or errors[0] != errors[1]:
        yield numbers(values, errors, path)


def numbers(values: tuple[Any, Any], errors: tuple[Any, Any], path: str) -> Difference:
    """Two numbers with errors: within error if they differ by at most the sum of both errors."""
    text = f"{values[0]!r} +- {errors[0]!r} -> {values[1]!r} +- {errors[1]!r}"
    if not all(isinstance(x, (int, float)) for x in (*values, *errors)):
        return Difference(path, CHANGED, text)
    distance, total = abs(values[0] - values[1]), errors[0] + errors[1]
    share = distance / total if total else float(distance > 0.0) * 2.0
    growth = errors[1] / errors[0] if errors[0] else 0.0
    return Difference(path, WITHIN if distance <= total else CHANGED, text, share, growth)


def rows(old: Items, new: Items, path: str) -> Iterator[Difference]:
    """Tables behind figures: their names, columns and numbers of rows are equal, their hashes may differ."""
    for difference in differences(old, new, bits=True, path=path):
        if difference.path.endswith("/sha256"):
            difference = difference._replace(status=WITHIN, text="other rows")
        yield difference


def texts(old: str, new: str, path: str) -> Iterator[Difference]:
    """Two texts: the words are equal, and so are the numbers, unless their errors are stated with them."""
    wordings = [" ".join(NUMBER.sub("#", text).split()) for text in (old, new)]
    status = WITHIN if wordings[0] == wordings[1] else CHANGED
    share = growth = 0.0
    for a, b in zip(NUMBER.findall(old), NUMBER.findall(new)):
        if a == b:
            continue
        if not (a[1] and b[1]):
            status = CHANGED
            continue
        pair = numbers((float(a[0]), float(b[0])), (float(a[1]), float(b[1])), path)
        share, growth = max(share, pair.share), max(growth, pair.growth)
        status = CHANGED if pair.status == CHANGED else status
    yield Difference(path, status, f"{short(old)} -> {short(new)}", share, growth)


def short(value: Any) -> str:
    """A value in a line."""
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return repr(text) if len(text) <= MOST_LETTERS else repr(text[:MOST_LETTERS] + "...")


def reasons(path: Path | None) -> dict[str, str]:
    """
    Read the reasons for changes.

    Parameters
    ----------
    path : Path or None
        A file with lines `PATTERN: SENTENCE`; `*` in a pattern stands for any text. Empty lines and lines
        that begin with # are comments.

    Returns
    -------
    dict
        The sentences by pattern of KIND/ITEM.

    Raises
    ------
    SystemExit
        If there is no such file, or a line has no pattern or no sentence.
    """
    sentences: dict[str, str] = {}
    if path is not None and not path.is_file():
        sys.exit(f"error: there is no file {path}")
    for count, line in enumerate(path.read_text(encoding="utf-8").splitlines() if path else (), 1):
        if not line.strip() or line.startswith("#"):
            continue
        pattern, colon, sentence = line.partition(": ")
        if not colon or "/" not in pattern or not sentence.strip():
            sys.exit(f"error: {path}:{count}: {line!r} must read KIND/ITEM: SENTENCE")
        sentences[pattern.strip()] = sentence.strip()
    return sentences


def compare(
    old: Path, new: Path, *, bits: bool, sentences: Mapping[str, str], kinds: Sequence[str]
) -> int:
    """
    Print for every item of two dumps how it changed, and a summary for each kind.

    Parameters
    ----------
    old, new : Path
        Folders of two dumps.
    bits : bool
        Whether nothing may differ, not even within errors.
    sentences : mapping
        Reasons for changes by pattern, as `reasons` reads them.
    kinds : sequence of str
        The kinds to compare.

    Returns
    -------
    int
        The exit status: 0, or 1 if something changed and has no reason.
    """
    print_origins(read(old / "about.json"), read(new / "about.json"))
    counts: dict[str, Counter[str]] = {}
    used: set[str] = set()
    failures = 0
    for kind in kinds:
        entries = [read(folder / f"{kind}.json") for folder in (old, new)]
        counts[kind] = Counter()
        for item in sorted(entries[0].keys() | entries[1].keys()):
            name, pair = f"{kind}/{item}", [x.get(item) for x in entries]
            failures += any(x is not None and "failure" in x for x in pair)
            status, lines = judge(pair[0], pair[1], bits=bits)
            pattern = next((p for p in sentences if fnmatchcase(name, p)), None)
            if status in (EQUAL, WITHIN) or pattern is None:
                counts[kind][status] += 1
            else:
                used.add(pattern)
                counts[kind][f"{status}, with a reason"] += 1
                status += f", because {sentences[pattern]}"
            print(f"{name}  {status}")
            print("".join(f"    {line}\n" for line in lines), end="")
    for pattern in sentences.keys() - used:
        print(f"The reason for {pattern!r} was not needed: no such item changed.")
    if failures:
        print(f"{failures} items failed in a dump: an equal failure is no result.")
    return summarise(counts)


def judge(old: Items | None, new: Items | None, *, bits: bool) -> tuple[str, list[str]]:
    """How an entry changed, and the lines that say where."""
    if old is None or new is None:
        return ONLY["old" if new is None else "new"], []
    deviations = list(differences(old, new, bits=bits))
    changes = [x for x in deviations if x.status == CHANGED]
    if changes:
        lines = [f"{x.path}: {x.text}" for x in changes[:MOST_LINES]]
        more = len(changes) - MOST_LINES
        return CHANGED, lines + [f"and {more} more"] * (more > 0)
    if not deviations:
        return EQUAL, []
    figured = [x for x in deviations if x.share or x.growth]
    share = max((x.share for x in figured), default=0.0)
    growth = max((x.growth for x in figured), default=0.0)
    text = f"{len(figured)} of its numbers moved, by up to {share:.0%} of both errors"
    text += f"; errors are up to {growth:.3g} times as large" if growth else ""
    tables = [f"{x.path}: {x.text}" for x in deviations if x.text == "other rows"]
    return WITHIN, [text, *tables[:MOST_LINES]]


def print_origins(old: Items, new: Items) -> None:
    """Print what two dumps are of, and on which machine where that differs."""
    for name, about in (("OLD", old), ("NEW", new)):
        changes = " and uncommitted changes" if about.get("changes") else ""
        print(f"{name}: commit {about.get('commit', 'unknown')}{changes}")
    for key in sorted((old.keys() | new.keys()) - {"commit", "sources", "changes"}):
        if old.get(key) != new.get(key):
            print(f"The dumps differ in {key}: {old.get(key)} and {new.get(key)}")


def summarise(counts: Mapping[str, Counter[str]]) -> int:
    """Print how many items of each kind are equal and how many changed; 1 if one has no reason."""
    print()
    for kind, counter in counts.items():
        print(
            f"{kind}: "
            + (", ".join(f"{n} {status}" for status, n in counter.items()) or "no items")
        )
    unexplained = sum(
        n for counter in counts.values() for status, n in counter.items()
        if status in (CHANGED, *ONLY.values())
    )  # fmt: skip
    items = "item has" if unexplained == 1 else "items have"
    print(
        f"{unexplained} changed {items} no reason."
        if unexplained
        else "No change is without a reason."
    )
    return min(1, unexplained)
