"""The built FMUs: where they are, and whether they are made from the sources as these are now.

In a clone, build_fmus.py writes beside the FMUs which state of the sources each was made from. Checking it
reads the sources, about 100 files, and starts no process. An installed package contains no sources of FMUs
that could change.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

from cosim.names import only

PACKAGE = Path(__file__).resolve().parent
CLONE = PACKAGE.parent
IS_CLONE = (CLONE / "build_fmus.py").is_file()
FMUS = (CLONE if IS_CLONE else PACKAGE) / "fmus"
FOLDERS = {"python": FMUS, "native": FMUS / "native", "wasm": FMUS / "wasm"}
#: the folder beside the FMUs that keeps the hash of the sources of each, one small file per FMU
RECORDS = ".sources"
ENDINGS = {".py", ".c", ".zig"}


def plain(name: str) -> str:
    """A machine's name in one spelling for its folder and its FMU: drivemotor."""
    return name.replace("_", "").lower()


@cache
def kit_digest() -> bytes:
    """The hash of all that every FMU is made from: the kit, the licence and the project's data."""
    files = [path for path in (CLONE / "fmukit").rglob("*") if path.suffix in ENDINGS]
    return _digest([*files, CLONE / "LICENSE", CLONE / "pyproject.toml"])


def machine_folders() -> dict[str, Path]:
    """The folders of the machines in `components`, by their plain names."""
    return {plain(path.parent.name): path.parent for path in CLONE.glob("components/*/model.py")}


def source_digest(name: str) -> str:
    """The hash of all that the FMU of a machine, "DriveMotor" or "drive_motor", is made from.

    Raises FileNotFoundError for a machine that is not in `components`.
    """
    if plain(name) not in machine_folders():
        raise FileNotFoundError(f"there is no folder of {name} in components")
    machine = _digest(path for path in machine_folders()[plain(name)].iterdir() if path.is_file())
    return hashlib.sha256(kit_digest() + machine).hexdigest()


def record(file: Path, folder: Path) -> None:
    """Write for an FMU or module in a folder of FMUs that it is made from the sources as these are now."""
    digest, target = source_digest(file.stem), record_of(file, folder)
    if target.is_file() and target.read_text(encoding="utf-8") == digest:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(digest, encoding="utf-8")  # one that is cut off says the same as none


def record_of(fmu: Path, folder: Path) -> Path:
    """The file that keeps the hash of the sources of an FMU in a folder of FMUs."""
    return folder / RECORDS / f"{fmu.relative_to(folder).as_posix().replace('/', '-')}.txt"


def problem(name: str, flavour: str, folders: Mapping[str, Path] = FOLDERS) -> str:
    """Why the FMU of a machine in a flavour cannot be used, with the command that builds it; "" if it can.

    Parameters
    ----------
    name
        The machine as its FMU is called, "DriveMotor".
    flavour
        "python", "native" or "wasm".
    folders
        The folder of each flavour.
    """
    path = folders[flavour] / f"{name}{'.wasm' if flavour == 'wasm' else '.fmu'}"
    existing = sorted(other.stem for other in path.parent.glob(f"*{path.suffix}"))
    is_misspelt = name not in existing and plain(name) in map(plain, existing)
    if IS_CLONE and (is_misspelt or plain(name) not in machine_folders()):
        return f"there is no machine {name!r}, {only(name, existing)}"
    build = f".venv/bin/python build_fmus.py --flavour {flavour}"
    if not path.is_file():
        return f"there is no {path.name} in {path.parent}" + (
            f": build it with `{build}`" if IS_CLONE else ""
        )
    if not IS_CLONE:
        return ""
    digest = record_of(path, FMUS)
    if digest.is_file() and digest.read_text(encoding="utf-8") == source_digest(name):
        return ""
    return f"{path} is not made from the present sources: build it again with `{build}`"


def _digest(paths: Iterable[Path]) -> bytes:
    """The hash of files: their names and what they contain."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()
