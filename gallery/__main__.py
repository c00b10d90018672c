"""python -m gallery [--questions NAME,NAME] [--pictures] [--out DIR]: build the project's website.

DIR/site contains the guides, the machines with their live models, the answers to the questions, a
reference and a search. It needs no server and no network: open index.html, or publish the folder as
it is. Answers are kept in DIR/answers and renewed when the code or the FMUs have changed.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from shutil import copyfile

from cosim import SetupError
from cosim.cli.options import Parser, exit_code, require
from scenarios.fmu_files import CLONE as ROOT
from scenarios.fmu_files import PACKAGE as HOME
from workbench.catalog import names
from workbench.export import PAGE
from workbench.files import UNFINISHED, remove, replacement
from workbench.runs.folder import reservation

from . import pages
from .answers import Answered, answered
from .child import run_in_project
from .drawings import drawings

#: A file of Sphinx by which a folder is known as a site.
SIGN = ".buildinfo"
MENDED = {
    'class="caption" role="heading"': 'class="caption" role="heading" aria-level="2"',
    '<aside class="sidebar-drawer"': '<aside class="sidebar-drawer" aria-label="Pages"',
    '<aside class="toc-drawer"': '<aside class="toc-drawer" aria-label="On this page"',
    "<pre>": '<pre tabindex="0">',
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
    '<div id="search-results">': '<h1>Search</h1>\n<div id="search-results">',
}


def main() -> int:
    """Build the site as the command line says; return the exit code."""
    question_names = [*names(HOME)]
    parser = Parser(prog="python -m gallery", description="Build the project's website.")
    parser.add_argument(
        "--questions", type=lambda text: text.split(","), default=question_names, metavar="NAME,NAME",
        help="answer only these (default: all)",
    )  # fmt: skip
    parser.add_argument(
        "--pictures", action="store_true",
        help="also renew the pictures in docs and the drawings of machines",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "gallery", help="folder")
    options = parser.parse_args()
    out = options.out.resolve()
    for name in options.questions:
        if name not in question_names:
            parser.error(f"unknown question {name!r}; there are {', '.join(question_names)}")
    require("sphinx", "python -m gallery")
    with reservation(out):
        answers = [answered(name, out / "answers" / name) for name in options.questions]
        for answer in answers if options.pictures else ():
            if (target := ROOT / "docs" / answer.picture.name).is_file():
                with replacement(target) as fresh:
                    copyfile(answer.picture, fresh)
        for path, drawing in drawings().items() if options.pictures else ():
            with replacement(path) as fresh:
                fresh.write_text(drawing, encoding="utf-8")
        site = build_site(answers, out)
    print(f"{len([*site.rglob('*.html')])} pages in {site}: open index.html")
    return 0


def build_site(answers: Sequence[Answered], out: Path) -> Path:
    """Build the site with these answers, which takes the place of out/site when it is complete.

    Raises
    ------
    CalledProcessError
        For any warning.
    SetupError
        If out/site is there and is no site.
    """
    site, work = out / "site", out / UNFINISHED
    if site.is_symlink() or (site.exists() and not (site / SIGN).is_file()):
        raise SetupError(f"{site} is no earlier site: move it, or choose another folder with --out")
    remove(work)
    work.mkdir(parents=True)
    try:
        _write_site(answers, work / "pages", work / "site")
        if site.exists():
            site.rename(work / "earlier")
        (work / "site").rename(site)
    finally:
        remove(work)
    return site


def _write_site(answers: Sequence[Answered], source: Path, target: Path) -> None:
    """Write the pages that Sphinx reads, and what it makes of them."""
    pages.write_pages(answers, source)
    # A process of its own: Sphinx replaces default values of the functions that it documents by their text.
    command = [
        sys.executable, "-m", "sphinx", "--builder", "html", "--quiet", "--fail-on-warning", "--fresh-env",
        "--write-all", "--conf-dir", str(Path(pages.__file__).parent),
        "--doctree-dir", str(target.with_name("doctrees")),
        "--define", f"html_extra_path={source / pages.EXTRA}", str(source), str(target),
    ]  # fmt: skip
    run_in_project(command, check=True)
    for page in target.rglob("*.html"):
        if page.name != PAGE:
            page.write_text(made_accessible(page.read_text(encoding="utf-8")), encoding="utf-8")


def made_accessible(text: str) -> str:
    """A page of the theme, made accessible without sight or mouse."""
    for less, more in MENDED.items():
        text = text.replace(less, more)
    return text


if __name__ == "__main__":
    sys.exit(exit_code(main))
