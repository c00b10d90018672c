"""list | run NAME or FILE.py [options] | study FILE.toml [options]."""

from __future__ import annotations

import importlib
import logging
import sys
from argparse import RawDescriptionHelpFormatter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from cosim.commandline import Parser, exit_code

from . import ask, question
from .answer import finish
from .options import Options, add, at_least, declared, made, unknown
from .question import Project, QuestionError
from .runs import local

USAGE = "list | run NAME or FILE.py [options] | study FILE.toml [options]"


def main(words: Sequence[str], project: Project, program: str) -> int:
    """Do what the words of a command line say; its exit code."""

    def act() -> int:
        top = Parser(prog=program, usage=f"{program} {USAGE}", allow_abbrev=False)
        top.add_argument("command", choices=("list", "run", "study"))
        told, rest = top.parse_args(words[:1]), list(words[1:])
        if told.command == "list":
            return listed(project)
        if told.command == "study":
            return int(
                importlib.import_module("workbench.study.command").main(rest, project, program)
            )
        return run(rest, project, program)

    logging.getLogger("cosim").addHandler(logging.NullHandler())
    try:
        return exit_code(act)
    except QuestionError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def listed(project: Project) -> int:
    """Print the questions of the project; none is imported."""
    for name, module in question.names(project.home).items():
        assert project.home is not None
        path = project.home.parent / Path(*module.split(".")).with_suffix(".py")
        print(f"{name:<17} {question.summary(path)}")
    return 0


def run(words: Sequence[str], project: Project, program: str) -> int:
    """Answer one question, write its files and print the verdict."""
    known = ", ".join(question.names(project.home))
    top = Parser(
        prog=f"{program} run",
        usage=f"{program} run NAME|FILE.py [options]",
        description=f"Answer a question: one of {known}, or a file of your own.",
        epilog=f"{program} run NAME --help tells the options of a question.",
    )
    top.add_argument("question", metavar="NAME|FILE.py")
    page = question.load(question.find(project.home, top.parse_args(words[:1]).question))
    settings, given = read(words[1:], page, f"{program} run {words[0]}")
    o = made(page.Options, given, question.name(page))
    flavour = settings["flavour"]
    if settings["jobs"] is not None:
        at_least("jobs", settings["jobs"], 1)
    fmus = project.fmus.paths(parts(page), flavour, Path(str(page.__file__)).parent)
    out = settings["out"] or default_folder(page, o)
    jobs = settings["jobs"] or (local.available_cores() if flavour == own_flavour(page) else 1)
    found = ask.answer(page, o, fmus, flavour=flavour, jobs=jobs, out=out)
    finish(found, out, settings["animate"])
    return 0


def read(
    words: Sequence[str], page: ModuleType, program: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a command line says of the run, and of the question's options, as texts.

    Raises SetupError for an option that there is not, with the closest one.
    """
    parser = Parser(
        prog=program,
        description=page.__doc__,
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add(parser, page.Options)
    own = own_flavour(page)
    parser.add_argument(
        "--flavour", choices=("python", "native"), default=own, help=f"of the FMUs (default: {own})"
    )
    parser.add_argument("--jobs", type=int, help="parallel processes (default: all cores)")
    parser.add_argument("--out", type=Path, help="folder (default: results/NAME, or NAME/SET)")
    parser.add_argument("--animate", action="store_true", help="also write the motions as GIF")
    found, rest = parser.parse_known_args(words)
    if rest:
        flags = [
            flag.removeprefix("--") for action in parser._actions for flag in action.option_strings
        ]
        raise unknown(rest[0].lstrip("-").partition("=")[0], flags, question.name(page))
    told = vars(found)
    names = [*declared(page.Options), "start"]
    given = {name: told.pop(name) for name in names}
    return told, {name: value for name, value in given.items() if value is not None}


def parts(page: ModuleType) -> Mapping[str, str]:
    """The FMUs of a page by part."""
    found: Mapping[str, str] = getattr(page, "PARTS", {})
    return found


def own_flavour(page: ModuleType) -> str:
    """The flavour of FMUs that a question takes by default: that which is there in a second."""
    return str(getattr(page, "FLAVOUR", "python"))


def default_folder(page: ModuleType, o: Options) -> Path:
    """results/NAME, with the parameter set of a question that has some."""
    folder = Path("results") / question.name(page)
    return folder / o.set if hasattr(o, "set") else folder
