"""What FMUs of other tools need to run right, and what of them is no reason to refuse them."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from cosim import Adaptive, SetupError, System, run
from cosim.cli.main import main
from tests.conftest import ROOT, described, rewritten
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack, single_fmu_system

H = 0.1


def edited(path: Path, old: str, new: str) -> Path:
    """The same FMU with another text in its model description."""
    return rewritten(path, path, described((re.escape(old), new)))


def system_of(path: Path, **start: float) -> System:
    """The FMU by itself, with these start values."""
    system = single_fmu_system(path)
    return replace(system, start={**system.start, **{f"A.{k}": v for k, v in start.items()}})


def test_an_fmu_that_loses_its_start_values_gets_them_again(tmp_path: Path) -> None:
    """As those of 20-sim do when the experiment is set up."""
    result = run(
        system_of(pack(tmp_path / "A.fmu", forgets=True), a=-2.0, x0=3.0), stop=1.0, step=H
    )
    assert result["A.y"][-1] == pytest.approx(3.0 * np.exp(-2.0), rel=1e-12)
    assert result.provenance["parts"]["A"]["parameters"]["x0"] == 3.0
    assert not result.warnings


def test_a_start_value_that_the_fmu_changes_is_a_warning(tmp_path: Path) -> None:
    result = run(system_of(pack(tmp_path / "A.fmu", overrules=True), x0=3.0), stop=1.0, step=H)
    assert result.warnings == ["A: A.x0 = 3.0 was given, but the FMU starts with 1.0"]


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("saves", [True, False])
def test_a_run_that_does_not_go_back_says_so(
    compiled: bool, saves: bool, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Some FMUs take a step for good only then, such as the wheel of libcosim's quarter truck."""
    if not compiled:
        request.getfixturevalue("interpreted")
    fmu = pack(tmp_path / "A.fmu", commits=True, canGetAndSetFMUstate=saves)
    result = run(system_of(fmu), stop=1.0, step=H)
    assert result.provenance["loop"].startswith("compiled" if compiled else "Python")
    assert result["A.y"][-1] == pytest.approx(np.exp(-1.0), rel=1e-12)


@pytest.mark.parametrize("step", [1e-3, Adaptive(1e-3, control="doubling")])
@pytest.mark.parametrize("stop", [0.01, 0.3, 0.7, 1.1])
@pytest.mark.parametrize("substeps", [1, 3])
def test_no_step_goes_beyond_the_stop_time_by_a_bit(
    step: float | Adaptive, stop: float, substeps: int, tmp_path: Path
) -> None:
    fmu = pack(tmp_path / "A.fmu", punctual=True)
    result = run(system_of(fmu), stop=stop, step=step, substeps={"A": substeps})
    assert result["time"][-1] == stop


def test_an_fmu_may_log_from_a_separate_thread(tmp_path: Path) -> None:
    """Its step waits for the thread, and the thread for Python, which must not be locked."""
    fmu = pack(tmp_path / "A.fmu", chats=True)
    program = (
        "from cosim import System, run\n"
        "from pathlib import Path; import sys\n"
        "print(run(System({'A': Path(sys.argv[1])}), stop=1.0, step=0.1).warnings)"
    )
    command = [sys.executable, "-c", program, str(fmu)]
    how: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 120}
    done = subprocess.run(command, cwd=ROOT, check=False, **how)
    assert done.stdout == "['A: A works in a thread of its own']\n", done.stderr


def test_a_type_gives_its_bounds_and_its_nominal_value(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "A.fmu")
    limits = '<SimpleType name="Amount"><Real min="0" max="7" unit="1"/></SimpleType><SimpleType '
    edited(fmu, "<SimpleType ", limits)
    edited(fmu, '<Real start="1.0"/>', '<Real start="1.0" declaredType="Amount"/>')
    run(system_of(fmu, x0=7.0), stop=1.0, step=H)
    with pytest.raises(SetupError, match=r"A\.x0 \[1\] = 7\.5 must be at most 7\.0"):
        run(system_of(fmu, x0=7.5), stop=1.0, step=H)


def test_a_flaw_of_the_description_is_a_warning(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    fmu = edited(pack(tmp_path / "A.fmu"), 'fmiVersion="2.0"', 'fmiVersion="2.0" colour="red"')
    (warning,) = run(system_of(fmu), stop=1.0, step=H).warnings
    assert warning.startswith("A: modelDescription.xml is not valid: ") and "colour" in warning
    assert "A: modelDescription.xml is not valid: " in command_output(
        "check", fmu, "--stop", "1", "--step", "0.1"
    )
    assert "colour" in command_output(
        "run", fmu, "--stop", "1", "--step", "0.1", "--strict", code=2
    )


@pytest.mark.parametrize(
    ("file", "name"),
    [("0004_A", "part_0004_A"), ("model (1)", "model_1"), ("a.b", "a.b"), ("(2)", "part_2")],
)
def test_an_fmu_whose_file_is_no_name_gets_a_name(
    file: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(pack(tmp_path / f"{file}.fmu"))]) == 0
    assert capsys.readouterr().out.startswith(f"{name}: foreign, {file}.fmu")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--order", "nonsense"], "order ['nonsense'] must name each of A once"),
        (["--fmu-tolerance", "-1"], "tolerance = -1.0 must be above 0"),
        (["--substeps", "A=9999999999"], "substeps of A = 9999999999 must be at least 1 and below"),
        (["--input-order", "1000000"], "input_order = 1000000 must be at least 0 and at most 8"),
        (["--record", "A.t"], "A has no variable 't', only"),
        (["--output-step", "-1"], "output_step = -1.0 s must be above 0"),
    ],
)
def test_check_refuses_what_run_refuses(
    options: list[str], message: str, tmp_path: Path, command_output: CommandOutput
) -> None:
    arguments = [str(pack(tmp_path / "A.fmu")), "--stop", "1", "--step", "0.1", *options]
    assert f"error: {message}" in command_output("check", *arguments, code=1)
    assert message in command_output("run", *arguments, code=2)


def test_a_step_longer_than_the_run_is_refused(tmp_path: Path) -> None:
    """One as long as the run, but for rounding, is its single step."""
    system = system_of(pack(tmp_path / "A.fmu"))
    with pytest.raises(SetupError, match=r"from start to stop, 1\.0 s"):
        run(system, stop=1.0, step=1e7)
    result = run(system, stop=1.0, step=1.0 + 1e-9)
    assert result.provenance["steps"] == 1
    assert result["A.y"][-1] == pytest.approx(np.exp(-1.0), rel=1e-12)


@pytest.mark.parametrize(("start", "step"), [(1e15, 1e-3), (0.0, 1e-320)])
def test_steps_that_rounding_swallows_are_refused(
    start: float, step: float, tmp_path: Path
) -> None:
    with pytest.raises(SetupError, match="too short: its times would differ only by rounding"):
        run(system_of(pack(tmp_path / "A.fmu")), start=start, stop=start + 1.0, step=step)


def test_a_real_that_is_discrete_is_not_interpolated(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "A.fmu", counts=True)
    with ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    line = next(x for x in text.split("<ScalarVariable ") if x.startswith('name="last_step"'))
    edited(fmu, line, line.replace("continuous", "discrete"))
    result = run(system_of(fmu), stop=1.0, step=H, output_step=H / 4, record=["A.last_step"])
    assert set(np.round(result["A.last_step"], 12)) == {0.0, H}


@pytest.mark.parametrize(
    "settings",
    [{"step": Adaptive(1e-3, first=0.5)}, {"step": 0.5, "algorithm": "iterated"}],
    ids=["adaptive", "iterated"],
)
def test_a_trial_that_gives_no_number_is_taken_shorter(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    system = System(
        {"A": pack(tmp_path / "A.fmu", nan_above=0.2), "B": pack(tmp_path / "B.fmu", x0=0.5)},
        ["A.y -> B.u", "B.y -> A.u"],
        {f"{p}.{k}_in": 1 for p in "AB" for k in ("integer", "boolean", "enumeration")}
        | {"A.string_in": "", "B.string_in": ""},
    )
    result = run(system, stop=2.0, record=["A.y", "A.last_step"], **settings)
    assert result.provenance["status"] == "complete"
    assert result["A.last_step"].max() <= 0.2
    slow, fast = 0.75, 0.25 * np.exp(-4.0)
    near = 0.2 if "algorithm" in settings else 1e-2
    assert result["A.y"][-1] == pytest.approx(slow + fast, rel=near)


def test_a_run_without_files_shows_where_it_ends(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    fmu = pack(tmp_path / "A.fmu")
    assert f"A.y   {math.exp(-1):.6g}" in command_output(
        "run", fmu, "--stop", "1", "--step", "0.1", "--record", "A.y"
    )


def test_the_version_is_the_project_s(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
    text = (ROOT / "pyproject.toml").read_text()
    assert capsys.readouterr().out == f"cosim {tomllib.loads(text)['project']['version']}\n"


def test_an_fmu_without_outputs_says_that_nothing_is_recorded(tmp_path: Path) -> None:
    edit = described((r'causality="output"', 'causality="local"'), ("<Outputs>.*</Outputs>", ""))
    fmu = rewritten(pack(tmp_path / "A.fmu"), tmp_path / "B.fmu", edit)
    assert "no FMU has an output" in run(system_of(fmu), stop=1.0, step=0.5).warnings[-1]
