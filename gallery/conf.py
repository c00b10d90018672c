"""Sphinx makes the site: Markdown by MyST, docstrings by autodoc, formulas as MathML, no network."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

project, author = "Drive FMUs", "The drive FMU authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
default_role = "code"
napoleon_google_docstring = False
myst_enable_extensions = ["attrs_block", "colon_fence", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints_format = "short"
# Packages offer an object under several names, such as workbench.Table and workbench.answer.Table.
suppress_warnings = ["ref.python"]
html_math_renderer = "mathml"
html_theme = "furo"
html_title = project
html_static_path = [str(Path(__file__).with_name("static"))]
html_css_files, html_js_files = ["gallery.css"], [("gallery.js", {"defer": "defer"})]
html_copy_source = html_use_index = html_domain_indices = False
html_show_sphinx = html_show_copyright = False
html_show_search_summary = False  # it fetches pages, which a browser refuses for a local file
html_theme_options = {"navigation_with_keys": False}
include_patterns = [
    "*.md",
    "docs/**",
    "questions/**",
    "reference/**",
    "reference_systems/README.md",
]


def write_formula(writer: Any, node: nodes.math | nodes.math_block) -> None:
    """Write a formula as MathML, which browsers draw and readers read aloud."""
    block = isinstance(node, nodes.math_block)
    markup = convert(node.astext(), display="block" if block else "inline")
    writer.body.append(f'<div class="formula" tabindex="0">{markup}</div>' if block else markup)
    raise nodes.SkipNode


def formulas_for_myst(_app: Sphinx, _name: str, text: list[str]) -> None:
    """Turn the formulas that GitHub protects, $`x`$, into those of MyST, $x$."""
    text[0] = re.sub(r"\$`(.+?)`\$", r"$\1$", text[0], flags=re.DOTALL)


def skip_field_aliases(
    _app: Sphinx, _what: str, _name: str, member: object, skip: bool, _: object
) -> Any:
    """Leave out Python's own text on the fields of a named tuple; its docstring describes them."""
    return skip or (getattr(member, "__doc__", None) or "").startswith("Alias for field") or None


def setup(app: Sphinx) -> None:
    """Register what Sphinx leaves to this site: formulas as MathML, members without aliases."""
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
    app.connect("source-read", formulas_for_myst)
    app.connect("autodoc-skip-member", skip_field_aliases)
