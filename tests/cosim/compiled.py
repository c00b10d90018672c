"""The binaries of FMUs that are written in C for a test."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZipFile

import fmpy

HEADERS = Path(fmpy.__file__).with_name("c-code")
CALL = re.compile(r"#define (fmi3\w+) +fmi3FullName")


@cache
def binary(source: Path, *flags: str) -> bytes:
    """The shared library of a C file for this platform, compiled once per process.

    One by FMI 3.0, which must have all functions, gets those that it does not write: they return an error.
    """
    call_names = CALL.findall((HEADERS / "fmi3Functions.h").read_text())
    with TemporaryDirectory(prefix="compiled_") as folder:
        library, rest = (Path(folder, name) for name in ("library", "rest.c"))
        stubs = (f"__attribute__((weak)) int {name}(void) {{ return 3; }}\n" for name in call_names)
        rest.write_text("".join(stubs))
        command = [
            sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-O2", "-std=c11", "-Wall",
            "-Wextra", "-Werror", *flags, f"-I{HEADERS}", str(source), str(rest), "-lm", "-o", str(library),
        ]  # fmt: skip
        subprocess.run(command, check=True)
        return library.read_bytes()


def packed(path: Path, name: str, description: str, source: Path, *flags: str) -> Path:
    """Write an FMU of this model identifier, description and C file."""
    platform = fmpy.platform_tuple if 'fmiVersion="3.0"' in description else fmpy.platform
    with ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        library = f"binaries/{platform}/{name}{fmpy.sharedLibraryExtension}"
        archive.writestr(library, binary(source, *flags))
    return path
