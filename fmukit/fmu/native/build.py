"""A native FMU: the C of a component, compiled for every platform with the Zig tool chain."""

import hashlib
import importlib.metadata
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import SubElement

import fmpy

from ...declare.variables import Interface, class_name, only_steps
from ...write.entries import written
from .. import page, plot, reference, terminals
from ..archive import LICENSE, guid_of, write_archive
from ..python.instance import slave_class
from ..xml import NATIVE, to_xml

RUNTIME = Path(__file__).with_name("fmi2.c")
HEADERS = [
    Path(fmpy.__file__).with_name("c-code") / name
    for name in ("fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
]
TARGETS = {
    "linux64/{}.so": "x86_64-linux-gnu.2.17",
    "aarch64-linux/{}.so": "aarch64-linux-gnu.2.17",
    "win64/{}.dll": "x86_64-windows-gnu",
    "x86_64-darwin/{}.dylib": "x86_64-macos",
    "aarch64-darwin/{}.dylib": "aarch64-macos",
}
OPTIONS = (
    "-std=c99", "-O2", "-ffp-contract=off", "-fno-slp-vectorize", "-fvisibility=hidden", "-shared",
    "-fPIC", "-s",
)  # fmt: skip
DEPENDENCIES = """\
linux64 and aarch64-linux with glibc 2.17 or newer, win64, darwin64 (universal): the C library and
its mathematics, nothing else. Built from sources/, which any C99 compiler takes.
"""


class NativeBuild(NamedTuple):
    """A component ready to compile: its C but for the guid, and the hash of all it is made from."""

    model: ModuleType
    source: str
    indicators: int | None
    digest: str

    @property
    def name(self) -> str:
        return class_name(self.model)

    @property
    def guid(self) -> str:
        return guid_of(self.digest)


def collect(model: ModuleType) -> NativeBuild:
    """Trace a model and hash everything that its native FMU is made from."""
    interface = Interface(model)
    digest = hashlib.sha256(importlib.metadata.version("ziglang").encode())
    makers = [*sorted(RUNTIME.parents[1].glob("*.py")), *sorted(RUNTIME.parent.glob("*.*"))]
    makers += [*HEADERS]
    for maker in (*makers, LICENSE):
        digest.update(hashlib.sha256(maker.read_bytes()).digest())
    source, _, indicators = written(model)
    exchanged = None if only_steps(model) else indicators
    digest.update(source.encode())
    digest.update(ElementTree.tostring(to_xml(interface, "", NATIVE, exchanged)))
    digest.update(page.html(interface).encode())
    digest.update(repr(terminals.entries(interface)).encode())
    digest.update(os.environ.get("SOURCE_DATE_EPOCH", "").encode())
    return NativeBuild(model, source, exchanged, digest.hexdigest())


def pack(build: NativeBuild, fmu: Path) -> None:
    """Write the FMU; raises RuntimeError with the words of the compiler if it fails."""
    interface = Interface(build.model)
    rows = reference.experiment(slave_class(build.model, build.guid))
    licence = f"{LICENSE.read_text()}\nThe headers of FMI in sources/ carry their own.\n"
    sources = {
        f"{build.name}.c": build.source.replace(
            '#define GUID ""', f'#define GUID "{build.guid}"'
        ).encode(),
        RUNTIME.name: RUNTIME.read_bytes(),
        **{header.name: header.read_bytes() for header in HEADERS},
    }
    contents = {
        "modelDescription.xml": description(interface, build),
        "documentation/index.html": page.html(interface, plot.svg(interface, rows)).encode(),
        "documentation/externalDependencies.txt": DEPENDENCIES.encode(),
        "documentation/licenses/license.txt": licence.encode(),
        **{f"sources/{name}": content for name, content in sources.items()},
        **reference.entries(interface, rows),
        **terminals.entries(interface),
        **{f"binaries/{path}": content for path, content in binaries(build.name, sources)},
    }
    write_archive(contents, fmu)


def description(interface: Interface, build: NativeBuild) -> bytes:
    """modelDescription.xml with the list of sources."""
    root = to_xml(interface, build.guid, NATIVE, build.indicators)
    for kind in (*root.iter("ModelExchange"), *root.iter("CoSimulation")):
        SubElement(SubElement(kind, "SourceFiles"), "File", name=f"{build.name}.c")
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def binaries(name: str, sources: dict[str, bytes]) -> Iterator[tuple[str, bytes]]:
    """The shared libraries by their place in the FMU."""
    with tempfile.TemporaryDirectory(prefix="native_") as temporary, ThreadPoolExecutor() as pool:
        folder = Path(temporary)
        for file, content in sources.items():
            (folder / file).write_bytes(content)
        places = [path.format(name) for path in TARGETS]
        compiled = pool.map(
            lambda target, place: compile_for(target, place, name, folder), TARGETS.values(), places
        )
        libraries = dict(zip(places, compiled))
    yield from ((path, code) for path, code in libraries.items() if "x86_64-darwin" not in path)
    slices = [code for path, code in libraries.items() if path.endswith(".dylib")]
    yield f"darwin64/{name}.dylib", universal(slices)


def compile_for(target: str, place: str, name: str, folder: Path) -> bytes:
    """The shared library for one target of Zig."""
    library = folder / place
    library.parent.mkdir()
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *OPTIONS]
    command += ["-o", place, f"{name}.c"]
    command += [] if "windows" in target else ["-lm"]
    command += [f"-Wl,-install_name,@rpath/{library.name}"] if "macos" in target else []
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name} does not compile for {target}:\n{done.stderr}")
    return library.read_bytes()


def universal(slices: list[bytes]) -> bytes:
    """One library for several processors of a Mac: a table of offsets before the libraries."""
    align = 14
    offset, table, body = 1 << align, struct.pack(">2I", 0xCAFEBABE, len(slices)), b""
    for code in slices:
        cpu, subtype = struct.unpack_from("<2I", code, 4)
        table += struct.pack(">5I", cpu, subtype, offset + len(body), len(code), align)
        body += code + bytes(-len(code) % (1 << align))
    return table.ljust(offset, b"\0") + body
