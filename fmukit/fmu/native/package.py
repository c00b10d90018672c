"""A native FMU of FMI 2.0 or 3.0: the C of a component, compiled with Zig for the platforms that are asked for."""

import importlib.metadata
import platform
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import SubElement

import fmpy

from ...codegen.entries import generate
from ...declare.interface import Interface, class_name, co_simulation_only_reason
from .. import page, plot, reference, terminals
from ..archive import LICENSE, digest_of, guid_of, with_hash_section, write_archive
from ..description.fmi2 import NATIVE, to_xml
from ..description.fmi3 import to_fmi3

RUNTIMES = sorted(Path(__file__).parent.glob("fmi*.c"))
NAMES = ("fmi2FunctionTypes", "fmi2TypesPlatform", "fmi3FunctionTypes", "fmi3PlatformTypes")
HEADERS = [Path(fmpy.__file__).with_name("c-code") / f"{name}.h" for name in NAMES]
#: Zig's targets for a platform of FMI 2.0, by the folder of each in an FMU of FMI 3.0
TARGETS = {
    "linux64": {"x86_64-linux": "x86_64-linux-gnu.2.17"},
    "aarch64-linux": {"aarch64-linux": "aarch64-linux-gnu.2.17"},
    "win64": {"x86_64-windows": "x86_64-windows-gnu"},
    "darwin64": {"x86_64-darwin": "x86_64-macos", "aarch64-darwin": "aarch64-macos"},
}
EXTENSIONS = {"win64": "dll", "darwin64": "dylib"}
ALL = tuple(TARGETS)
#: the platform of a machine by `sys.platform` and `platform.machine()` in small letters
MACHINES = {
    ("linux", "x86_64"): "linux64",
    ("linux", "aarch64"): "aarch64-linux",
    ("win32", "amd64"): "win64",
    ("darwin", "x86_64"): "darwin64",
    ("darwin", "arm64"): "darwin64",
}
_MACHINE = MACHINES.get((sys.platform, platform.machine().lower()))
#: the platform of this machine; none where no FMU can be built for it
HOST = (_MACHINE,) if _MACHINE else ()
BUILD_DESCRIPTION = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{0}">
    <SourceFileSet language="C99"><SourceFile name="{0}.c"/></SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""
OPTIONS = (
    "-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fno-slp-vectorize",
    "-fvisibility=hidden", "-s",
)  # fmt: skip
LIBRARY_FLAGS = ("-shared", "-fPIC", "-rtlib=none")
WINDOWS_LAYER = Path(__file__).with_name("windows.c")
UCRT = [f"-lapi-ms-win-crt-{part}-l1-1-0" for part in ("heap", "math", "private", "string")]
WASM_LAYER = Path(__file__).with_name("wasm.c")
#: The C library for WebAssembly is not linked: to compile it takes eight times as long as a component, and
#: its texts are most of a module. The mathematics come from where it has them, with the same bits.
WASM_FLAGS = (
    "-nostdlib", "-rtlib=compiler-rt", "-Wl,--no-entry", "-Wl,--strip-all", "-Dhidden=",
)  # fmt: skip
WASM_HEADERS = (
    "musl/src/internal", "musl/arch/generic", "include/wasm-wasi-musl", "include/generic-musl",
)  # fmt: skip
WASM_MATH = Path(__file__).with_name("wasm_math.zig")
MUSL_MATH = (
    "__expo2", "__math_divzero", "__math_invalid", "__math_oflow", "__math_uflow", "__math_xflow",
    "acosh", "asinh", "atan2", "atanh", "erf", "exp_data", "expm1", "pow", "pow_data", "sinh",
)  # fmt: skip
WASM_FOLDER = "extra/org.webassembly.wasm32"
DEPENDENCIES = """\
The binaries for {} need the C library
and its mathematics, nothing else; on Linux glibc 2.17 or newer. They are built from sources/, which any
C99 compiler accepts.
"""


class NativeBuild(NamedTuple):
    """A component to compile for a version of FMI and some platforms, and the hash of all it is made from."""

    model: ModuleType
    fmi: int
    platforms: tuple[str, ...]
    digest: str

    @property
    def name(self) -> str:
        """The name of the FMU, as its model description gives it."""
        return class_name(self.model)

    @property
    def guid(self) -> str:
        """The identifier that changes whenever a source of the FMU does."""
        return guid_of(self.digest)

    @property
    def targets_by_library(self) -> dict[str, list[str]]:
        """The targets of Zig for each shared library, by its place in the FMU."""
        places: dict[str, list[str]] = {}
        for name in self.platforms:
            file = f"{self.name}.{EXTENSIONS.get(name, 'so')}"
            for folder, target in TARGETS[name].items():
                place = f"binaries/{name if self.fmi == 2 else folder}/{file}"
                places.setdefault(place, []).append(target)
        return places


def hashed_build(model: ModuleType, fmi: int = 2, platforms: tuple[str, ...] = HOST) -> NativeBuild:
    """The build of the native FMU of a model, with the hash of all that it is made from, whatever its platforms."""
    flavour = f"native {fmi}, Zig {importlib.metadata.version('ziglang')}"
    return NativeBuild(model, fmi, platforms, digest_of(Interface(model), flavour, HEADERS))


def sources_of(build: NativeBuild) -> dict[str, bytes]:
    """All that is compiled, by file name."""
    generated = generate(build.model)
    source = generated.c.replace('#define GUID ""', f'#define GUID "{build.guid}"')
    if build.fmi == 3:
        source = source.replace('#include "fmi2.c"', '#include "fmi3.c"') + generated.run_to_event
    files = {file.name: file.read_bytes() for file in source_files(build.fmi)}
    return {f"{build.name}.c": source.encode(), **files}


def write_fmu(build: NativeBuild, fmu: Path) -> None:
    """Write the FMU; raises RuntimeError with the words of the compiler if it fails."""
    interface, sources = Interface(build.model), sources_of(build)
    rows = reference.default_experiment(build.model)
    licence = f"{LICENSE.read_text()}\nThe FMI headers in sources/ carry their own licence.\n"
    build_description = {
        "sources/buildDescription.xml": BUILD_DESCRIPTION.format(build.name).encode()
    }
    contents = {
        "modelDescription.xml": description(interface, build),
        "documentation/index.html": page.html(interface, plot.svg(interface, rows)).encode(),
        "documentation/externalDependencies.txt": DEPENDENCIES.format(
            ", ".join(build.platforms)
        ).encode(),
        "documentation/licenses/license.txt": licence.encode(),
        **{f"sources/{name}": content for name, content in sources.items()},
        **reference.files_of_reference(interface),
        **terminals.files_of_terminals(interface),
        **dict(binaries(build, sources)),
        **(
            build_description
            if build.fmi == 3
            else {f"{WASM_FOLDER}/{build.name}.wasm": wasm_module(build)}
        ),
    }
    write_archive(contents, fmu)


def source_files(fmi: int) -> list[Path]:
    """The files of ours and of the standard that go with the C of a component."""
    return [
        file
        for file in (*RUNTIMES, *HEADERS, WASM_LAYER, WASM_MATH)
        if (file not in (WASM_LAYER, WASM_MATH) if fmi == 3 else "fmi3" not in file.name)
    ]


def description(interface: Interface, build: NativeBuild) -> bytes:
    """modelDescription.xml; of FMI 2.0 with the list of sources."""
    for_exchange = not co_simulation_only_reason(build.model)
    indicators = generate(build.model).indicators if for_exchange else None
    root = to_xml(interface, build.guid, NATIVE, indicators)
    if build.fmi == 3:
        root = to_fmi3(root)
    kinds = [*root.iter("ModelExchange"), *root.iter("CoSimulation")]
    for kind in kinds if build.fmi == 2 else ():
        SubElement(SubElement(kind, "SourceFiles"), "File", name=f"{build.name}.c")
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def write_wasm(build: NativeBuild, path: Path) -> None:
    """Write the module for WebAssembly; raises RuntimeError with the words of the compiler if it fails."""
    path.write_bytes(wasm_module(build))


def binaries(build: NativeBuild, sources: dict[str, bytes]) -> Iterator[tuple[str, bytes]]:
    """The shared libraries by their place in the FMU."""
    with tempfile.TemporaryDirectory(prefix="native_") as temporary:
        folder = Path(temporary)
        for file, content in sources.items():
            (folder / file).write_bytes(content)
        for place, targets in build.targets_by_library.items():
            slices = [compile_for(t, Path(place).name, build.name, folder) for t in targets]
            yield place, slices[0] if len(slices) == 1 else universal(slices)


def compile_for(target: str, library: str, name: str, folder: Path) -> bytes:
    """The shared library for one target of Zig, which may contain its own name."""
    if "windows" in target:
        # beside what it includes: of a source elsewhere the compiler takes the object that it has made
        # before, while the files are unchanged that were included then, which may be those of another build
        (folder / WINDOWS_LAYER.name).write_bytes(WINDOWS_LAYER.read_bytes())
        object_file, options = f"{name}.obj", ["-c", f'-DMODEL="{name}.c"']
        run_compiler(target, WINDOWS_LAYER.name, object_file, folder, options)
        return run_compiler(
            target, object_file, library, folder, ["-shared", "-nostdlib", "-Wl,--no-entry", *UCRT]
        )
    options = [*LIBRARY_FLAGS, "-lm"]
    options += [f"-Wl,-install_name,@rpath/{library}"] if "macos" in target else ["-Wl,-z,defs"]
    return run_compiler(target, f"{name}.c", library, folder, options)


@cache
def wasm_module(build: NativeBuild) -> bytes:
    """The module for WebAssembly, which needs no imports; `wasm.c` says what it exports."""
    with tempfile.TemporaryDirectory(prefix="wasm_") as temporary:
        folder = Path(temporary)
        for file, content in sources_of(build).items():
            (folder / file).write_bytes(content)
        libc = Path(str(files("ziglang"))) / "lib" / "libc"
        headers = [f"-isystem{libc / part}" for part in WASM_HEADERS]
        mathematics = [str(libc / "musl/src/math" / f"{name}.c") for name in MUSL_MATH]
        # in a file, since the compiler keeps what it made of the mathematics only for the same options
        whole = f'#define MODEL "{build.name}.c"\n#include "{WASM_LAYER.name}"\n'
        (folder / "module.c").write_text(whole, encoding="utf-8")
        options = [*WASM_FLAGS, *headers, "module.c", *mathematics]
        module = f"{build.name}.wasm"
        return with_hash_section(
            run_compiler("wasm32-wasi", WASM_MATH.name, module, folder, options)
        )


def run_compiler(target: str, source: str, output: str, folder: Path, options: list[str]) -> bytes:
    """What the compiler makes of a source in a folder; raises RuntimeError with its words."""
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *OPTIONS, *options]
    command += ["-o", output, source]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if process.returncode:
        raise RuntimeError(f"{Path(output).stem} does not compile for {target}:\n{process.stderr}")
    return (folder / output).read_bytes()


def universal(slices: list[bytes]) -> bytes:
    """One library for several processors of a Mac: a table of offsets before the libraries."""
    align = 14
    offset, table, body = 1 << align, struct.pack(">2I", 0xCAFEBABE, len(slices)), b""
    for code in slices:
        cpu, subtype = struct.unpack_from("<2I", code, 4)
        table += struct.pack(">5I", cpu, subtype, offset + len(body), len(code), align)
        body += code + bytes(-len(code) % (1 << align))
    return table.ljust(offset, b"\0") + body
