"""Many runs: whatever ends a call is told, rows are kept, sweeps go on, children die with their parent."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from cosim import SetupError, SimulationError, journal
from cosim.calls import Caller, Outcome
from cosim.cli.options import exit_code
from cosim.journal import DIGEST
from scenarios.project import PROJECT
from tests.conftest import ROOT, restore_ctrl_c, until
from tests.hosts import light, plane
from workbench import Context, catalog
from workbench.catalog import load_module
from workbench.question import read
from workbench.run import answer, ask
from workbench.runs import identity
from workbench.runs.folder import contents, unpack
from workbench.runs.runner import Runner

LONG = 100.0


@pytest.fixture
def worker() -> Iterator[Caller]:
    new_worker = Caller()
    yield new_worker
    new_worker.close()


def lines(ledger: Path) -> list[str]:
    return ledger.read_text().split() if ledger.exists() else []


def test_every_end_of_a_call_is_reported_and_the_next_call_is_done(
    worker: Caller, tmp_path: Path
) -> None:
    for mood, status, message, trace in (
        ("segfault", "crashed", "the run ended its process: SIGSEGV", "last words"),
        ("good", "ok", "", ""),
        ("leave", "crashed", "the run ended its process: exit code 0", ""),
        ("refuse", "refused", "this point is refused", ""),
        ("hang", "timeout", "no answer after 0.1 s", ""),
        ("fail", "failed", "ZeroDivisionError: no plane\nat all", "in fail"),
        ("exit", "failed", "SystemExit: ", "SystemExit"),
        ("lock", "failed", "AttributeError: Can't ", "Traceback"),
        ("victim", "crashed", "its process was killed 3 times: SIGKILL", ""),
        ("good", "ok", "", ""),
    ):
        limit = 0.1 if mood == "hang" else LONG
        outcome = worker.do(plane.be, (mood, str(tmp_path / mood)), limit)
        assert (outcome.status, outcome.answer) == (status, None)
        assert outcome.message.startswith(message) if message else outcome.message == ""
        assert trace in outcome.trace
    assert len(set(lines(tmp_path / "victim"))) == 3
    assert len({*lines(tmp_path / "refuse"), *lines(tmp_path / "hang")}) == 1
    assert outcome.seconds < LONG


def test_a_child_imports_what_its_call_needs(worker: Caller) -> None:
    modules = worker.do(light.modules, None, LONG).answer
    assert "tests.hosts.light" in modules
    assert not {"numpy", "scipy", "pandas", "fmpy", "rich", "matplotlib"} & set(modules)


CALL = """
import sys
from tests.hosts import light, plane
from cosim.calls import Caller
Caller().do(plane.be, tuple(sys.argv[1:]), None)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs prctl")
@pytest.mark.parametrize("mood", ["hang in c", "hang in python"])
def test_a_child_dies_with_its_killed_parent_and_holds_no_pipe(mood: str, tmp_path: Path) -> None:
    """From an unguarded script, whose output goes through a pipe; TMPDIR is empty after the next run."""
    ledger, temporary = tmp_path / "ledger", tmp_path / "temporary"
    temporary.mkdir()
    script = tmp_path / "script.py"
    script.write_text(CALL)
    parent = subprocess.Popen(
        [sys.executable, script, mood, ledger],
        env=os.environ | {"TMPDIR": str(temporary), "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    until(lambda: lines(ledger))
    (folder,) = (path for path in temporary.glob("cosim_*/*") if path.is_dir())
    parent.kill()
    assert parent.communicate(timeout=LONG)[0] == b""
    until(lambda: not Path(f"/proc/{lines(ledger)[0]}").exists())
    if mood == "hang in python":
        until(lambda: not folder.exists())


def test_a_sweep_is_the_same_for_any_number_of_jobs(tmp_path: Path) -> None:
    tasks = [(x, str(tmp_path / "ledger")) for x in (3.0, 1.0, 2.0, 5.0, 4.0, 1.0)]
    expected = [9.0, 3.0, 6.0, 15.0, 12.0, 3.0]
    for jobs in (1, 2, 8):
        assert list(Runner(jobs).map(plane.height, tasks, "heights")) == expected
    assert len(lines(tmp_path / "ledger")) == 18
    assert list(Runner(2).map(plane.height, [], "heights")) == []


MINE = """
'How much is twice as much?'
from typing import NamedTuple
import workbench
from workbench import Question
class Twice(Question):

    def solve(self, context):
        list(context.each(double, [Point(1.0)], "double"))
        raise KeyboardInterrupt
class Point(NamedTuple):
    x: float
def double(point): return (2.0 * point.x,)
"""


def test_a_sweep_of_a_question_in_a_separate_file_runs_in_processes(tmp_path: Path) -> None:
    """Though its name is that of another module, and its cases and answers are of its own types."""
    path = tmp_path / "tabnanny.py"
    path.write_text(MINE)
    page = load_module(str(path))
    context = Context({}, Runner(2, page=str(path)))
    points = [page.Point(1.0), page.Point(3.0)]
    assert list(context.each(page.double, points, "double")) == [(2.0,), (6.0,)]


def test_a_users_question_that_was_changed_takes_no_rows_of_its_predecessor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.py"
    for text in (MINE, MINE, MINE.replace("2.0", "3.0")):
        path.write_text(text)
        page = load_module(str(path))
        with pytest.raises(KeyboardInterrupt):
            answer(read(page), page.Twice(), {}, out=tmp_path)
    goes_on, dropped = capsys.readouterr().err.splitlines()
    assert goes_on == f"{tmp_path}: 1 row already there"
    assert dropped.endswith("runs: question has changed; they are dropped")


def test_a_task_that_crashes_ends_its_sweep_with_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def sweep(x: float) -> int:
        tasks = [(1.0, str(tmp_path / "ledger")), (x, "/dev/null")]
        return exit_code(lambda: len(list(Runner(2).map(plane.height, tasks, "heights"))))

    assert sweep(7.5) == 1
    message = "error: heights, 2 of 2 ((7.5, '/dev/null')): the run ended its process: SIGSEGV\n"
    assert capsys.readouterr().err == message
    assert sweep(6.5) == 2
    assert capsys.readouterr().err == "error: this point is refused\n"


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_sweep_goes_on_and_leaves_no_journal(
    jobs: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ledger = tmp_path / "ledger"
    tasks = [(float(x), str(ledger)) for x in (1, 2, 3, 4, 5)]

    def sweep(stop: float) -> None:
        with journal.open_outcomes(tmp_path, {}, passing=True) as rows:
            for height in Runner(jobs).map(plane.height, tasks, "heights", rows):
                if height == stop:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(9.0)
    assert {"1.0", "2.0", "3.0"} <= set(lines(ledger))
    ledger.write_text("")
    sweep(0.0)
    assert set(lines(ledger)) <= {"4.0", "5.0"}
    assert lines(ledger) == ["4.0", "5.0"] or jobs == 2
    assert "rows already there" in capsys.readouterr().err
    assert not (tmp_path / journal.OUTCOMES).exists()


SWEEP = """
import sys
from cosim.cli.options import exit_code
from cosim.journal import DIGEST
from tests.hosts import light, plane
from workbench.runs.runner import Runner
ledger = sys.argv[1]
tasks = [("good", ledger), ("hang", ledger), ("hang", ledger)]
sys.exit(exit_code(lambda: len(list(Runner(2).map(plane.be, tasks, "moods")))))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_a_sweep_and_its_children(number: int, tmp_path: Path) -> None:
    ledger = tmp_path / "ledger"
    process = subprocess.Popen(
        [sys.executable, "-c", SWEEP, ledger],
        env=os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=restore_ctrl_c,  # noqa: PLW1509
    )
    until(lambda: len(lines(ledger)) == 3)
    os.killpg(process.pid, number)
    assert process.communicate(timeout=LONG)[1] == b"interrupted\n"
    assert process.returncode == 130
    assert not [pid for pid in lines(ledger) if Path(f"/proc/{pid}").exists()]
    assert list(tmp_path.iterdir()) == [ledger]


KEEP = """
import os, sys
from pathlib import Path
from cosim import journal
from cosim.calls import Outcome
with journal.open_outcomes(Path(sys.argv[1]), {"x": 1}) as kept:
    for n in range(100):
        kept[n] = Outcome("ok", n / 3)
    print("kept", flush=True)
    sys.stdin.read()
"""


def test_a_killed_session_keeps_every_row_and_shuts_out_a_second_session(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KEEP, tmp_path],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"kept\n"
    with pytest.raises(SetupError, match="another process is writing "):
        opened(tmp_path, {"x": 1})
    process.kill()
    process.communicate()
    assert opened(tmp_path, {"x": 1}) == {n: n / 3 for n in range(100)}


def opened(folder: Path, who: dict[str, Any]) -> dict[Any, Any]:
    with journal.open_outcomes(folder, who) as rows:
        return {n: rows[n].answer for n in range(len(rows))}


def changed(content: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Each leaf of a tree by its name, and the tree with that leaf another one, and without it."""
    for key, value in content.items():
        name = f'"{key}"' if "." in key else key
        if isinstance(value, dict) and value:
            for below, other in changed(value):
                yield f"{name}.{below}", content | {key: other}
        else:
            yield name, content | {key: "0" * 16 if isinstance(value, str) else [value]}
            yield name, {k: v for k, v in content.items() if k != key}


def test_rows_of_another_identity_are_refused_whatever_differs(tmp_path: Path) -> None:
    who = {
        "file": {"grid": {"motor.T": [0.05, 0.06]}, "timeout": 3.0},
        "fmus": {"motor": "{12345678-1234-1234-1234-123456789abc}"},
        **identity.computation("some", {}),
        "inputs": "f" * 16,
    }
    who = json.loads(json.dumps(who))
    opened(tmp_path, who)
    assert opened(tmp_path, who) == {}
    for name, other in changed(who):
        with pytest.raises(SetupError) as refusal:
            opened(tmp_path, other)
        message = str(refusal.value)
        assert message.startswith(
            f"{tmp_path / journal.OUTCOMES} contains the rows of other runs: {name} "
        ), message
        assert not DIGEST.search(message.replace(str(tmp_path), ""))
    assert opened(tmp_path, who) == {}


def test_an_option_without_effect_is_refused() -> None:
    with pytest.raises(
        SetupError, match=r"^scheduler: this question does its runs together in one"
    ):
        assert Context({}, Runner(scheduler="tcp://x:1")).jobs
    for name in catalog.names(PROJECT.home):
        if PROJECT.load(name).is_sequential:
            with pytest.raises(SetupError, match=f"^jobs = 2 has no effect on {name}, whose runs"):
                ask(PROJECT, name, {}, jobs=2)


def test_no_process_for_runs_is_a_sentence(worker: Caller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.child._live", sys.exit)
    with pytest.raises(SetupError, match="no process for runs can be started: "):
        worker.do(plane.be, ("good", "/dev/null"), None)


def test_a_failure_in_a_child_brings_its_traceback(tmp_path: Path) -> None:
    tasks = [("fail", str(tmp_path / "ledger"))] * 2
    with pytest.raises(SimulationError, match=r"(?s)ZeroDivisionError: no plane.*in fail"):
        list(Runner(2).map(plane.be, tasks, "moods"))
    with pytest.raises(ZeroDivisionError):
        list(Runner(1).map(plane.be, tasks, "moods"))


def test_a_damaged_file_among_the_inputs_is_written_anew(tmp_path: Path) -> None:
    """Runs would be refused for it, for ever."""
    (tmp_path / "A.fmu").write_bytes(b"an FMU")
    files, folder = contents([tmp_path / "A.fmu"]), tmp_path / "inputs"
    unpack(files, folder)
    for damage in (lambda file: file.write_bytes(b"an"), lambda file: file.unlink()):
        damage(folder / "A.fmu")
        unpack(files, folder)
        assert (folder / "A.fmu").read_bytes() == b"an FMU"
    assert [path.name for path in folder.iterdir()] == ["A.fmu"]


class Slow(Runner):
    """Whose calls take a second for each task, and for one of them for ever; it counts what it is asked for."""

    def stream(
        self,
        function: Any,
        tasks: Mapping[int, Any],
        limits: Mapping[int, float] = MappingProxyType({}),
    ) -> Any:
        for key, call in tasks.items():
            CALLS.append(call)
            is_late = 13 in call or len(call) > limits.get(key, math.inf)
            yield key, Outcome("timeout") if is_late else Outcome("ok", function(call))


CALLS: list[list[int]] = []


def test_a_call_of_several_cases_has_the_time_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is late is halved until the case that hangs is alone; what others have done is kept."""
    tasks = {k: k for k in range(64)}

    def done(call: list[int]) -> list[Outcome]:
        return [Outcome("ok", x) for x in call]

    for timeout in (1.0, 1.5, None):
        CALLS.clear()
        found = dict(Slow().outcomes(done, tasks, "squares", timeout=timeout, at_once=8))
        assert [k for k, outcome in found.items() if outcome.status != "ok"] == [13]
        assert len(found) == 64
        first, again = CALLS[:8], CALLS[8:]
        assert [x for call in first for x in call] == list(range(64))
        assert again == [[8, 9, 10, 11], [12, 13, 14, 15], [12, 13], [14, 15], [12], [13]]
