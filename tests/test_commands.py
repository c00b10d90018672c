"""Every command says what it does and does nothing for --help, and refuses what it does not know before it does anything."""

import re
import runpy
import sys
from importlib import import_module
from pathlib import Path

import pytest

from cosim import __version__
from cosim.cli.main import COMMANDS as OF_COSIM
from scenarios import overview
from tests.conftest import ROOT

#: The command that has all others.
DRIVE = "drive-fmus"
#: Started by the project itself, with what no person would type.
CHILDREN = {"cosim.isolated", "cosim.analysis.crosscheck.__init__"}
SCRIPTS = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for pattern in ("*.py", "[a-z]*/**/*.py")
    for path in ROOT.glob(pattern)
    if '\nif __name__ == "__main__":\n' in path.read_text(encoding="utf-8")
)
BENCHMARKS = [script for script in SCRIPTS if script.startswith("benchmarks.")]
pytestmark = pytest.mark.filterwarnings("ignore:.* found in sys.modules after import of package")
COMMANDS = [
    ("examples.tutorial",),
    *(
        (script,)
        for script in SCRIPTS
        if not script.startswith("tests.") and script not in CHILDREN
    ),
    (DRIVE,),
    *((DRIVE, name) for name in ("cosim", "fmukit", "scenarios")),
    *((DRIVE, "cosim", name) for name in OF_COSIM),
    (DRIVE, "fmukit", "build"),
    *(
        (DRIVE, "scenarios", *words)
        for words in (["list"], ["run"], ["run", "resonance"], ["study"])
    ),
]


def status(monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str) -> int:
    """The exit status of a command that is given in a folder; nothing may be in the folder at its end."""
    script, *arguments = words
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    monkeypatch.setattr(sys, "path", [*sys.path])
    try:
        if script == DRIVE:
            sys.exit(overview.main())
        runpy.run_module(script, run_name="__main__")
    except SystemExit as end:
        assert not [*folder.iterdir()]
        return int(end.code or 0)
    raise AssertionError(f"{words} went on to its end")


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_command_explains_itself_and_refuses_what_it_does_not_know_and_does_nothing(
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert status(monkeypatch, tmp_path, *words, "--help") == 0
    usage, _, description = capsys.readouterr().out.partition("\n\n")
    name = " ".join(words) if words[0] == DRIVE else ""
    assert usage.startswith((f"usage: {name}", f"{DRIVE} {__version__}"))
    assert re.match(r"\w[^:]* \w", description), "a sentence about what it does"
    for unknown in (["--no-such-option"], ["surplus", "words", "here"]):
        assert status(monkeypatch, tmp_path, *words, *unknown) == 2
        out, error = capsys.readouterr()
        assert "error: " in error and not out


@pytest.mark.parametrize("script", BENCHMARKS)
def test_a_benchmark_says_which_claim_it_backs_and_the_page_names_it(script: str) -> None:
    file = f"{script.replace('.', '/')}.py"
    path, heading = import_module(script).CLAIM
    page = (ROOT / path).read_text(encoding="utf-8")
    assert re.search(rf"^#+ {re.escape(heading)}$", page, re.MULTILINE)
    assert file in page
