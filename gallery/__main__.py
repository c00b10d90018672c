"""python -m gallery [--questions NAME,NAME] [--out DIR]: make the site of the project.

DIR/site is the site: guides, machines with their live models, the answers of the questions, reference,
search. It needs no server and no network: open index.html, or publish the folder as it is. Answers are
kept in DIR/answers and asked for again when code or FMUs have changed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from shutil import rmtree

from scenarios.__main__ import HOME, ROOT
from workbench.question import names

from . import pages
from .answers import answered


def main() -> int:
    """Make the site as the command line says; its exit code."""
    known = [*names(HOME)]
    parser = argparse.ArgumentParser(prog="python -m gallery", description="Make the site.")
    parser.add_argument(
        "--questions", type=lambda text: text.split(","), default=known, metavar="NAME,NAME",
        help="answer these alone (default: all)",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "gallery", help="folder")
    options = parser.parse_args()
    for name in options.questions:
        if name not in known:
            parser.error(f"unknown question {name!r}; there are {', '.join(known)}")
    return make(options.questions, options.out)


def make(questions: list[str], out: Path) -> int:
    """Make the site of these questions' answers in a folder; 1 where Sphinx warns of anything."""
    from sphinx.application import Sphinx
    from sphinx.util.docutils import docutils_namespace, patch_docutils

    answers = [answered(name, out / "answers" / name) for name in questions]
    rmtree(out / "pages", ignore_errors=True)
    pages.write(answers, out / "pages")
    settings = Path(pages.__file__).parent
    with patch_docutils(settings), docutils_namespace():
        site = Sphinx(
            out / "pages", settings, out / "site", out / "doctrees", "html",
            confoverrides={"html_extra_path": [str(out / "pages" / "_extra")]},
            status=None, warning=sys.stderr, freshenv=True, warningiserror=True,
        )  # fmt: skip
        site.build(force_all=True)
    print(f"{len([*(out / 'site').rglob('*.html')])} pages in {out / 'site'}; open index.html")
    return site.statuscode


if __name__ == "__main__":
    sys.exit(main())
