"""Make what is released, in dist/: the wheel and the source package, all FMUs as fmus.zip, and checksums; the reference
systems, and what the page of FMI tools asks for, as archives.

usage: python release.py

The wheel holds the FMUs in both flavours and the loop of the master, compiled for every platform, so that
nothing needs a compiler where it is installed.
"""

import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from shutil import make_archive, rmtree

from compatibility import write_compatibility

ROOT = Path(__file__).resolve().parent
DIST = ROOT / "dist"
#: the first date that a zip archive can state: the same FMUs give the same archive
EPOCH = (1980, 1, 1, 0, 0, 0)


def main() -> int:
    """Make the files and print how many there are; 1 where the FMUs or the packages cannot be built."""
    rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    for command in (
        [sys.executable, "build_fmus.py", "--flavour", "all", "--platforms", "all"],
        [sys.executable, "-m", "uv", "build", "--quiet", "--out-dir", str(DIST)],
        [
            sys.executable,
            "-m",
            "reference_systems.make",
            str(DIST / "reference_systems"),
            "--platforms",
            "all",
        ],
    ):
        environment = os.environ | {"DRIVE_FMUS_PLATFORMS": "all"}
        if subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode:
            print(f"error: {' '.join(command[1:])} failed; nothing is released", file=sys.stderr)
            return 1
    write_fmus(DIST / "fmus.zip")
    native = [
        path
        for folder in ("native", "fmi3")
        for path in sorted((ROOT / "fmus" / folder).glob("*.fmu"))
    ]
    try:
        write_compatibility(native, DIST / "compatibility")
    except ValueError as error:
        print(f"error: {error}; nothing is released", file=sys.stderr)
        return 1
    for name in ("reference_systems", "compatibility"):
        make_archive(str(DIST / name), "zip", DIST / name)
    files = sorted(path for path in DIST.iterdir() if path.suffix in (".gz", ".whl", ".zip"))
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (DIST / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    print(f"{', '.join(path.name for path in files)} and SHA256SUMS in {DIST}")
    return 0


def write_fmus(target: Path) -> None:
    """Write all FMUs and modules, by flavour, and the licence into one archive."""
    files = {
        path.relative_to(ROOT / "fmus").as_posix(): path
        for pattern in ("*.fmu", "native/*.fmu", "wasm/*.wasm")
        for path in (ROOT / "fmus").glob(pattern)
    }
    with zipfile.ZipFile(target, "w") as archive:
        for name, path in sorted({**files, "LICENSE": ROOT / "LICENSE"}.items()):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())


if __name__ == "__main__":
    sys.exit(main())
