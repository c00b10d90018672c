"""Compile the loop of steps for a platform; the standard library and ziglang only."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("loop.c")
TARGETS = {
    ("linux", "x86_64"): "x86_64-linux-gnu.2.17",
    ("linux", "aarch64"): "aarch64-linux-gnu.2.17",
    ("win32", "AMD64"): "x86_64-windows-gnu",
    ("darwin", "x86_64"): "x86_64-macos",
    ("darwin", "arm64"): "aarch64-macos",
}
OPTIONS = ("-O2", "-ffp-contract=off", "-fPIC", "-s")
#: link against what the system has: a C library that the compiler builds first takes a minute
LINK_OPTIONS = ("-shared", "-rtlib=none")
WINDOWS_LINK_OPTIONS = (
    "-shared",
    "-nostdlib",
    "-Wl,--no-entry",
    "-lapi-ms-win-crt-private-l1-1-0",
    "-lapi-ms-win-crt-string-l1-1-0",
)


def file_name(system: str, machine: str) -> str:
    """The name of the compiled loop for `sys.platform` and `platform.machine()`."""
    return f"loop-{system}-{machine}.so"


def loop_of_sources() -> Path:
    """Where the loop of these sources is kept for this machine, once it is compiled."""
    text = f"{SOURCE.read_text()}{OPTIONS}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    name = file_name(sys.platform, platform.machine())
    return SOURCE.parent / "__pycache__" / f"{digest}-{name}"


def compile_loop(path: Path, target: str = "native") -> None:
    """Compile the loop for a target of Zig; raises OSError with the words of the compiler."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        library = Path(folder) / path.name
        compiler = [sys.executable, "-m", "ziglang", "cc", "-target", target, *OPTIONS]
        windows = "windows" in target or (target == "native" and sys.platform == "win32")
        compiled = Path(folder) / "loop.obj"
        for options in (
            ["-c", "-o", str(compiled), str(SOURCE)],
            [
                *(WINDOWS_LINK_OPTIONS if windows else LINK_OPTIONS),
                *("-o", str(library), str(compiled)),
            ],
        ):
            done = subprocess.run(
                [*compiler, *options], capture_output=True, text=True, check=False
            )
            if done.returncode:
                raise OSError((done.stderr.strip() or "the compiler failed").splitlines()[-1])
        library.replace(path)


def compile_every_loop(folder: Path) -> None:
    """Compile the loop for every platform into a folder; raises OSError as `compile_loop` does."""
    for names, target in TARGETS.items():
        compile_loop(folder / file_name(*names), target)
