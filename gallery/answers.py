"""The answers that the site shows: each question with its default options, answered once."""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
from functools import cache
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple

from cosim import SetupError, versions
from scenarios.fmu_files import CLONE as ROOT
from scenarios.project import PROJECT
from workbench.question import Question

from .child import run_in_project

KEY = "made_of.txt"


class Answered(NamedTuple):
    """A question, its name, the command that answers it, and the folder of its files."""

    name: str
    question: type[Question]
    command: str
    folder: Path

    @property
    def content(self) -> dict[str, Any]:
        """The content of its JSON."""
        text = (self.folder / f"{self.name}.json").read_text(encoding="utf-8")
        return dict(json.loads(text))

    @property
    def picture(self) -> Path:
        """Its picture."""
        return self.folder / f"{self.name}.png"

    @property
    def has_live_page(self) -> bool:
        """Whether its page has a live part."""
        return self.question.has_live_page()


def answered(name: str, folder: Path) -> Answered:
    """The answer in that folder, made again unless it is that of this code and these FMUs.

    Raises SetupError where the question has no answer.
    """
    question = PROJECT.load(name)
    arguments = ["run", name, *data_options(name)]
    answer = Answered(name, question, f"scenarios {' '.join(arguments)}", folder)
    fmus = PROJECT.fmus(question, "native")
    key = hashlib.sha256(repr((arguments, code_hash(), versions())).encode())
    for part in question.parts:
        key.update(fmus[part].read_bytes())
    key_file = folder / KEY
    if not key_file.is_file() or key_file.read_text() != key.hexdigest():
        print(f"{name} ...", flush=True)
        if key_file.is_file():  # else the answer of a killed run, which goes on
            rmtree(folder)
        jobs = [] if question.is_sequential else ["--jobs", str(os.cpu_count())]
        command = [sys.executable, "-m", "scenarios", *arguments, *jobs, "--out", str(folder)]
        process = run_in_project(command, check=False, capture_output=True, text=True)
        if process.returncode:
            raise SetupError(f"{answer.command}: {process.stderr.strip()}")
        key_file.write_text(key.hexdigest())
    return answer


def data_options(name: str) -> list[str]:
    """The record that a question needs, and the other options that its guide gives with it."""
    for guide in sorted((ROOT / "docs").glob("*.md")):
        text = guide.read_text(encoding="utf-8")
        if match := re.search(rf"scenarios run {name} (.*--data .*)", text):
            return match[1].replace("--flavour native", "").split()
    return []


@cache
def code_hash() -> str:
    """A hash of everything that turns a question and its FMUs into an answer."""
    digest = hashlib.sha256()
    for package in ("cosim", "workbench", "scenarios", "examples"):
        for path in sorted((ROOT / package).rglob("*.*")):
            if path.suffix in (".py", ".c", ".js", ".html", ".csv"):
                digest.update(path.read_bytes())
    return digest.hexdigest()
