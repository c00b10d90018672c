"""The golden dump: what counts as equal, within error and changed, and that an entry is made again alike."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from benchmarks import golden
from benchmarks.golden_compare import CHANGED, EQUAL, ONLY, WITHIN, judge, reasons
from benchmarks.golden_items import KINDS, key_types

FIGURE = {"value": 40.0, "unit": "rad/s", "error": 0.02, "reason": ""}
HASH = {"rows.csv": {"columns": "time", "rows": 3, "sha256": "a"}}
ENTRY: dict[str, Any] = {
    "exit": 0,
    "figures": {
        "nu": FIGURE,
        "none": {"value": None, "unit": "s", "error": None, "reason": "jams"},
    },
    "verdict": ["Yes: it is 40.00 ± 0.02 rad/s, 2 times."],
    "tables": HASH,
}


def changed(*path: str, to: Any) -> dict[str, Any]:
    """The entry with another value at a path."""
    entry: dict[str, Any] = json.loads(json.dumps(ENTRY))
    node: Any = entry
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = to
    return entry


SHIFTED = {**FIGURE, "value": 40.03}
FAR = {**FIGURE, "value": 40.041}


@pytest.mark.parametrize(
    ("new", "status", "bits"),
    [
        (ENTRY, EQUAL, EQUAL),
        (changed("figures", "nu", to=SHIFTED), WITHIN, CHANGED),
        (changed("figures", "nu", to=FAR), CHANGED, CHANGED),
        (changed("figures", "nu", to={**FAR, "error": 0.03}), WITHIN, CHANGED),
        (changed("figures", "nu", to={**FIGURE, "error": None}), CHANGED, CHANGED),
        (changed("figures", "nu", to={**FIGURE, "unit": "rpm"}), CHANGED, CHANGED),
        (changed("figures", "none", "reason", to="stops"), CHANGED, CHANGED),
        (changed("figures", "more", to=FIGURE), CHANGED, CHANGED),
        (changed("verdict", to=["Yes: it is 40.03 ± 0.02 rad/s, 2 times."]), WITHIN, CHANGED),
        (changed("verdict", to=["Yes: it is 40.05 ± 0.02 rad/s, 2 times."]), CHANGED, CHANGED),
        (changed("verdict", to=["Yes: it is 40.00 ± 0.02 rad/s, 3 times."]), CHANGED, CHANGED),
        (changed("verdict", to=["No: it is 40.00 ± 0.02 rad/s, 2 times."]), CHANGED, CHANGED),
        (changed("verdict", to=[]), CHANGED, CHANGED),
        (changed("exit", to=1), CHANGED, CHANGED),
        (changed("tables", "rows.csv", "sha256", to="b"), WITHIN, CHANGED),
        (changed("tables", "rows.csv", "rows", to=4), CHANGED, CHANGED),
        (changed("tables", to={}), CHANGED, CHANGED),
    ],
)
def test_an_entry_is_equal_within_error_or_changed(
    new: dict[str, Any], status: str, bits: str
) -> None:
    assert judge(ENTRY, new, bits=False)[0] == judge(new, ENTRY, bits=False)[0] == status
    assert judge(ENTRY, new, bits=True)[0] == judge(new, ENTRY, bits=True)[0] == bits


def test_rows_without_figures_have_no_error_to_stay_within() -> None:
    rows = {"sha256": "a", "last": {"x": 1.0}}
    for other in ({**rows, "sha256": "b"}, {**rows, "last": {"x": 1.0 + 1e-15}}):
        assert judge(rows, other, bits=False)[0] == CHANGED
    assert judge({"tables": HASH}, {"tables": {}}, bits=False)[0] == CHANGED


def test_nan_is_equal_to_nan_and_a_zero_keeps_its_sign() -> None:
    assert judge({"x": math.nan}, {"x": math.nan}, bits=True)[0] == EQUAL
    assert judge({"x": math.nan}, {"x": 1.0}, bits=False)[0] == CHANGED
    assert judge({"x": 0.0}, {"x": -0.0}, bits=True)[0] == CHANGED
    undetermined = {"value": math.nan, "error": math.nan}
    assert judge({"f": undetermined}, {"f": undetermined}, bits=False)[0] == EQUAL
    assert (
        judge({"f": undetermined}, {"f": FIGURE | undetermined | {"value": 1.0}}, bits=False)[0]
        == CHANGED
    )


def test_errors_that_grow_are_stated() -> None:
    _, lines = judge(ENTRY, changed("figures", "nu", to={**SHIFTED, "error": 2.0}), bits=False)
    assert lines == [
        "1 of its numbers moved, by up to 1% of both errors; errors are up to 100 times as large"
    ]


def dumps(folder: Path, old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Two dumps with entries of one kind, as arguments of a comparison."""
    for name, entries in (("old", old), ("new", new)):
        (folder / name).mkdir()
        golden.write(folder / name / "questions.json", entries)
        golden.write(folder / name / "about.json", {"commit": name, "python": "3"})
    return [str(folder / "old"), str(folder / "new")]


def test_a_change_needs_a_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    far = changed("figures", "nu", to=FAR)
    folders = dumps(
        tmp_path,
        {"a": ENTRY, "b": ENTRY, "c --set A": ENTRY, "d": ENTRY},
        {"a": ENTRY, "b": changed("figures", "nu", to=SHIFTED), "c --set A": far, "e": ENTRY},
    )
    assert golden.main(["compare", *folders]) == 1
    lines = capsys.readouterr().out.splitlines()
    for line in (
        f"questions/a  {EQUAL}", f"questions/b  {WITHIN}", f"questions/c --set A  {CHANGED}",
        f"questions/d  {ONLY['old']}", f"questions/e  {ONLY['new']}",
        "questions: 1 equal, 1 within error, 1 changed, 1 only in OLD, 1 only in NEW",
        "3 changed items have no reason.",
        "    figures/nu: 40.0 +- 0.02 -> 40.041 +- 0.02",
    ):  # fmt: skip
        assert line in lines
    file = tmp_path / "reasons.txt"
    file.write_text(
        "# of today\nquestions/c*: The peak is a root.\nquestions/[de]: Renamed.\nx/y: No.\n"
    )
    assert golden.main(["compare", *folders, "--reasons", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"questions/c --set A  {CHANGED}, because The peak is a root." in lines
    assert f"questions/d  {ONLY['old']}, because Renamed." in lines
    assert "The reason for 'x/y' was not needed: no such item changed." in lines
    assert golden.main(["compare", *folders, "--reasons", str(file), "--bits"]) == 1


def test_reasons_and_folders_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "reasons.txt"
    file.write_text("questions/a\n")
    with pytest.raises(
        SystemExit, match=r"reasons.txt:1: 'questions/a' must read KIND/ITEM: SENTENCE"
    ):
        reasons(file)
    with pytest.raises(SystemExit, match="there is no file"):
        reasons(tmp_path / "missing.txt")
    with pytest.raises(SystemExit, match="holds no dump"):
        golden.main(["compare", str(tmp_path), str(tmp_path)])
    about = tmp_path / "about.json"
    golden.write(about, {"commit": "abc", "sources": "others"})
    with pytest.raises(SystemExit, match="holds a dump of other sources, of abc"):
        golden.claim(tmp_path)


def test_the_tree_of_keys_has_types_and_no_values() -> None:
    content = {"a": [1, 2, {"b": None}], "c": {"d": 1.5, "e": "x", "f": True}}
    assert key_types(content) == {
        "a": ["int", {"b": "null"}],
        "c": {"d": "float", "e": "str", "f": "bool"},
    }


def test_an_entry_is_reproducible_and_a_failure_is_an_entry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [str(tmp_path / name) for name in ("first", "second")]
    for folder in folders:
        (tmp_path / folder).mkdir()
        golden.claim(tmp_path / folder)
        entries = {x: golden.child("names", x)[0] for x in ("fmukit.record", "cosim.System")}
        golden.write(tmp_path / folder / "names.json", entries)
    assert golden.main(["compare", *folders, "--bits"]) == 0
    assert "names: 2 equal" in capsys.readouterr().out
    signature = entries["cosim.System"]["signature"]
    assert re.match(r"\(parts.*, wires.*, start", signature)
    failure, _ = golden.child("names", "cosim.nothing")
    assert re.search(r"exit status 1: .*no attribute 'nothing'", failure["failure"])


def test_every_kind_has_items() -> None:
    for kind in ("names", "rows", "cosim", "live"):
        items = KINDS[kind].items()
        assert items and len(set(items)) == len(items), kind
