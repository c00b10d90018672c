"""Pack a component with pythonfmu: same source, same bytes.

The component and `kit` travel as a private package named by its content, so that two FMUs, two
versions of one, or the host's own modules of the same name never meet in `sys.modules`.
"""

import hashlib
import importlib
import importlib.metadata
import os
import sys
import tempfile
import zipfile
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pythonfmu
from fmpy.model_description import read_model_description
from pythonfmu import FmuBuilder

from .. import PYTHON_ONLY
from ..kit.interface import Interface, class_name
from ..kit.slave import slave_class
from ..native import generate, python
from . import page, plot, reference
from .archive import guid_of, write_archive

ROOT = Path(__file__).resolve().parents[2]
WRAPPERS = Path(pythonfmu.__file__).parent / "resources" / "binaries"


class Build(NamedTuple):
    """A component ready to pack: its files by path in the private package, and their hash."""

    model: ModuleType
    files: dict[str, bytes]
    digest: str

    @property
    def name(self) -> str:
        return class_name(self.model)

    @property
    def guid(self) -> str:
        return guid_of(self.digest)

    @property
    def component(self) -> str:
        return self.model.__name__.rpartition(".")[2]

    @property
    def package(self) -> str:
        return f"{self.component}_{self.digest[:12]}"


def collect(component: str) -> Build:
    """Read a component of the catalogue and everything that its FMU is made from."""
    model = importlib.import_module(f"components.{component}")
    folder = ROOT / "components"
    files = {"__init__.py": b"", f"{component}.py": (folder / f"{component}.py").read_bytes()}
    for source in sorted((folder / "kit").glob("*.py")):
        files[f"kit/{source.name}"] = source.read_bytes()
    if component not in PYTHON_ONLY:
        functions = generate.traced(Interface(model))
        files["straight.py"] = python.module(functions, ("model_step", "model_outputs")).encode()
    digest = hashlib.sha256(importlib.metadata.version("pythonfmu").encode())
    makers = [*sorted(Path(__file__).parent.glob("*.py")), ROOT / "LICENSE"]
    for maker in (*makers, *sorted(WRAPPERS.rglob("*.*"))):
        digest.update(hashlib.sha256(maker.read_bytes()).digest())
    for name, content in files.items():
        digest.update(name.encode() + b"\0" + hashlib.sha256(content).digest())
    digest.update(page.html(Interface(model)).encode())
    digest.update(os.environ.get("SOURCE_DATE_EPOCH", "").encode())
    return Build(model, files, digest.hexdigest())


def is_current(guid: str, fmu: Path) -> bool:
    """Whether this file is already the build of this guid."""
    if not zipfile.is_zipfile(fmu):
        return False
    with zipfile.ZipFile(fmu) as archive:
        if "modelDescription.xml" not in archive.namelist():
            return False
    return bool(read_model_description(str(fmu), validate=False).guid == guid)


def pack(build: Build, fmu: Path) -> None:
    """Write the FMU."""
    with tempfile.TemporaryDirectory(prefix="fmu_") as temporary:
        folder = Path(temporary)
        stub = _write_sources(build, folder)
        interface = Interface(build.model)
        rows = reference.experiment(slave_class(build.model, build.guid))
        _write_documentation(
            folder / "documentation", page.html(interface, plot.svg(interface, rows))
        )
        raw = folder / "raw.fmu"
        sys.dont_write_bytecode = True
        FmuBuilder.build_FMU(
            stub,
            dest=raw,
            project_files=[folder / build.package],
            documentation_folder=folder / "documentation",
        )
        _repack(raw, fmu, reference.entries(interface, rows))


def _write_sources(build: Build, folder: Path) -> Path:
    component = build.component
    straight = "straight" if "straight.py" in build.files else "None"
    entry = (
        f"from . import {component}{', straight' if straight != 'None' else ''}\n"
        f"from .kit.slave import slave_class\n\n"
        f'{build.name} = slave_class({component}, "{build.guid}", {straight})\n'
    )
    for name, content in {**build.files, "fmu.py": entry.encode()}.items():
        target = folder / build.package / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    stub = folder / f"{build.package}_fmu.py"
    stub.write_text(
        "# pythonfmu 0.7.0 runs this file once per instance and then releases a reference\n"
        "# to its namespace that it does not own: give one back each time.\n"
        "import ctypes\n\n"
        f"from {build.package}.fmu import {build.name}\n\n"
        "ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))\n"
    )
    return stub


def _write_documentation(folder: Path, index: str) -> None:
    (folder / "licenses").mkdir(parents=True)
    (folder / "index.html").write_text(index, encoding="utf-8")
    (folder / "externalDependencies.txt").write_text(page.EXTERNAL_DEPENDENCIES, encoding="utf-8")
    metadata = importlib.metadata.distribution("pythonfmu")
    licence = next(f for f in metadata.files or () if f.name == "LICENSE")
    (folder / "licenses" / "license.txt").write_text(
        f"{(ROOT / 'LICENSE').read_text()}\n"
        f"The FMI wrapper and resources/pythonfmu are PythonFMU's:\n\n{licence.read_text()}",
        encoding="utf-8",
    )


def _repack(raw: Path, clean: Path, more: dict[str, bytes]) -> None:
    with zipfile.ZipFile(raw) as source:
        contents = {name: source.read(name) for name in source.namelist()} | more
    write_archive(contents, clean)
