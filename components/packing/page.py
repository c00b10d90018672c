"""What people read of a component: its equations as a web page, its variables as a table."""

import html as escape
import re
from collections.abc import Iterator

import markdown
from latex2mathml.converter import convert

from ..kit.description import start_text
from ..kit.interface import Interface, Variable, class_name, title

EXTERNAL_DEPENDENCIES = """\
linux64 or win64, and CPython 3.10 or newer with its standard library; nothing else.

A host that is itself Python (fmpy, PyFMI, libcosimpy, ecospy) needs no more.

Any other host must find libpython and the standard library. Linux: start it as
    LD_PRELOAD=$(python3 -c "import sysconfig as s, os; \
print(os.path.join(s.get_config_var('LIBDIR'), s.get_config_var('INSTSONAME')))") HOST
with the python3 on PATH that the line asks (PYTHONHOME names another one).
Windows: the folder of python3.dll must be on PATH.

The path that the FMU is unpacked to must not contain + # % or letters beyond ASCII: pythonfmu's
wrapper does not decode them. It does not compare the GUID handed to fmi2Instantiate either.
"""

STYLE = """\
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}
table{border-collapse:collapse;font-size:.85rem}
td,th{border-bottom:1px solid #ccc;padding:.2rem .6rem;text-align:left}
math[display=block]{margin:1rem 0}
"""

HEADER = ("name", "type", "unit", "causality", "variability", "initial", "start", "meaning")

HOLD = """\
`input_hold` says what an input does between two communication points, for hosts that can only
set inputs. `zero` (0) holds the value that was set: right for Gauss-Seidel and Strang masters.
`extrapolate` (1) follows the line through the last two values: second order in a Jacobi master,
where every unit is given the values of the step's beginning; this is also the setting of the unit
that a Gauss-Seidel master steps first. `interpolate` (2) runs from the value before to the one
just set: right for the unit that a Gauss-Seidel master steps last, which is given the values of
the step's end. Interpolating only one of two coupled inputs, the other one held, is worse than
holding both.
"""


def rows(interface: Interface) -> Iterator[tuple[str, ...]]:
    """The variable table, one row of HEADER's columns per variable."""
    for v in interface.variables:
        yield (
            v.name,
            v.declaration.kind,
            v.unit,
            v.causality,
            v.variability,
            v.initial,
            start_text(v.declaration) if v.settable_before_start else "",
            meaning(v),
        )


def meaning(variable: Variable) -> str:
    """The description with bounds, or with the values of an enumeration."""
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


def html(interface: Interface) -> str:
    """A page that needs no network: equations as MathML, then the variables."""
    model = interface.model
    cells = "".join(
        "<tr>" + "".join(f"<td>{escape.escape(cell)}</td>" for cell in row) + "</tr>\n"
        for row in rows(interface)
    )
    head = "".join(f"<th>{name}</th>" for name in HEADER)
    text = (model.__doc__ or "").strip().partition("\n")[2]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{class_name(model)}</title><style>{STYLE}</style></head><body>\n"
        f"<h1>{class_name(model)}</h1>\n<p><strong>{escape.escape(title(model))}</strong></p>\n"
        f"{prose(text)}\n<h2>Inputs between communication points</h2>\n{prose(HOLD)}\n"
        f"<h2>Variables</h2>\n<table><tr>{head}</tr>\n{cells}</table>\n</body></html>\n"
    )


def prose(text: str) -> str:
    """Markdown with $$ equations $$ and $ symbols $ to HTML with MathML."""
    formulas: list[str] = []

    def keep(match: re.Match[str]) -> str:
        block = match[1] is not None
        formulas.append(convert(match[1] or match[2], display="block" if block else "inline"))
        return f"FORMULA{len(formulas) - 1}END"

    kept = re.sub(r"\$\$(.+?)\$\$|\$(.+?)\$", keep, text, flags=re.DOTALL)
    page = markdown.markdown(kept)
    return re.sub(r"FORMULA(\d+)END", lambda match: formulas[int(match[1])], page)
