"""Which broken promises of an FMU are found, by which check, and that none is seen where all are kept."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from cosim import Crosscheck, SetupError, crosscheck
from cosim.analysis.crosscheck import checks
from cosim.analysis.crosscheck.checks import CHECKS, FAILED, NOT_OFFERED, NOT_RUN, PASSED
from cosim.analysis.crosscheck.subject import Subject
from cosim.fmu.messages import quiet
from tests.conftest import ROOT, described, rewritten
from tests.cosim.conftest import CommandOutput
from tests.cosim.faulty import DEADLY, FAULTS, FAULTS3, pack
from tests.cosim.foreign import pack as foreign
from tests.cosim.third import pack as third
from tests.fmukit.test_native import built

QUICK = ("CrankConveyor", "GravityOrientator")


def verdicts(path: Path, *names: str) -> Crosscheck:
    """What the checks say, in this process."""
    subject = Subject(path)
    with quiet():
        entries = tuple(checks.checked(subject, name) for name in names or CHECKS)
    return Crosscheck(str(path), "", "", "", entries)


def failed(report: Crosscheck) -> list[str]:
    return [verdict.check for verdict in report.verdicts if verdict.status == FAILED]


@pytest.mark.parametrize(
    ("version", "discard"),
    [
        ("2.0", "a step of 5 s is discarded, one to 2 s is accepted"),
        ("3.0", "a step of 5 s is discarded, 60 rows after it bit for bit"),
    ],
)
def test_an_fmu_that_keeps_its_promises_passes_every_check(
    version: str, discard: str, tmp_path: Path
) -> None:
    report = verdicts(pack(tmp_path / "sound.fmu", version=version))
    assert {verdict.status for verdict in report.verdicts} == {PASSED}, report.text()
    assert report["discard"].detail == discard


FAULTS_OF = {"2.0": FAULTS, "3.0": FAULTS3}
SAMPLE3 = ("bytes lack a value", "moves in a discard")
SEEDED = [("2.0", fault) for fault in FAULTS]
SEEDED += [
    ("3.0", fault) if fault in SAMPLE3 else pytest.param("3.0", fault, marks=pytest.mark.slow)
    for fault in FAULTS3
]


@pytest.mark.parametrize(("version", "fault"), SEEDED)
def test_every_fault_fails_its_checks_and_no_more(version: str, fault: str, tmp_path: Path) -> None:
    path, fails = pack(tmp_path / "faulty.fmu", fault, version), FAULTS_OF[version][fault]
    # Thousands of steps, and a process for each wrong call: where that is the fault, and on FMUs without any.
    names = [x for x in CHECKS if x in fails or x not in ("memory", "call order")]
    report = crosscheck(path) if "leaks" in fault else verdicts(path, *names)  # no memory about
    assert ", ".join(failed(report)) == fails, report.text()
    if fault == "fails":
        assert {v.status for v in report.verdicts[3:]} == {NOT_RUN}


def test_every_check_has_a_fault_that_fails_it() -> None:
    for faults in (FAULTS, FAULTS3):
        assert len(faults) + len(DEADLY) >= 20
        assert {check for some in faults.values() for check in some.split(", ")} == CHECKS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("fault", DEADLY)
def test_a_crash_or_a_hang_fails_no_further_check(fault: str, version: str, tmp_path: Path) -> None:
    report = crosscheck(pack(tmp_path / "deadly.fmu", fault, version), timeout=8.0)
    assert ", ".join(failed(report)) == DEADLY[fault], report.text()
    detail = "no answer within 8 s" if "hangs" in fault else "killed by signal SIG"
    assert all(detail in report[check].detail for check in failed(report))
    assert len(report.verdicts) == len(CHECKS)


def test_the_command_survives_a_crash_and_writes_its_reports(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    fmu, page, junit = (tmp_path / name for name in ("deadly.fmu", "it.html", "it.xml"))
    pack(fmu, "crashes")
    text = command_output("crosscheck", fmu, "--out", page, "--out", junit, code=1)
    assert "memory                   2.1.5  FAILED  the process was killed by signal SIG" in text
    assert "memory, FMI 2.0.4, 2.1.5: 10 000 steps" in text and "19 passed, 1 failed" in text
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("20", "1", "0")
    (case,) = [case for case in suite if case.find("failure") is not None]
    assert case.get("name") == "memory" and "2.1.5" in str(case.findtext("failure"))
    assert page.read_text().count("<tr>") == 21 and "an FMU crashed" in page.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone.fmu"], "there is no file"),
        (["sound.fmu", "--step", "0"], "step = 0.0 s must be a finite number above 0"),
        (["sound.fmu", "--timeout", "nan"], "argument --timeout: 'nan' is not a number"),
        (["sound.fmu", "--out", "it.pdf"], "it.pdf must end in one of .txt, .xml, .html, .svg"),
        (["other.fmu"], "offers model exchange only; this master runs co-simulation by FMI 2.0"),
    ],
)
def test_bad_input_is_refused_in_a_line(
    arguments: Any, message: str, tmp_path: Path, command_output: CommandOutput
) -> None:
    sound = pack(tmp_path / "sound.fmu")
    other = (r"(?s)<CoSimulation.*?/>", '<ModelExchange modelIdentifier="faulty"/>')
    rewritten(sound, tmp_path / "other.fmu", described(other))
    assert message in command_output("crosscheck", tmp_path / arguments[0], *arguments[1:], code=2)


@pytest.mark.parametrize(
    ("flag", "names"),
    [
        ("canGetAndSetFMUstate", "state"),
        ("canSerializeFMUstate", "serialization"),
        ("providesDirectionalDerivative", "directional derivatives"),
        ("canHandleVariableCommunicationStepSize", "step size, output dependencies, discard"),
    ],
)
def test_what_is_not_offered_is_not_passed(flag: str, names: str, tmp_path: Path) -> None:
    without = described((f'{flag}="true"', f'{flag}="false"'))
    fmu = rewritten(pack(tmp_path / "sound.fmu"), tmp_path / "less.fmu", without)
    report = verdicts(fmu, *names.split(", "))
    assert {(v.status, v.detail) for v in report.verdicts} == {(NOT_OFFERED, f"{flag} is false")}
    with pytest.raises(SetupError, match="must end in"):
        report.write(tmp_path / "it.pdf")


@pytest.mark.parametrize("name", QUICK)
def test_no_check_fails_on_a_native_fmu_of_the_project(name: str, fmus: Path) -> None:
    report = verdicts(fmus / "native" / f"{name}.fmu")
    assert failed(report) == [], report.text()


def test_no_check_fails_on_fmi_3_with_events_arrays_and_all_types(tmp_path: Path) -> None:
    names = ("reset", "state", "output dependencies", "initial dependencies")
    for fmu in (built("GravityOrientator"), third(tmp_path / "third.fmu")):
        report = verdicts(fmu, *names)
        assert {v.status for v in report.verdicts} == {PASSED}, report.text()


@pytest.mark.slow
def test_no_check_fails_on_any_fmu_of_the_project(fmus: Path) -> None:
    all_of_them = sorted(fmus.rglob("*.fmu"))
    assert len(all_of_them) >= 19
    for path in all_of_them:
        report = crosscheck(path)
        assert report.passed and report["run"].status == PASSED, report.text()


@pytest.mark.parametrize("step", [0.01, 1e-7])
def test_the_convergence_order_of_an_fmu_is_measured(step: float, tmp_path: Path) -> None:
    """Of Euler's method, with which nothing is wrong; by longer steps where those asked for show none."""
    subject = Subject(pack(tmp_path / "euler.fmu", "one Euler step"), step)
    report = checks.checked(subject, "step size")
    assert report.status == PASSED and report.detail.startswith("order 1.0: ")
    assert ("0.04 and 0.02 s" in report.detail) is (step == 0.01)


def test_a_count_over_an_instance_s_life_fails_reset_and_state(tmp_path: Path) -> None:
    report = verdicts(foreign(tmp_path / "foreign.fmu"))
    assert failed(report) == ["stop time", "reset", "state"]  # it shows the stop time, too
    assert "steps after step 1 is 31 after a reset, not 1" in report["reset"].detail
    assert "live_states after step 21 is 1 after a state is saved" in report["state"].detail


@pytest.mark.parametrize("version", ["2.0", pytest.param("3.0", marks=pytest.mark.slow)])
def test_each_instance_has_a_process_where_the_fmu_needs_it(version: str, tmp_path: Path) -> None:
    report = crosscheck(pack(tmp_path / "once.fmu", "once", version))
    assert failed(report) == [], report.text()
    exceptions = [v.check for v in report.verdicts if v.status != PASSED]
    assert exceptions == ["instances"]


def test_a_crash_in_the_process_of_an_instance_is_reported(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "once.fmu", "crashes")
    flag = ("<CoSimulation", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"')
    report = crosscheck(rewritten(fmu, tmp_path / "crashes.fmu", described(flag)))
    assert failed(report) == ["memory"]
    assert report["memory"].detail == "the process was killed by signal 11 (an FMU crashed)"


def test_a_derivative_at_a_kink_is_that_of_either_side_or_between(tmp_path: Path) -> None:
    report = verdicts(pack(tmp_path / "kink.fmu", "kink"), "directional derivatives")
    assert failed(report) == [], report.text()
    assert "at a kink" in report["directional derivatives"].detail
    wrong = verdicts(pack(tmp_path / "wrong.fmu", "kink, wrong"), "directional derivatives")
    assert failed(wrong) == ["directional derivatives"]
    assert "0.99995 and 2.00005, on two sides of a kink" in wrong["directional derivatives"].detail


def test_what_does_not_repeat_is_reported_once(tmp_path: Path) -> None:
    report = verdicts(pack(tmp_path / "noisy.fmu", "not repeatable"))
    assert failed(report) == ["repetition"]
    assert "the other checks leave out y" in report["repetition"].detail


def test_the_action_is_valid_and_its_options_exist() -> None:
    """It is a composite action by the schema of its host, and calls the command as it is."""
    action = ROOT / "actions" / "crosscheck" / "action.yml"
    program = Path(sys.executable).with_name("check-jsonschema")
    schema = ["--builtin-schema", "vendor.github-actions", str(action)]
    done = subprocess.run([program, *schema], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    call = action.read_text().rpartition('cosim" crosscheck ')[2]
    for option in re.findall(r"--\w+", call):
        assert option in {"--timeout", "--step", "--out"}
    for suffix in re.findall(r"crosscheck(\.\w+)\"", call):
        assert suffix in Crosscheck.FORMATS
