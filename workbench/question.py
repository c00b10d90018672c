"""What a question is: one object with defaults, made from the simple module that its author writes.

The module is the form for authors: a docstring, a class `Options`, and functions. `read` is the only prefix that
looks into it. Everything else works with a `Question`, all of whose attributes exist.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from cosim import SetupError

from . import catalog
from .answer import Findings, Show
from .figure import ERROR_SCOPE, Figure
from .judgement import Judgement
from .options import Options, Run, declared, parse_options
from .simple import SimpleForm

if TYPE_CHECKING:
    from .context import Context

#: Names that the command line takes for every question.
RESERVED_OPTIONS = ("help", "start", "flavour", "jobs", "scheduler", "out", "animate")


def _no_judgements(o: Any, figures: Mapping[str, Figure], data: Any) -> Sequence[Judgement]:
    """Claim nothing, where a question judges nothing."""
    return ()


def _nothing_to_show(o: Any, figures: Mapping[str, Figure], data: Any) -> Show:
    """Show nothing, where a question has no charts."""
    return Show()


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question that can be answered.

    Attributes
    ----------
    module : module
        Where it is written.
    title : str
        The question in words, the first line of its text.
    options : type of Options
        What can be chosen.
    solve : function of options and context
        Does the runs and returns `Findings`.
    judgements : function of options, figures and data
        What the answer claims, first what decides it.
    show : function of options, figures and data
        Charts and motions.
    live : Live, function of options, figures and data that returns one, or None
        The live part of its page.
    parts : mapping
        FMUs by part: names of built ones, or paths that end in .fmu.
    fixed_starts : tuple of str
        Start values that it sets itself, and nobody else may.
    decisive : tuple of str
        Figures without which the answer is refused.
    sources : tuple of pairs of str
        The papers whose formulas it names, and where they are described.
    error_scope : str
        What the errors of its figures cover, in sentences.
    is_parallel : bool
        Whether its runs are spread over all cores by default with native FMUs, too.
    preset : mapping
        Options that are set unless the user gives them, in a question that is asked by an old name.
    old_name : str
        That name.
    """

    module: ModuleType
    title: str
    options: type[Options]
    solve: Callable[[Any, Context], Findings]
    judgements: Callable[[Any, Mapping[str, Figure], Any], Sequence[Judgement]] = _no_judgements
    show: Callable[[Any, Mapping[str, Figure], Any], Show] = _nothing_to_show
    live: Any = None
    parts: Mapping[str, str] = field(default_factory=dict)
    fixed_starts: tuple[str, ...] = ()
    decisive: tuple[str, ...] = ()
    sources: tuple[tuple[str, str], ...] = ()
    error_scope: str = ERROR_SCOPE
    is_parallel: bool = False
    preset: Mapping[str, Any] = field(default_factory=dict)
    old_name: str = ""

    @property
    def name(self) -> str:
        """The name by which it is asked: that of its file, or an old one."""
        return self.old_name or self.module.__name__.rpartition(".")[2]

    def parse(self, options: Mapping[str, Any]) -> Options:
        """Return its options with these values; raises SetupError for what they cannot be."""
        return parse_options(self.options, {**self.preset, **options}, self.name)

    @property
    def path(self) -> Path:
        """Its file."""
        return Path(str(self.module.__file__))

    @property
    def locator(self) -> str:
        """What `load` takes to load it again, or in another process."""
        return catalog.locator(self.module)

    @property
    def files(self) -> list[Path]:
        """Its file where it belongs to no package."""
        return catalog.files(self.module)


def load(locator: str) -> Question:
    """Return the question of a module, "scenarios.conveyor.run_up", or of a file, "mine.py".

    Raises
    ------
    SetupError
        For a file that does not exist, and for what is no question.
    QuestionError
        If the question's own code raises.
    """
    module = catalog.load_module(locator)
    try:
        return read(module, locator)
    except SetupError:
        catalog.unload(module)
        raise


def read(module: ModuleType, locator: str = "") -> Question:
    """Return the question that a module contains; `locator` is its name in messages.

    Raises
    ------
    SetupError
        If it lacks what a question must have.
    """
    prefix, content = locator or str(module.__file__), vars(module)
    options = _read_options(content.get("Options"), prefix)
    parts = content.get("PARTS", {})
    if not isinstance(parts, Mapping):
        raise SetupError(f"{prefix}: PARTS must be a dict of FMUs by part")
    solve = content.get("solve") or _read_simple_form(module, options, prefix).solve
    title = (module.__doc__ or "").strip().partition("\n")[0]
    if not title:
        raise SetupError(f"{prefix} must begin with its question as a docstring")
    return Question(
        module=module,
        title=title,
        options=options,
        solve=solve,
        judgements=content.get("judgements", _no_judgements),
        show=content.get("show", _nothing_to_show),
        live=content.get("LIVE"),
        parts=parts,
        fixed_starts=tuple(content.get("FIXED_STARTS", ())),
        decisive=tuple(content.get("DECISIVE", ())),
        sources=tuple(content.get("SOURCES", ())),
        error_scope=content.get("ERROR_SCOPE", ERROR_SCOPE),
        is_parallel=bool(content.get("PARALLEL", False)),
    )


def _read_options(options: Any, prefix: str) -> type[Options]:
    """Return the class of options of a question, if it is one."""
    if not (isinstance(options, type) and issubclass(options, Options)):
        raise SetupError(f"{prefix} must define a class Options(workbench.Options)")
    if any(isinstance(value, Field) for value in vars(options).values()):
        raise SetupError(
            f"{prefix}: class Options must be decorated with @dataclass(frozen=True, kw_only=True)"
        )
    for name in declared(options):
        if name in RESERVED_OPTIONS:
            raise SetupError(
                f"{prefix}: no option can be called {name!r}, since every question has one of that name"
            )
    return options


def _read_simple_form(module: ModuleType, options: type[Options], prefix: str) -> SimpleForm:
    """Return the simple form of a question without `solve`."""
    content = vars(module)
    for name, arguments in (("system", "(o, fmus)"), ("figures", "(o, r)")):
        if name not in content:
            raise SetupError(f"{prefix} must define {name}{arguments}, or solve(o, context)")
    if not issubclass(options, Run) and "run" not in content and "step" not in declared(options):
        raise SetupError(
            f"{prefix}: with system and figures, Options must derive from workbench.Run, or run(o) return "
            "one"
        )
    functions = {
        name: content[name]
        for name in ("run", "process", "more_runs", "more_figures", "tables", "files")
        if name in content
    }
    return SimpleForm(
        path=Path(str(module.__file__)),
        system=content["system"],
        figures=content["figures"],
        record=content.get("RECORD"),
        labels=content.get("LABELS", {}),
        **functions,
    )
