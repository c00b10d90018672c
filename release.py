"""Make what is released, in dist/: all FMUs, the wheels, and their checksums.

usage: python release.py

The wheels hold the FMUs in both flavours, and the loop of the master compiled for each platform, so
that nothing needs a compiler where they are installed.
"""

import hashlib
import subprocess
import sys
from pathlib import Path
from shutil import rmtree

from build_fmus import MACHINES
from cosim.engine.program import TARGETS, compile_loop, file_name
from fmukit.fmu.make import make_all

ROOT = Path(__file__).resolve().parent
DIST = ROOT / "dist"


def main() -> int:
    rmtree(DIST, ignore_errors=True)
    if make_all(MACHINES.values(), "both", DIST / "fmus"):
        return 1
    for platform, target in TARGETS.items():
        compile_loop(DIST / "loop" / file_name(*platform), target)
    for wheel in sorted((ROOT / "wheels").iterdir()):
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(DIST)]
        subprocess.run(command, cwd=wheel, check=True)
    files = sorted(path for path in DIST.rglob("*") if path.suffix in (".fmu", ".wasm", ".whl"))
    sums = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(DIST).as_posix()}\n"
        for path in files
    ]
    (DIST / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    print(f"{len(files)} files and SHA256SUMS in {DIST}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
