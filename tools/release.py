"""Make what is released, in dist/: the wheel and the source package, all FMUs as fmus.zip, the reference systems and what
the page of FMI tools asks for as archives, and checksums.

The wheel holds the FMUs in both flavours and the loop of the master, compiled for every platform: nothing needs a compiler
where it is installed.
"""

import argparse
import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from shutil import make_archive, rmtree

from tools.compatibility import write_compatibility

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
#: The first date that a zip archive can state: the same FMUs give the same archive.
EPOCH = (1980, 1, 1, 0, 0, 0)
#: What is made first, each by a command of its own.
COMMANDS = (
    ("build_fmus.py", "--flavour", "all", "--platforms", "all"),
    ("-m", "uv", "build", "--quiet", "--out-dir", str(DIST)),
    ("-m", "reference_systems.make", str(DIST / "reference_systems"), "--platforms", "all"),
)


def main() -> int:
    """Make the files and print their names; 1 where one of them cannot be made."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    environment = os.environ | {"DRIVE_FMUS_PLATFORMS": "all"}
    try:
        for command in COMMANDS:
            subprocess.run([sys.executable, *command], cwd=ROOT, env=environment, check=True)
        write_fmus(DIST / "fmus.zip")
        native = [p for f in ("native", "fmi3") for p in sorted((ROOT / "fmus" / f).glob("*.fmu"))]
        write_compatibility(native, DIST / "compatibility")
    except (subprocess.CalledProcessError, ValueError) as error:
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
    fmus = ROOT / "fmus"
    files = {"LICENSE": ROOT / "LICENSE"}
    for pattern in ("*.fmu", "native/*.fmu", "wasm/*.wasm"):
        files |= {path.relative_to(fmus).as_posix(): path for path in fmus.glob(pattern)}
    with zipfile.ZipFile(target, "w") as archive:
        for name, path in sorted(files.items()):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())


if __name__ == "__main__":
    sys.exit(main())
