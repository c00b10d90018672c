"""list | run NAME or FILE.py [options] | find NAME or FILE.py [options] | study FILE.toml [options]."""

from __future__ import annotations

import logging
import math
import sys
from argparse import ArgumentTypeError, BooleanOptionalAction, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim import SetupError
from cosim.cli.options import Parser, exit_code
from cosim.units import read_quantity

from . import catalog
from .catalog import QuestionError, as_question_errors
from .project import FLAVOURS, Project

if TYPE_CHECKING:
    from .question import Question

#: Exit status of `run` for an answer that is refused; 1 and 2 are failed runs and bad input. A convention
#: of this project.
REFUSED = 3
#: Communication steps that a search for remedies may take where nobody asks for it: chosen, about 10 s; a number of steps, so
#: that a command has the same answer on any machine.
SEARCH_STEPS = 500_000
USAGE = "list | run NAME or FILE.py [options] | find NAME or FILE.py [options] | study FILE.toml [options]"

SUMMARY = """\
Ask questions about machines made of FMUs; answers are figures with errors, tables, pictures and pages.

  {0} list             prints the questions, a line each
  {0} run NAME         answers one of them, or the question in a file of yours, NAME.py
  {0} find NAME        finds where a figure of a question reaches a level
  {0} study FILE.toml  asks a question many times, with varied inputs (docs/studies.md)
"""


def main(argv: Sequence[str], project: Project, program: str) -> int:
    """Run a command line, the arguments after the name of the program; returns its exit code."""

    def act() -> int:
        top = Parser(
            prog=program,
            usage=f"{program} {USAGE}",
            description=SUMMARY.format(program),
            epilog=f"{program} run NAME --help lists the options of a question.",
            formatter_class=RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        top.add_argument("command", choices=COMMANDS, help="what to do")
        return COMMANDS[top.parse_args(argv[:1]).command](argv[1:], project, program)

    logging.getLogger("cosim").addHandler(logging.NullHandler())
    try:
        return exit_code(act)
    except (QuestionError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def show_list(argv: Sequence[str], project: Project, program: str) -> int:
    """Print the questions of the project; none is imported."""
    Parser(prog=f"{program} list", description="Print the questions, a line each.").parse_args(argv)
    home, questions = Path(str(project.home)), catalog.names(project.home)
    width = max(map(len, questions), default=0)
    for name, module in questions.items():
        plan = " (a plan)" if catalog.is_plan(home, module) else ""
        print(f"{name:<{width}} {catalog.summary(home, module)}{plan}")
    return 0


def run(argv: Sequence[str], project: Project, program: str) -> int:
    """Answer one question, print the answer and write its files; REFUSED if it is not determined."""
    question = _question(argv, project, f"{program} run", "Answer a question")
    from .export import print_and_write  # with NumPy and FMPy, which a list does not need
    from .options import declared
    from .run import ask
    from .runs.folder import reservation
    from .study.tolerance import STUDY, study_file, with_tolerances

    parser = _parser_of(question, f"{program} run {argv[0]}")
    _add_common(parser, "results/NAME, or NAME/SET")
    parser.add_argument(
        "--animate", action="store_true", help="also write the motions as GIF files"
    )
    parser.add_argument(
        "--remedies",
        action=BooleanOptionalAction,
        help=f"say what would make an answer good that is not (default: if that takes at most {SEARCH_STEPS} communication steps)",
    )
    if "tolerance" not in declared(question):
        _add_tolerance(parser)
    parsed, rest = parser.parse_known_args(argv[1:])
    if rest:
        flags = [x[2:] for x in parser._option_string_actions if x[:2] == "--" and x != "--help"]
        raise misplaced(rest[0], argv[1:], flags, question.name)
    args = {name: value for name, value in vars(parsed).items() if value is not None}
    options = {name: args.pop(name) for name in (*declared(question), "start") if name in args}
    o = question.parse(options)
    folder = Path("results") / question.name
    args["out"] = args.get("out", folder / vars(o).get("set", ""))
    animate = args.pop("animate")
    steps = {None: SEARCH_STEPS, True: math.inf, False: 0.0}[args.pop("remedies", None)]
    texts, machines = args.pop("tolerance", []), args.pop("machines", 0)
    settings = {x: args.get(x) for x in ("jobs", "scheduler")}
    if texts and question.is_sequential:  # the machines are in parallel then
        args = {name: x for name, x in args.items() if name not in settings}
    with reservation(args["out"]):
        answer = ask(project, argv[0], options, **args, program=program)
        if texts:
            scenario = str(question.path.resolve()) if question.own_files else argv[0]
            content = study_file(scenario, options, answer, texts, machines)
            answer = with_tolerances(answer, content, args["out"], project, **settings)
        with as_question_errors(question.module):
            more = [f"{STUDY}/"] if texts else []
            print_and_write(answer, args["out"], animate=animate, most_steps=steps, more=more)
    return REFUSED if answer.refused else 0


def find_values(argv: Sequence[str], project: Project, program: str) -> int:
    """Print for which values of inputs a figure of a question reaches a level."""
    what = "Find where a figure reaches a level, over one input after the other, of a question"
    question = _question(argv, project, f"{program} find", what)
    from cosim.cli.options import assignment

    from .context import Context
    from .find import Find
    from .options import declared
    from .plan import Plan
    from .remedies import values_until
    from .study.file import read_find

    parser = _parser_of(question, f"{program} find {argv[0]}")
    parser.add_argument(
        "--vary", action="append", required=True, metavar="NAME=LOW:HIGH",
        help="an option or a start value, and its range (repeatable: one after the other)",
    )  # fmt: skip
    parser.add_argument(
        "--until", required=True, metavar="TEXT", help='what is wanted, "lag = 90 deg" or "tau2 <= 50 N.m"'
    )  # fmt: skip
    parser.add_argument("--flavour", choices=FLAVOURS, help="flavour of the FMUs")
    args = vars(parser.parse_args(argv[1:]))
    fmus = project.fmus(question, args["flavour"] or project.flavour(question))
    varied: list[Find] = []
    for name, ends in map(assignment, args["vary"]):
        low, _, high = ends.partition(":")
        spec = {"over": name, "from": low, "to": high, "figure": "figure", "level": 0.0}
        plan = Plan(question=question, find={"vary": read_find(question, "vary", spec)})
        varied += plan.finds(fmus).values()
    options = {x: args[x] for x in (*declared(question), "start") if args[x] is not None}
    with as_question_errors(question.module):
        for line in values_until(question.parse(options), Context(fmus), args["until"], varied):
            print(line)
    return 0


def _question(
    argv: Sequence[str], project: Project, program: str, description: str
) -> type[Question]:
    """The question that a command line begins with."""
    top = Parser(
        prog=program,
        usage=f"{program} NAME|FILE.py [options]",
        description=f"{description}: one of {', '.join(catalog.names(project.home))}, or a file of your own.",
        epilog=f"{program} NAME --help lists the options of a question.",
    )
    top.add_argument("question", metavar="NAME|FILE.py")
    return project.load(top.parse_args(argv[:1]).question)


def _parser_of(question: type[Question], program: str) -> Parser:
    """What reads the options of a question."""
    from .options import add_arguments

    parser = Parser(
        prog=program,
        description=question.module.__doc__,
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add_arguments(parser, question)
    return parser


def misplaced(word: str, words: Sequence[str], flags: Sequence[str], who: str) -> SetupError:
    """The error for a word of a command line that belongs to no option: one that does not exist, or a lone unit."""
    from .options import unknown_option

    if word.startswith("-"):
        return unknown_option(word.lstrip("-").partition("=")[0], flags, who)
    before = words[: words.index(word)]
    if before and (quantity := read_quantity(before[-1])) and not quantity.unit:
        return SetupError(
            f"{word!r} after {before[-1]} belongs to no option: write {before[-1]}{word}"
        )
    return SetupError(f"{word!r} belongs to no option; options of {who} begin with --")


def study(argv: Sequence[str], project: Project, program: str) -> int:
    """Run the study of a file and print its answer; 1 if no run succeeded."""
    from cosim.calls import OK

    from . import study as studies  # with NumPy, SciPy and pandas
    from .export import print_and_write

    parser = Parser(
        prog=f"{program} study",
        description="Run a question many times with the varied inputs of a study file.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "file", type=Path, metavar="FILE.toml", help="study file, see docs/studies.md"
    )
    _add_common(parser, "results/studies/NAME")
    args = {name: x for name, x in vars(parser.parse_args(argv)).items() if x is not None}
    answer = studies.run(studies.load(args.pop("file"), project), **args, end=print_and_write)
    return 0 if (answer.first_table["status"] == OK).any() else 1


def _add_common(parser: Parser, out: str) -> None:
    """The options of any runs."""
    parser.add_argument(
        "--flavour",
        choices=FLAVOURS,
        help="flavour of the FMUs (default: native if they are built, else python)",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="parallel processes (default: all cores, or 1 where native FMUs are faster in one)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="scheduler of a Dask cluster that does the runs: tcp://HOST:8786",
    )
    parser.add_argument(
        "--out", type=_folder, metavar="FOLDER", help=f"output folder (default: {out})"
    )


def _add_tolerance(parser: Parser) -> None:
    """The options of machines that scatter."""
    parser.add_argument(
        "--tolerance",
        action="append",
        metavar="NAME=PERCENT",
        help="say for how many machines each judgement is yes that scatter by so much around their values; also "
        "NAME=+-VALUE, or normal:PERCENT and normal:+-VALUE of a standard deviation (repeatable)",
    )
    parser.add_argument(
        "--machines", type=int, default=64, metavar="N", help="how many (default: 64)"
    )


def _folder(text: str) -> Path:
    """A path that may be a folder."""
    if Path(text).exists() and not Path(text).is_dir():
        raise ArgumentTypeError(f"{text!r} is not a folder")
    return Path(text)


COMMANDS = {"list": show_list, "run": run, "find": find_values, "study": study}
