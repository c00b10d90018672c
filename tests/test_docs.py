"""Every command and every block of code of the pages is executed, but for what is listed here."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from fmukit.fmu.page import EXTERNAL_DEPENDENCIES
from tests.conftest import ROOT, ask
from tests.pictures import differ
from workbench.export import draw_answer

PAGES = sorted(
    str(path.relative_to(ROOT))
    for path in (*ROOT.glob("*.md"), ROOT / "fmus" / "README.md", *ROOT.glob("docs/**/*.md"))
    if path.name != "CHANGELOG.md"
)
TEST_COMMAND = " pytest"
SITE_COMMAND = ".venv/bin/uv run --no-dev --extra site python -m gallery"
#: how the commands begin that measure instead of testing: minutes to hours, and apart from the tests
BENCHMARK = ".venv/bin/python benchmarks/"
SLOW = {
    "python3 -m venv .venv && .venv/bin/pip install -q uv && .venv/bin/uv pip install -q -e "
    '".[page]" && .venv/bin/uv cache clean -q ziglang && .venv/bin/scenarios run resonance',
    ".venv/bin/scenarios run resonance --set B",
    ".venv/bin/scenarios run resonance --start conveyor.spring.c=7e5",
    '.venv/bin/scenarios run resonance --speed 420rpm --nameplate "5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, '
    '3.43:1, 0.02 kg.m2" --start conveyor.rotor.J=0.725',
    '.venv/bin/scenarios run resonance --speed 330rpm --limit 25 --nameplate "5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, '
    '3.43:1, 0.02 kg.m2" --start conveyor.rotor.J=0.725 --remedies',
    ".venv/bin/scenarios run orbit --speed 34.56 --rated-torque 125.1 --limit 25 --start motor.characteristic=kloss "
    "--start motor.kloss.tau_b=350.3 --start motor.kloss.w_s=45.8 --start motor.kloss.s_b=0.2165 --start motor.T=0.0147 "
    "--start conveyor.rotor.J=0.725 --start conveyor.spring.c=680e3 --tolerance conveyor.spring.c=2% --tolerance conveyor.rotor.J=2%",
    ".venv/bin/python tests/test_refusals.py",
    ".venv/bin/scenarios run run_up",
    ".venv/bin/scenarios run resonance_map",
    ".venv/bin/scenarios run resonance_map --y conveyor.rotor.J=0.2:1.2:40",
    ".venv/bin/scenarios run resonance_map --y conveyor.spring.c=4e5:1.2e6:40",
    ".venv/bin/scenarios run resonance_map --x motor.T=0.015:0.16:60:log --y conveyor.rotor.J=0.2:1.2:40 "
    "--speed 45",
    ".venv/bin/scenarios study studies/drive_tolerances.toml",
    ".venv/bin/python -m dask scheduler --host 127.0.0.1 --port 8786 --no-dashboard "
    "--dashboard-address 127.0.0.1:0 &",
    ".venv/bin/python -m dask worker tcp://127.0.0.1:8786 --host 127.0.0.1 --nworkers 2 --nthreads 1 "
    "--no-dashboard --dashboard-address 127.0.0.1:0 &",
    ".venv/bin/scenarios study studies/rotor_speed.toml --scheduler tcp://127.0.0.1:8786 --out results/cluster",
    "kill %1 %2",
    ".venv/bin/scenarios study studies/records.toml",
    ".venv/bin/scenarios run resonance --speed 38.0 "
    "--rated-torque 80 --start motor.B=166.6 --start motor.T=0.09 --start "
    "conveyor.rotor.J=0.52 --start conveyor.trough.m=201.7 --start conveyor.trough.d=4286 "
    "--start conveyor.spring.c=717e3",
    ".venv/bin/scenarios run iron_identify --data "
    "examples/iron_record.csv --map time=t --map iron.w=n --map motor.tau=M*0.02:N.m "
    "--known iron.iron.m=4.4+-1%",
    ".venv/bin/scenarios run orientator_identify --data "
    "examples/orientator_record.csv --map orientator.w=n --map "
    "orientator.t_falling=falling --map orientator.t_joint=joint --map "
    "orientator.t_turning=turning --map orientator.t_released=released --noise "
    "orientator.t_falling=0.5ms --noise orientator.t_joint=0.5ms --noise "
    "orientator.t_turning=0.5ms --noise orientator.t_released=0.5ms --known "
    "orientator.chute.H=0.04+-1%",
    ".venv/bin/scenarios run mean_values",
    ".venv/bin/scenarios run resonance --theory classical",
    ".venv/bin/scenarios run induction_motor",
    ".venv/bin/scenarios run rod_force",
    ".venv/bin/scenarios run iron_cycle --animate",
    ".venv/bin/scenarios run iron_bounce",
    ".venv/bin/scenarios run iron_cycle --compare dimensions",
    ".venv/bin/scenarios run iron_orders",
    ".venv/bin/scenarios run iron_start",
    ".venv/bin/scenarios run orientation_time",
    ".venv/bin/scenarios run orientator_cycle --animate",
    ".venv/bin/scenarios run orientation_time --compare formula",
    ".venv/bin/scenarios run orientation_time --compare neglected",
    ".venv/bin/scenarios run packing_line",
    ".venv/bin/scenarios run sommerfeld",
    ".venv/bin/scenarios run speed_step",
    ".venv/bin/python build_fmus.py --docs",
    ".venv/bin/python build_fmus.py --flavour fmi3",
    ".venv/bin/python -m tools.release",
    ".venv/bin/scenarios study studies/rotor_speed.toml",
    ".venv/bin/scenarios study examples/run_down.toml",
    ".venv/bin/fmukit build results/my_wheel.py --flavour both --out results",
    ".venv/bin/scenarios run identify "
    "--data examples/conveyor_record.csv --map time=t --map conveyor.w=n "
    "--map motor.tau=M*0.8:N.m --rated-torque 80 --known conveyor.trough.m=200+-5 "
    "--known conveyor.spring.c=720e3+-2%",
}
RARELY = (
    "docs/compare.md",
    "docs/crosscheck.md",
    "docs/hosts.md",
    "docs/identify.md",
    "docs/micron_steps.md",
    "docs/referee.md",
    "docs/scenarios.md",
    "docs/studies.md",
    "docs/sweeps.md",
    "docs/systems.md",
    "docs/test_your_master.md",
)
"""Pages whose commands do what other tests try, too."""
SILENT = {"math", "text", "xml", "csv"}
FENCED = r"^ *```.*?^ *```$"


class Block(NamedTuple):
    """A fenced block of a page: what follows its fence, where it is, and its text."""

    info: str
    label: str
    text: str


def text_of(page: str, without: str = "(?!)") -> str:
    """A page, without what a regular expression finds."""
    return re.sub(without, "", (ROOT / page).read_text(), flags=re.MULTILINE | re.DOTALL)


def blocks(page: str) -> Iterator[Block]:
    """The fenced blocks of a page in order."""
    text = text_of(page)
    for match in re.finditer(r"^( *)```([^\n`]*)\n(.*?)^ *```$", text, re.MULTILINE | re.DOTALL):
        line = text.count("\n", 0, match.start()) + 1
        body = re.sub(rf"^{match[1]}", "", match[3], flags=re.MULTILINE)
        yield Block(match[2], f"{page}:{line}", body)


def spans(page: str) -> Iterator[str]:
    """The code within the text of a page."""
    for match in re.finditer(r"(?<!\$)`([^`\n]+)`(?!\$)", text_of(page, FENCED)):
        yield match[1]


def commands(text: str) -> Iterator[str]:
    """The lines of a shell block without what is said about them."""
    for line in text.splitlines():
        yield re.split(r"\s+# ", line)[0].strip()


def ended(line: str, command: str) -> str:
    """A line of a shell block, which fails unless the command ends as the line says, "exit status 3"."""
    status = re.search(r"# .*exit status (\d+)", line)
    return f"if {command}; then false; else [ $? -eq {status[1]} ]; fi" if status else line


def not_run(command: str) -> bool:
    """Whether a command is left to people: all tests, the site, and what measures for long."""
    measures = command.startswith(BENCHMARK) and not command.endswith(" --help")
    return TEST_COMMAND in command or command == SITE_COMMAND or measures


def executable(block: Block, slow: bool) -> tuple[str, str, str] | None:
    """A block as tests/page.py takes it; None for what is not run."""
    language, _, target = block.info.partition(" ")
    if block.info in SILENT:
        return None
    if language == "sh":
        lines_to_run = [
            "" if not_run(command) or (command in SLOW and not slow) else ended(line, command)
            for line, command in zip(block.text.splitlines(), commands(block.text))
        ]
        return ("sh", block.label, "\n".join(lines_to_run) + "\n")
    return (target or language, block.label, block.text)


def work(page: str, slow: bool) -> list[tuple[str, str, str]]:
    """All of a page that is run."""
    scripts = [executable(block, slow) for block in blocks(page)]
    return [item for item in scripts if item and item[2].strip()]


def has_slow(page: str) -> bool:
    return work(page, True) != work(page, False)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A fresh copy of the project with its FMUs, in which .venv stands for this environment."""
    copy = tmp_path / "tree"
    copy.mkdir()
    for path in ROOT.iterdir():
        if path.name.startswith(".") or path.name == "results":
            continue
        if path.is_dir():
            # what another test builds at the moment is not of the project
            shutil.copytree(path, copy / path.name, ignore=shutil.ignore_patterns(".building-*"))
        elif path.suffix in (".py", ".md", ".toml") or path.name == "LICENSE":
            shutil.copy2(path, copy)
    programs = Path(sys.executable).parent
    scripts = {
        "python": f'exec {sys.executable} "$@"',
        "fmpy": f'exec {programs}/fmpy "$@"',
        "pip": '[ "$*" = "install -q uv" ]',
        "uv": 'case "$1" in sync | pip | cache) ;; *) exit 2 ;; esac',
        **{
            name: f'exec {sys.executable} -m {name} "$@"'
            for name in ("cosim", "fmukit", "scenarios")
        },
        "python3": f'[ "$*" = "-m venv .venv" ] || exec {sys.executable} "$@"',
    }
    for name, script in scripts.items():
        file = copy / ".venv" / ("path" if name == "python3" else "bin") / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"#!/bin/sh\n{script}\n")
        file.chmod(0o755)
    return copy


def perform(tree: Path, items: list[tuple[str, str, str]]) -> str:
    """Run blocks in a tree, as somebody would who follows the page; all that they print."""
    path = [tree / ".venv" / "path", ROOT / "tests" / "hosts" / "bin", os.environ["PATH"]]
    done = subprocess.run(
        [sys.executable, ROOT / "tests" / "page.py"],
        input=json.dumps(items),
        cwd=tree,
        env=os.environ | {"PATH": os.pathsep.join(map(str, path))},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] if page in RARELY else [])
        for page in PAGES
        if work(page, False)
    ],
)
def test_the_commands_of_a_page_work_in_order(page: str, tree: Path) -> None:
    output = perform(tree, work(page, slow=False))
    for stated in re.findall(r"^print\(.*  # (\S.* \+- \S+ [^\s,]+)", text_of(page), re.MULTILINE):
        assert stated in output


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if has_slow(page)])
def test_so_do_its_long_ones(page: str, tree: Path) -> None:
    perform(tree, work(page, slow=True))


INLINE = sorted({span for page in PAGES for span in spans(page) if span.startswith(".venv/bin/")})


@pytest.mark.parametrize("slow", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_commands_within_the_text_work(slow: bool, tree: Path) -> None:
    now = [command for command in INLINE if (command in SLOW) == slow and not not_run(command)]
    perform(tree, [("sh", command, f"{command}\n") for command in now])


@pytest.mark.parametrize("command", [x for x in INLINE if x.startswith(BENCHMARK)])
def test_a_benchmark_of_a_page_is_present(command: str) -> None:
    assert (ROOT / command.removeprefix(".venv/bin/python ").split()[0]).is_file()


def test_nothing_is_left_out() -> None:
    """Only known kinds of blocks; no list that outlives its page."""
    assert {"README.md", "CONTRIBUTING.md", "docs/component.md", "docs/coupling.md"} <= {*PAGES}
    covered = set(INLINE)
    for page in PAGES:
        for block in blocks(page):
            language, _, target = block.info.partition(" ")
            if block.info not in SILENT:
                written = target.endswith({"python": ".py", "toml": ".toml"}.get(language, "-"))
                assert language in ("sh", "python") or written, f"{block.label}: {block.info!r}"
                assert not target or written, block.label
            covered |= {*commands(block.text)} if language == "sh" else set()
    assert covered >= SLOW
    assert any(TEST_COMMAND in command for command in covered)
    assert SITE_COMMAND in covered


def test_the_line_that_starts_a_host_is_that_which_is_tested() -> None:
    (line,) = [span for span in spans("docs/hosts.md") if span.startswith("LD_PRELOAD=")]
    assert line in EXTERNAL_DEPENDENCIES


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere_and_tests_that_are_named_exist(page: str) -> None:
    text = text_of(page)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        assert "://" in target or ((ROOT / page).parent / target).exists(), target
    test_sources = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    for name in re.findall(r"`(test_\w+)`", text):
        assert f"def {name}(" in test_sources, name


def test_the_tutorial_prints_what_it_says(tree: Path) -> None:
    output = perform(tree, [("sh", "tutorial.py", ".venv/bin/python examples/tutorial.py")])
    promised = re.findall(
        r"^# prints: (.*)$", (ROOT / "examples" / "tutorial.py").read_text(), re.MULTILINE
    )
    assert output.splitlines()[1:] == promised
    assert (tree / "results" / "tutorial.png").stat().st_size > 20_000


def test_the_first_command_answers_as_the_readme_shows(tmp_path: Path) -> None:
    """Word by word; numbers within one unit of the last digit shown; and with its picture."""
    answer = ask("resonance")
    (block,) = (block for block in blocks("README.md") if block.info == "text")
    text_of_page, verdict = (" ".join(text.split()) for text in (block.text, answer.verdict))
    number = r"\d+(?:\.\d+)?"
    assert re.sub(number, "#", verdict) == re.sub(number, "#", text_of_page)
    pairs = list(zip(re.findall(number, text_of_page), re.findall(number, verdict), strict=True))
    assert len(pairs) > 7
    for old, new in pairs:
        assert abs(float(new) - float(old)) <= 1.01 * 10.0 ** -len(old.partition(".")[2])
    draw_answer(answer, tmp_path / "resonance.png")
    assert not differ(ROOT / "docs" / "resonance.png", tmp_path / "resonance.png")
