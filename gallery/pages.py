"""The input of Sphinx: the guides as they are, and pages made of machines, answers, docstrings."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from shutil import copyfile, copytree, ignore_patterns
from typing import Any

from lxml import html
from PIL import Image

from scenarios.fmu_files import CLONE as ROOT
from workbench import Figure
from workbench.charts.style import STYLE
from workbench.export import PAGE
from workbench.figure import ERROR_SCOPE

from . import reference
from .answers import Answered

EXTRA = "_extra"
#: Width and height of the picture of a question [px]; chosen: twice what a card shows, for sharp screens.
THUMB = (480, 360)
#: Colours of the picture of a question; chosen: lines of eight colours with their soft edges.
THUMB_COLORS = 64
LANDING = "resonance"
SLIDER = "motor.T"
"""What can be changed on the first page: the resonance moves with it."""
INTEREST = (
    "resonance", "run_up", "sommerfeld", "iron_cycle", "iron_bounce", "orientation_time", "orientator_cycle",
    "resonance_map", "rod_force", "iron_orders", "iron_start", "mean_values", "packing_line", "induction_motor",
    "speed_step", "identify", "iron_identify", "orientator_identify",
)  # fmt: skip
"""Questions in the order in which a visitor looks at them; the others follow by name."""
MOVE = (
    "Move a slider: the FMUs run in your browser, offline. The figures with their errors stand beside the live "
    "numbers."
)


def write_pages(answers: Sequence[Answered], folder: Path) -> None:
    """Write all pages into a folder in which links resolve as they do in the project."""
    folder.mkdir(parents=True)
    for path in ROOT.iterdir():
        if path.suffix in (".md", ".py", ".toml") or path.name == "LICENSE":
            copyfile(path, folder / path.name)
        elif (
            path.is_dir()
            and path.name not in ("docs", "reference_systems", "results")
            and path.name[0] != "."
        ):
            (folder / path.name).symlink_to(path)
    copytree(ROOT / "docs", folder / "docs")
    copytree(ROOT / "reference_systems", folder / "reference_systems")
    for answer in answers:
        extra = folder / EXTRA / "questions" / answer.name
        copytree(answer.folder, extra, ignore=ignore_patterns("*.txt"))
        link_sources(extra / PAGE, answer.question.sources)
        (folder / "questions").mkdir(exist_ok=True)
        write_text(folder / "questions" / f"{answer.name}.md", question_page(answer))
    machines = sorted((folder / "docs" / "machines").glob("*.md"))
    for page in machines:
        write_text(page, machine_page(page, answers))
    write_text(folder / "machines.md", machine_list(machines, folder))
    write_text(folder / "questions.md", question_list(answers, folder))
    write_text(folder / "index.md", landing_page(answers, machines, folder))
    hosts = "\n".join(f"hosts/{page.stem}" for page in sorted((folder / "docs/hosts").glob("*.md")))
    with (folder / "docs" / "hosts.md").open("a", encoding="utf-8") as text:
        text.write(f"\n{toctree('', hosts)}\n")
    write_text(folder / "commands.md", reference.commands_page())
    for package in reference.API:
        write_text(folder / "reference" / f"{package}.md", reference.package_page(package))


def link_sources(page: Path, sources: Sequence[tuple[str, str]]) -> None:
    """Make the sources of a page links to the pages of the site."""
    text = page.read_text(encoding="utf-8")
    for link in {link for _, link in sources}:
        target = f"../../{link.replace('.md', '.html')}"
        text = text.replace(f"<code>{link}</code>", f'<a href="{target}">{link}</a>')
    page.write_text(text, encoding="utf-8")


def write_text(path: Path, text: str) -> None:
    """Write a page, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def toctree(caption: str, pages: str) -> str:
    """A section of the list of pages."""
    head = f":caption: {caption}\n" if caption else ""
    return f":::{{toctree}}\n:hidden:\n{head}\n{pages}\n:::"


def live_frame(answer: Answered, root: str, slider: str = "") -> str:
    """The live part of a question's page, with one slider or all, and a link to the whole page."""
    page = f"{root}questions/{answer.name}/report.html"
    label = escape(f"Live model: {answer.question.title}")
    only = f"?slider={slider}" if slider else ""
    return (
        f'<iframe class="live" src="{page}{only}" title="{label}" loading="lazy"></iframe>\n\n'
        f'<p class="way"><a href="{page}">Open the live page on its own</a>, with all curves, '
        "figures and data.</p>"
    )


def landing_page(answers: Sequence[Answered], machines: Sequence[Path], folder: Path) -> str:
    """The first page: a machine that runs, the ways into the project, and all machines."""
    first = next((answer for answer in answers if answer.name == LANDING), answers[0])
    guides = re.findall(r"\]\(([\w/]+)\.md\)", (ROOT / "docs" / "README.md").read_text("utf-8"))
    guides = [f"docs/{name}" for name in dict.fromkeys(guides) if "/" not in name]
    trees = {
        "Explore": ["machines", "questions"],
        "Guides": ["The project <README>", "All guides <docs/README>", *guides, "reference_systems/README"],
        "Reference": ["commands", *(f"reference/{name}" for name in reference.API), "CONTRIBUTING",
                      "SECURITY", "CHANGELOG"],
    }  # fmt: skip
    contents = "\n\n".join(toctree(caption, "\n".join(names)) for caption, names in trees.items())
    return f"""\
# Drive FMUs

Couple FMUs, and know how wrong the result is: a co-simulation master that states its error, FMUs made from a page of
equations, and answers about electromechanical drives.

**{first.question.title}** The FMUs run in your browser, offline. Move the slider.

{live_frame(first, "", SLIDER if first.name == LANDING else "")}

<nav class="doors" aria-label="Ways into the project">
<a href="docs/referee.html"><b>Judge a co-simulation</b><span>Right or not, by how much, and why</span></a>
<a href="docs/hosts.html"><b>FMUs from equations</b><span>FMI 2.0 and 3.0, for any simulator</span></a>
<a href="questions.html"><b>Ask about a drive</b><span>Figures with errors, pictures, live pages</span></a>
</nav>

## Machines

{deck(machine_cards(machines, folder))}

Read on: [the project on one page](README.md) · [all guides](docs/README.md) · [commands](commands.md) · Python:
[cosim](reference/cosim.md), [workbench](reference/workbench.md), [fmukit](reference/fmukit.md)

{contents}
"""


def question_page(answer: Answered) -> str:
    """The page of a question: its answer, live where it can be, its figures and options."""
    content, text = answer.content, (answer.question.module.__doc__ or "").strip()
    head, _, rest = text.partition("\n")
    used = ", ".join(
        f"[{fmu}](../docs/machines/{machine_page_name(fmu)}.md)"
        for fmu in dict.fromkeys(answer.question.parts.values())
    )
    verdict = "\n".join(f"> {line}\n>" for line in content["verdict"])
    blocks = [f'<p class="way"><a class="button" href="{answer.name}/report.html">Open the full '
             "answer</a> with curves, motion, data and how it was made.</p>"]  # fmt: skip
    if answer.has_live_page:
        blocks = [live_frame(answer, "../")]
    alt = escape("; ".join(chart_titles(answer)))
    blocks.append(f'<img src="{answer.name}/{answer.picture.name}" alt="{alt}" loading="lazy">')
    figures = "\n".join(
        f"| {escaped_cell(f['meaning'] or key)} | {escaped_cell(figure_text(f))} |"
        for key, f in content["figures"].items()
    )
    return "\n\n".join([
        f"# {head}", rest.strip(), f"Machines: {used}.", verdict, *blocks,
        f"## Figures\n\n| figure | value |\n| --- | --- |\n{figures}\n\n{ERROR_SCOPE}",
        f"## Run it\n\n```sh\n{answer.command}\n```\n\n```text\n{reference.question_options(answer.name)}\n```",
    ]) + "\n"  # fmt: skip


def escaped_cell(text: str) -> str:
    """Text in a table."""
    return text.replace("|", "\\|").replace("*", "\\*").replace("$", "\\$")


def figure_text(figure: dict[str, Any]) -> str:
    """A figure of the JSON in words."""
    return Figure(
        **figure | {"value": math.nan if figure["value"] is None else figure["value"]}
    ).text()


def chart_titles(answer: Answered) -> list[str]:
    """The titles of the charts of an answer."""
    page = html.parse(str(answer.folder / "report.html"))
    return [
        title.text_content() for title in page.xpath("//section[@aria-labelledby='charts']//h3")
    ]


def machine_page_name(fmu: str) -> str:
    """The name of a machine's page, such as "drive_motor", from that of its FMU."""
    pages = (ROOT / "docs" / "machines").glob("*.md")
    return next(page.stem for page in pages if page.stem.replace("_", "").lower() == fmu.lower())


def machine_page(page: Path, answers: Sequence[Answered]) -> str:
    """The page of a machine, with its live model and the questions about it."""
    text = page.read_text(encoding="utf-8")
    about = [
        answer
        for answer in answers
        if page.stem in map(machine_page_name, answer.question.parts.values())
    ]
    if not about:
        return text
    links = "\n".join(
        f"* [{answer.question.title}](../../questions/{answer.name}.md)" for answer in about
    )
    section = f"## Questions about this machine\n\n{links}\n"
    for answer in [answer for answer in about if answer.has_live_page][:1]:
        section = f"## Live model\n\n{MOVE}\n\n{live_frame(answer, '../../')}\n\n{section}"
    before, heading, after = text.partition("\n## ")
    return f"{before}\n{section}{heading}{after}"


def machine_list(machines: Sequence[Path], folder: Path) -> str:
    """The page that shows all machines by their drawings."""
    pages = toctree("", "\n".join(f"docs/machines/{page.stem}" for page in machines))
    cards = deck(machine_cards(machines, folder))
    return f"# Machines\n\nEach is one FMU, made from a page of equations.\n\n{cards}\n\n{pages}\n"


def machine_cards(machines: Sequence[Path], folder: Path) -> list[str]:
    """A card for each machine; their drawings are copied to the site."""
    cards = []
    for page in machines:
        ((name, title),) = re.findall(r"(?m)^# (\w+)\n\n\*\*(.+)\.\*\*", page.read_text("utf-8"))
        drawing = ROOT / "components" / page.stem / "drawing.svg"
        picture = Path(EXTRA, "pictures", drawing.with_stem(page.stem).name)
        (folder / picture).parent.mkdir(parents=True, exist_ok=True)
        copyfile(drawing, folder / picture)
        cards.append(card(f"docs/machines/{page.stem}.html", picture, name, title))
    return cards


def by_interest(answers: Sequence[Answered]) -> list[Answered]:
    """The answers in the order in which the site lists them."""
    rank = {name: number for number, name in enumerate(INTEREST)}
    return sorted(answers, key=lambda answer: (rank.get(answer.name, len(rank)), answer.name))


def question_list(answers: Sequence[Answered], folder: Path) -> str:
    """The page that shows all questions by their pictures."""
    cards = []
    for answer in by_interest(answers):
        target = Path(EXTRA, "pictures", answer.picture.name)
        (folder / target).parent.mkdir(parents=True, exist_ok=True)
        with Image.open(answer.picture) as picture:
            thumbnail(picture).save(folder / target, optimize=True)
        caption = answer.question.title + (" Live." if answer.has_live_page else "")
        cards.append(card(f"questions/{answer.name}.html", target, answer.name, caption))
    pages = toctree(
        "", "\n".join(f"{answer.name} <questions/{answer.name}>" for answer in by_interest(answers))
    )
    return f"# Questions\n\nEach is a short Python file; the [answers](docs/scenarios.md) state their errors.\n\n{deck(cards)}\n\n{pages}\n"


def thumbnail(picture: Image.Image) -> Image.Image:
    """Return the upper part of the first chart of a picture, small; all charts would be too small to read."""
    is_single = picture.width <= STYLE.single_image_width_in * STYLE.image_dpi
    width = picture.width if is_single else round(STYLE.image_width_in * STYLE.image_dpi)
    top = round(STYLE.title_height_in * STYLE.image_dpi)
    height = min(width * THUMB[1] // THUMB[0], picture.height - top)
    part = picture.convert("RGB").crop((0, top, width, top + height))
    size = THUMB[0], round(height * THUMB[0] / width)
    return part.resize(size, Image.Resampling.LANCZOS).quantize(THUMB_COLORS)


def deck(cards: Sequence[str]) -> str:
    """A list of cards, side by side where the window is wide enough."""
    return f'<ul class="cards">{"".join(cards)}</ul>'


def card(page: str, picture: Path, name: str, title: str) -> str:
    """A picture that links to a page."""
    image = f'<img src="{picture.relative_to(EXTRA).as_posix()}" alt="" loading="lazy">'
    return f'<li><a href="{page}">{image}<b>{name}</b></a><span>{escape(title)}</span></li>'
