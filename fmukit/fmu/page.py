"""The page of a component, for the documentation and for the FMU.

Its text is written only once. The model's docstring says what the machine is, and the declarations
describe the variables. The rest, such as equations longer than a screen, is in `page.md` next to the
model, with `drawing.svg`.
"""

import os
import re
from collections.abc import Iterator
from pathlib import Path

import markdown
from latex2mathml.converter import convert

from ..declare.interface import Interface, Variable, class_name, title
from .description.fmi2 import start_text
from .load import neighbour_file

EXTERNAL_DEPENDENCIES = """\
linux64 or win64, and CPython 3.10 or newer with its standard library; nothing else.

A host that runs in Python (fmpy, PyFMI, libcosimpy, ecospy) needs nothing more.

Any other host must find libpython and the standard library. On Linux, start it like this:
    LD_PRELOAD=$(python3 -c "import sysconfig as s, os; \
print(os.path.join(s.get_config_var('LIBDIR'), s.get_config_var('INSTSONAME')))") HOST
The host must find the same python3 on PATH as this line (PYTHONHOME selects another one).
On Windows, the folder of python3.dll must be on PATH.

The path to which the FMU is unpacked must not contain + # % or non-ASCII letters, because pythonfmu's
wrapper does not decode them. Nor does it check the GUID passed to fmi2Instantiate.
"""

STYLE = """\
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}
table{border-collapse:collapse;font-size:.85rem;display:block;overflow-x:auto}
td:last-child{min-width:14rem}
td,th{border-bottom:1px solid #ccc;padding:.2rem .6rem;text-align:left;vertical-align:top}
.formula{overflow-x:auto;margin:1rem 0}
svg{max-width:100%;height:auto}
code{font-size:.9em;overflow-wrap:anywhere}
"""

HEADER = ("name", "type", "unit", "causality", "variability", "initial", "start", "meaning")

HOLD = """\
`input_hold` selects how the inputs behave between two communication points, for hosts that can only
set inputs. `zero` (0) holds the value that was set; this is right for Gauss-Seidel and Strang
masters. `extrapolate` (1) follows the line through the last two values. It gives second order in a
Jacobi master, where every unit receives the values from the start of the step, and it is also the
setting for the unit that a Gauss-Seidel master steps first. `interpolate` (2) runs from the previous
value to the one just set. It is right for the unit that a Gauss-Seidel master steps last, which
receives the values from the end of the step. Interpolating one of two coupled inputs while the other
is held is worse than holding both.
"""

FORMULA = re.compile(r"\$\$(.+?)\$\$|\$(.+?)\$", re.DOTALL)


def rows(interface: Interface) -> Iterator[tuple[str, ...]]:
    """The variable table: one row per variable, with the columns of HEADER."""
    for v in interface.variables:
        yield (
            v.name,
            v.declaration.fmi_type,
            v.unit,
            v.causality,
            v.variability,
            v.initial,
            start_text(v.declaration) if v.settable_before_start else "",
            meaning_with_bounds(v),
        )


def meaning_with_bounds(variable: Variable) -> str:
    """The description with the bounds, or with the values of an enumeration."""
    d = variable.declaration
    if d.items:
        values = ", ".join(f"{item.value} = {item.name}" for item in d.items)
        return f"{d.meaning} [{values}]"
    limits = ["> 0"] if d.positive else [f"min {d.min!r}"] if d.min is not None else []
    limits += [f"max {d.max!r}"] if d.max is not None else []
    return f"{d.meaning} [{', '.join(limits)}]" if limits else d.meaning


def markdown_table(interface: Interface) -> str:
    """The variable table in Markdown."""
    lines = [" | ".join(HEADER), " | ".join("---" for _ in HEADER)]
    lines += [" | ".join(row) for row in rows(interface)]
    return "\n".join(f"| {line} |" for line in lines)


def markdown_page(interface: Interface, drawing: str, plot: str) -> str:
    """The page in Markdown with $ formulas and these pictures."""
    model, notes = interface.model, neighbour_file(interface.model, "page.md")
    stop, step = model.EXPERIMENT
    sections = [
        f"# {class_name(model)}",
        f"**{title(model)}.**",
        drawing,
        (model.__doc__ or "").strip().partition("\n")[2].strip(),
        notes.read_text(encoding="utf-8").strip() if notes else "",
        f"## Inputs between communication points\n\n{HOLD.strip()}",
        f"## Default experiment\n\nInputs and parameters keep their start values for {stop:g} s, in steps "
        f"of {step:g} s. The FMU contains these results as CSV.",
        plot,
        f"## Variables\n\n{markdown_table(interface)}",
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def github_markdown(interface: Interface, plot: str, seen_from: Path) -> str:
    """The page as GitHub shows it from this folder."""
    picture = neighbour_file(interface.model, "drawing.svg")
    path = os.path.relpath(picture, seen_from) if picture else ""
    drawing = f"![Drawing: {title(interface.model)}]({Path(path).as_posix()})" if picture else ""
    return with_github_formulas(
        markdown_page(interface, drawing, f"![Outputs over time in the default experiment]({plot})")
    )


def with_github_formulas(page: str) -> str:
    """The page for the documentation, with its formulas protected from Markdown."""

    def protect(match: re.Match[str]) -> str:
        return f"```math\n{match[1].strip()}\n```" if match[1] else f"$`{match[2]}`$"

    return f"<!-- Written by build_fmus.py --docs -->\n\n{FORMULA.sub(protect, page)}"


def html(interface: Interface, plot: str = "") -> str:
    """The page as one file that needs no network, with formulas as MathML and pictures as SVG."""
    picture = neighbour_file(interface.model, "drawing.svg")
    drawing = picture.read_text(encoding="utf-8") if picture else ""
    body = html_of_markdown(markdown_page(interface, "DRAWING", "PLOT"))
    for marker, svg in (("DRAWING", drawing), ("PLOT", plot)):
        body = body.replace(f"<p>{marker}</p>", svg)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{class_name(interface.model)}</title><style>{STYLE}</style></head><body>\n"
        f"{body}\n</body></html>\n"
    )


def html_of_markdown(text: str) -> str:
    """Convert Markdown with $$ equations $$ and $ symbols $ to HTML with MathML."""
    formulas: list[str] = []

    def protect(match: re.Match[str]) -> str:
        block = match[1] is not None
        formula = convert(match[1] or match[2], display="block" if block else "inline")
        formulas.append(f'<div class="formula">{formula}</div>' if block else formula)
        return f"FORMULA{len(formulas) - 1}END"

    page = markdown.markdown(FORMULA.sub(protect, text), extensions=["tables"])
    return re.sub(
        r"<p>FORMULA(\d+)END</p>|FORMULA(\d+)END",
        lambda match: formulas[int(match[1] or match[2])],
        page,
    )
