"""Pack a model with pythonfmu's wrapper: same source, same bytes.

The model and the part of fmukit that it runs on travel as a private package named by its content,
so that two FMUs, two versions of one, or the host's own modules of the same name never meet in
`sys.modules`.
"""

import importlib.metadata
import re
from pathlib import Path
from types import ModuleType
from typing import NamedTuple
from xml.etree import ElementTree

import pythonfmu

from ...declare.variables import Interface, class_name, component
from ...write import entries
from .. import page, plot, reference, terminals
from ..archive import KIT, LICENSE, digest_of, guid_of, write_archive
from ..xml import PYTHON, to_xml
from .instance import slave_class

WRAPPER = Path(pythonfmu.__file__).parent
BINARIES = WRAPPER / "resources" / "binaries"
RUNTIME = (
    "__init__.py",
    "si.py",
    "declare/*.py",
    "step/*.py",
    "fmu/__init__.py",
    "fmu/python/__init__.py",
    "fmu/python/instance.py",
)
STUB = """\
# pythonfmu 0.7.0 runs this file once per instance and then releases a reference
# to its namespace that it does not own: give one back each time.
import ctypes

from {package}.fmu import {name}

ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))
"""


class Build(NamedTuple):
    """A model to pack, and the hash of all its FMU is made from."""

    model: ModuleType
    digest: str

    @property
    def name(self) -> str:
        return class_name(self.model)

    @property
    def guid(self) -> str:
        return guid_of(self.digest)

    @property
    def package(self) -> str:
        return f"{component(self.model)}_{self.digest[:12]}"

    @property
    def files(self) -> dict[str, bytes]:
        """The files of the model by their path in the private package."""
        source = Path(self.model.__file__ or "").read_text(encoding="utf-8")
        private = re.sub(r"^from fmukit\b", "from .fmukit", source, flags=re.MULTILINE)
        found = {"__init__.py": b"", f"{component(self.model)}.py": private.encode()}
        for file in sorted(file for pattern in RUNTIME for file in KIT.glob(pattern)):
            found[f"fmukit/{file.relative_to(KIT).as_posix()}"] = file.read_bytes()
        if not hasattr(self.model, "PYTHON_ONLY"):
            found["straight.py"] = entries.written(self.model).python.encode()
        return found


def collect(model: ModuleType) -> Build:
    """Hash everything that the Python FMU of a model is made from."""
    flavour = f"python, pythonfmu {importlib.metadata.version('pythonfmu')}"
    return Build(model, digest_of(Interface(model), flavour, sorted(BINARIES.rglob("*.*"))))


def pack(build: Build, fmu: Path) -> None:
    """Write the FMU."""
    interface, stub, files = Interface(build.model), f"{build.package}_fmu", build.files
    rows = reference.experiment(slave_class(build.model, build.guid))
    root = to_xml(interface, build.guid, PYTHON)
    ElementTree.indent(root)
    documents = {
        "index.html": page.html(interface, plot.svg(interface, rows)),
        "externalDependencies.txt": page.EXTERNAL_DEPENDENCIES,
        "licenses/license.txt": licence(),
    }
    straight = "straight" if "straight.py" in files else "None"
    model = component(build.model)
    entry = (
        f"from . import {model}{', straight' if straight != 'None' else ''}\n"
        f"from .fmukit.fmu.python.instance import slave_class\n\n"
        f'{build.name} = slave_class({model}, "{build.guid}", {straight})\n'
    )
    sources = {f"{build.package}/{name}": content for name, content in files.items()} | {
        f"{build.package}/fmu.py": entry.encode(),
        f"{stub}.py": STUB.format(package=build.package, name=build.name).encode(),
        "slavemodule.txt": stub.encode(),
        **{f"pythonfmu/{file.name}": file.read_bytes() for file in WRAPPER.glob("*.py")},
    }
    binaries = {
        f"{file.parent.name}/{build.name}{file.suffix}": file.read_bytes()
        for file in BINARIES.rglob("*.*")
    }
    contents = {
        "modelDescription.xml": ElementTree.tostring(root, "UTF-8", xml_declaration=True),
        **{f"documentation/{name}": text.encode() for name, text in documents.items()},
        **{f"resources/{name}": content for name, content in sources.items()},
        **{f"binaries/{name}": content for name, content in binaries.items()},
        **reference.entries(interface, rows),
        **terminals.entries(interface),
    }
    write_archive(contents, fmu)


def licence() -> str:
    """The licence of the project and that of pythonfmu."""
    metadata = importlib.metadata.distribution("pythonfmu")
    theirs = next(f for f in metadata.files or () if f.name == "LICENSE")
    return (
        f"{LICENSE.read_text()}\n"
        f"The FMI wrapper and resources/pythonfmu are PythonFMU's:\n\n{theirs.read_text()}"
    )
