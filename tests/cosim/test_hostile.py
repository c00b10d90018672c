"""Files that were made to hurt end soon: one line, exit code 2, little memory, nothing left behind."""

import os
import resource
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cosim import SetupError, System
from cosim.system import connect
from tests.conftest import ROOT, described, rewritten
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import BINARY
from tests.cosim.foreign import pack as foreign
from tests.cosim.test_ssp import (
    LOOP,
    MOTOR,
    SPACE,
    Files,
    bindings,
    component,
    connectors,
    flat,
    pack,
    ssd,
    system_in,
    values,
)
from tests.cosim.third import pack as third

SSD = "SystemStructure.ssd"
ENTITIES = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
LAUGHS = f'<!DOCTYPE x [<!ENTITY e0 "ha">{ENTITIES}]>'
OUTSIDE = '<!DOCTYPE x [<!ENTITY out SYSTEM "file:///etc/passwd">]>'
OPEN, CLOSE = '<ssd:System name="s"><ssd:Elements>', "</ssd:Elements></ssd:System>"


def encoded(text: str, codec: str, named: str) -> bytes:
    """An XML file in an encoding, and the one that it names."""
    return f'<?xml version="1.0" encoding="{named}"?>{text}'.encode(codec)


def doubled(depth: int, width: int) -> str:
    """Systems that stand for the one before, `width` times each, `depth` times over."""
    inner = MOTOR.format("")
    for level in range(depth):
        many = "".join(LOOP.format(f"a{n}", f"#l{level}") for n in range(width))
        level_text = f'<ssd:System name="l{level}" id="l{level}"><ssd:Elements>{inner}</ssd:Elements></ssd:System>'
        inner = level_text + many
    return ssd(inner)


def chained(count: int) -> Files:
    """Files, each of which holds the next."""
    files = {f"{n}.ssd": ssd(LOOP.format("a", f"{n + 1}.ssd")) for n in range(count)}
    return {SSD: ssd(LOOP.format("a", "0.ssd")), **files}


def row(count: int, step: int) -> str:
    """Systems that hand a value on to each other, connected in this order."""
    ends = connectors(("i", "input", ""), ("o", "output", ""))
    through = '<ssd:Connection startConnector="i" endConnector="o"/>'
    systems = "".join(system_in(f"s{n}", "", ends, through) for n in range(count))
    wires = [SPACE.format(f"s{n}", "o", f"s{n + 1}", "i") for n in range(count - 1)]
    return ssd(systems, "".join(wires[::step]), bindings(values('s0.i Real value="1"')))


PLAIN = flat()
TEXTS: dict[str, tuple[str | bytes | Files, str]] = {
    "billion laughs": (LAUGHS + ssd("&e11;"), ""),
    "laughs in a name": (LAUGHS + ssd(MOTOR.format("").replace("motor", "&e11;", 1)), ""),
    "entity from outside": (OUTSIDE + ssd("&out;"), "a document type, which may define entities"),
    "deep XML": (ssd(OPEN * 2000 + CLOSE * 2000), "Excessive depth in document"),
    "systems in systems": (ssd(OPEN * 100 + MOTOR.format("") + CLOSE * 100), "more than 50 deep"),
    "a long way": (row(5000, 1), "values pass more than 200 connectors"),
    "a long way back": (row(5000, -1), "values pass more than 200 connectors"),
    "files in files": (chained(1000), "systems are nested more than 50 deep"),
    "a thousand million parts": (doubled(9, 10), "the system has too many elements"),
    "a long name": (component("").replace("part", "a" * 11_000_000), "Buffer size limit exceeded"),
    "a long file name": (component(f'source="{"a" * 5000}"'), "is not a file name: File name too"),
    "no file name": (component('source="a%00b"'), "is not a file name: "),
    "no address": (component('source="http://["'), "not a valid value"),
    "foreign bytes": (encoded(PLAIN.replace("all", "ä"), "latin-1", "UTF-8"), "Invalid bytes in character"),
    "unknown encoding": (encoded(PLAIN, "utf-8", "klingon"), "nsupported encoding"),
    "cut short": (encoded(PLAIN, "utf-16", "UTF-16")[:-9], "line 7: "),
    "no XML": (b"\x00\xff" * 1000, "line 1: "),
    "nothing": ("", "line 1: "),
}  # fmt: skip
BOMBS = ("billion laughs", "laughs in a name", "a thousand million parts", "files in files")


Damage = Callable[[zipfile.ZipFile], object]
BIG = 3_000_000_000


def first(**attributes: Any) -> Damage:
    """What the directory at the end of an archive says of its first file, true or not."""
    return lambda archive: [setattr(archive.infolist()[0], *item) for item in attributes.items()]


def also(name: str, content: str = "x", mode: int = 0o100644) -> Damage:
    """One more file in an archive, or a link."""

    def write(archive: zipfile.ZipFile) -> None:
        entry = zipfile.ZipInfo(name)
        entry.external_attr = mode << 16
        archive.writestr(entry, content)

    return write


ARCHIVES: dict[str, tuple[Damage, str]] = {
    "bomb": (first(file_size=BIG), "MB unpacked, far more than it is packed"),
    "said to be short": (first(file_size=10), "is not a readable zip file: Bad CRC-32"),
    "encrypted": (first(flag_bits=1), "is not a readable zip file: File"),
    "of the future": (first(extract_version=99), "is not a readable zip file: zip file version 9.9"),
    "unknown packing": (first(compress_type=99), "compression method is not supported"),
    "slip": (also("../evil.txt"), "'../evil.txt' points outside the folder of the package"),
    "slip of Windows": (also("..\\evil.txt"), "points outside the folder of the package"),
    "root": (also("/tmp/evil.txt"), "'/tmp/evil.txt' points outside the folder of the package"),
    "drive": (also("C:/evil.txt"), "'C:/evil.txt' points outside the folder of the package"),
    "a file as a folder": (also(f"{SSD}/x"), "is not a readable zip file"),
    "link": (also("link.fmu", "/etc/passwd", 0o120777), "part part: "),
}  # fmt: skip


Refused = Callable[[Path, str], None]


@pytest.fixture
def refused(command_output: CommandOutput) -> Refused:
    """Say why a file cannot be read, in one short line."""

    def why(path: Path, message: str) -> None:
        error = command_output("run", path, "--stop", 0.1, "--step", 0.1, code=2)
        assert message in error and len(error) < 500, error[:300]

    return why


def hostile(name: str, fmus: Path, folder: Path) -> tuple[Path, str]:
    """A package of these texts, and what is said of it."""
    content, message = TEXTS[name]
    files = content if isinstance(content, dict) else {SSD: content}
    files = {"resources/DriveMotor.fmu": fmus / "DriveMotor.fmu", **files}
    return pack(folder / "test.ssp", files), message


@pytest.mark.parametrize("name", [name for name in TEXTS if name not in BOMBS])
def test_hostile_structures_are_refused(
    name: str, fmus: Path, tmp_path: Path, refused: Refused
) -> None:
    refused(*hostile(name, fmus, tmp_path))


@pytest.mark.parametrize("name", [SSD, "OspSystemStructure.xml"])
def test_a_pipe_is_no_file(name: str, tmp_path: Path, refused: Refused) -> None:
    """Nobody ever writes into it."""
    os.mkfifo(tmp_path / name)
    refused(tmp_path, "there is no file")
    refused(tmp_path / name, "there is no file")


@pytest.mark.parametrize("name", ARCHIVES)
def test_hostile_archives_are_refused(name: str, tmp_path: Path, refused: Refused) -> None:
    damage, message = ARCHIVES[name]
    with zipfile.ZipFile(tmp_path / "test.ssp", "w") as archive:
        archive.writestr(SSD, component('source="link.fmu"'))
        damage(archive)
    before = sorted(tmp_path.parent.rglob("*"))
    refused(tmp_path / "test.ssp", message)
    assert sorted(tmp_path.parent.rglob("*")) == before


@pytest.mark.parametrize("name", ["modelDescription.xml", "resources/token.txt"])
def test_an_fmu_is_no_bomb(name: str, tmp_path: Path, refused: Refused) -> None:
    fmu = foreign(tmp_path / "A.fmu")
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.getinfo(name).file_size = BIG
        archive.writestr("more.txt", "")
    message = (
        "modelDescription.xml of more than 128 MiB"
        if name[0] == "m"
        else "MB unpacked, far more than it is packed"
    )
    refused(fmu, message)


def test_zeros_that_pack_to_nothing_are_not_unpacked(tmp_path: Path, refused: Refused) -> None:
    """A gigabyte of them, in a megabyte, was."""
    fmu = foreign(tmp_path / "A.fmu")
    with zipfile.ZipFile(fmu, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("resources/zeros", bytes(10**8))
    refused(fmu, "MB unpacked, far more than it is packed: leave out what it does not need")


@pytest.mark.parametrize(
    ("codec", "named"), [("utf-16", "UTF-16"), ("latin-1", "ISO-8859-1"), ("utf-8-sig", "UTF-8")]
)
def test_other_encodings_are_read(
    codec: str, named: str, fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    structure = encoded(flat().replace('name="all"', 'name="Räder"'), codec, named)
    files: Files = {
        f"resources/{n}.fmu": fmus / f"{n}.fmu" for n in ("DriveMotor", "CrankConveyor")
    }
    path = pack(tmp_path / "test.ssp", files | {SSD: structure})
    command_output("info", path)


def small() -> None:
    """At most 1.5 GiB and 20 s of a processor."""
    resource.setrlimit(resource.RLIMIT_AS, (3 * 2**29,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (20, 20))


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_take_little(name: str, fmus: Path, tmp_path: Path) -> None:
    path, message = hostile(name, fmus, tmp_path)
    command = [sys.executable, "-m", "cosim", "info", str(path)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, preexec_fn=small
    )
    assert (done.returncode, message in done.stderr) == (2, True), done.stderr[-500:]
    assert done.stderr.count("\n") == 1 and len(done.stderr) < 500


DIMENSION = ('(<Float64 name="h"[^>]*)/>', r'\1><Dimension start="{}"/></Float64>')


@pytest.mark.parametrize("count", [1_000_000_000_000, 20_000_000])
def test_an_array_with_too_many_elements_is_named(
    count: int, tmp_path: Path, refused: Refused
) -> None:
    swap = described((DIMENSION[0], DIMENSION[1].format(count)))
    fmu = rewritten(third(tmp_path / "A.fmu"), tmp_path / "B.fmu", swap)
    refused(
        fmu, f"has too many variables: h has {count} elements, and all arrays together may have"
    )


@pytest.mark.parametrize(
    ("swap", "message"),
    [
        (('<Float64 name="h"', "<Float64"), "there is no name"),
        (('name="h"', f'name="{11_000_000 * "h"}"'), "limit exceeded, try XML_PARSE_HUGE, line 1"),
        (('stepSize="[^"]*"', 'stepSize="ten"'), "modelDescription.xml, line 8: stepSize: 'ten' is not a number"),
        ((r"(?s)<ModelVariables>.*</ModelVariables>", ""), "is not a valid FMU: modelDescription.xml"),
        ((r'valueReference="\d+"', 'valueReference="-"'), "valueReference of time: '-' is not a 32-bit unsigned integer"),
    ],
)  # fmt: skip
def test_a_malformed_description_is_refused_with_a_sentence(
    swap: tuple[str, str], message: str, tmp_path: Path, refused: Refused
) -> None:
    refused(rewritten(third(tmp_path / "A.fmu"), tmp_path / "B.fmu", described(swap)), message)


def test_a_library_of_another_name_is_named(tmp_path: Path, command_output: CommandOutput) -> None:
    """And the FMU is described all the same."""

    def edit(files: dict[str, Any]) -> None:
        files["binaries/linux64/other.so"] = files.pop(BINARY)

    fmu = rewritten(foreign(tmp_path / "A.fmu"), tmp_path / "B.fmu", edit)
    reason = "has no binaries/linux64/foreign.so, the name that its modelIdentifier gives; "
    reason += "binaries/linux64/ has other.so"
    assert reason in command_output("run", fmu, "--stop", 1, "--step", 0.1, code=2)
    text = command_output("info", fmu)
    assert f"cannot run here: part B: {fmu} {reason}" in text and "output  B.y: Real" in text


def test_what_only_other_platforms_run_and_clocks_that_nothing_ticks_are_described(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    def edit(files: dict[str, Any]) -> None:
        files["binaries/win64/foreign.dll"] = files.pop(BINARY)

    fmu = rewritten(foreign(tmp_path / "A.fmu"), tmp_path / "B.fmu", edit)
    text = command_output("info", fmu)
    assert "for win64" in text and "has no binary for this platform, binaries/linux64" in text
    waits = third(tmp_path / "waits.fmu", 'intervalVariability="triggered"')
    assert "cannot run here: waits.clock is a triggered clock" in command_output("info", waits)
    assert "is a triggered clock" in command_output("run", waits, code=2)
    swap = described((r"(?s)<CoSimulation.*?/>", '<ScheduledExecution modelIdentifier="third"/>'))
    scheduled = rewritten(third(tmp_path / "third.fmu"), tmp_path / "scheduled.fmu", swap)
    assert "offers scheduled execution only" in command_output("info", scheduled)


@pytest.mark.parametrize(
    "kind", [LAUGHS, OUTSIDE, "<!DOCTYPE x>", '<!DOCTYPE x SYSTEM "http://x/y.dtd">']
)
def test_a_model_description_with_a_document_type_is_refused(kind: str, tmp_path: Path) -> None:
    fmu, typed = foreign(tmp_path / "plain.fmu"), tmp_path / "typed.fmu"
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(typed, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                root = content.index(b"<fmiModelDescription")
                content = content[:root] + kind.encode() + content[root:]
            new.writestr(name, content)
    with pytest.raises(
        SetupError, match=r"modelDescription.xml has a document type, .*: remove it$"
    ):
        connect(System({"A": typed}))
    connect(System({"A": fmu}))
