"""Pack a model with pythonfmu's wrapper: same source, same bytes.

The FMU runs one module, named by its content, so that two FMUs, or two versions of one, never meet in
`sys.modules`. It contains the slave, the functions printed for the model, and its table of variables.
Only for a model that cannot be traced does the FMU also contain its source and the kit that it needs.
"""

import importlib.metadata
import re
from pathlib import Path
from types import ModuleType
from typing import NamedTuple
from xml.etree import ElementTree

import pythonfmu

from ...codegen import entries
from ...declare.interface import Interface, class_name, component_name, title
from ...trace.modules import source_files
from .. import page, plot, reference, terminals
from ..archive import KIT_FOLDER, LICENSE, digest_of, guid_of, write_archive
from ..description.fmi2 import PYTHON, to_xml
from . import instance
from . import pythonfmu as wrapper

BINARIES = Path(pythonfmu.__file__).parent / "resources" / "binaries"
NEEDED = ("__init__.py", "si.py", "declare/*.py", "runtime/*.py")
UNTRACED = """\
from {kit} import model
from {kit}.fmukit.declare.interface import Interface
from {kit}.fmukit.runtime import equations
"""


class PythonBuild(NamedTuple):
    """A model to pack, and the hash of all its FMU is made from."""

    model: ModuleType
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
    def module(self) -> str:
        """The module's name, other than that of any other build that one process may import."""
        return f"{component_name(self.model)}_{self.digest[:12]}"

    @property
    def resources(self) -> dict[str, bytes]:
        """What is imported, by its path in the folder `resources` of the FMU."""
        files: dict[str, bytes] = {}
        if self.model.PYTHON_ONLY:
            kit, functions = f"{self.module}_kit", "equations.functions(Interface(model))"
            printed = UNTRACED.format(kit=kit)
            files = {f"{kit}/__init__.py": b""}
            first, *further = source_files(Path(self.model.__file__ or ""))
            for name, file in (("model", first), *((file.stem, file) for file in further)):
                source = file.read_text(encoding="utf-8")
                private = re.sub(r"^from fmukit\b", "from .fmukit", source, flags=re.MULTILINE)
                files[f"{kit}/{name}.py"] = private.encode()
            for file in sorted(file for pattern in NEEDED for file in KIT_FOLDER.glob(pattern)):
                files[f"{kit}/fmukit/{file.relative_to(KIT_FOLDER).as_posix()}"] = file.read_bytes()
        else:
            printed, functions = entries.generate(self.model).python, "sys.modules[__name__]"
        table = {"guid": self.guid} | reference.slave_table(Interface(self.model))
        rows = "".join(f"        {v!r},\n" for v in table.pop("variables"))
        text = (
            f"{title(self.model) + ': slave, functions, and table of variables.'!r}\n\n"
            f"from __future__ import annotations\n\n{without_own_imports(wrapper)}{without_own_imports(instance)}{printed}"
            f"\n\nslave_class = type({self.name!r}, (Slave,), dict(\n    variables=(\n{rows}    ),\n"
            + "".join(f"    {name}={value!r},\n" for name, value in table.items())
            + f"    functions={functions},\n))\n"
        )
        stub = wrapper.STUB.format(module=self.module)
        return files | {
            f"{self.module}.py": text.encode(),
            f"{self.module}_fmu.py": stub.encode(),
            "slavemodule.txt": f"{self.module}_fmu".encode(),
        }


def without_own_imports(module: ModuleType) -> str:
    """The source of a module without what it imports of its neighbours."""
    text = Path(module.__file__ or "").read_text(encoding="utf-8")
    return re.sub(r"^from (__future__|\.).*\n", "", text, flags=re.MULTILINE)


def hashed_build(model: ModuleType) -> PythonBuild:
    """The build of the Python FMU of a model, with the hash of all that it is made from."""
    flavour = f"python, pythonfmu {importlib.metadata.version('pythonfmu')}"
    return PythonBuild(model, digest_of(Interface(model), flavour, sorted(BINARIES.rglob("*.*"))))


def write_fmu(build: PythonBuild, fmu: Path) -> None:
    """Write the FMU."""
    interface, files = Interface(build.model), build.resources
    rows = reference.default_experiment(build.model)
    root = to_xml(interface, build.guid, PYTHON)
    ElementTree.indent(root)
    documents = {
        "index.html": page.html(interface, plot.svg(interface, rows)),
        "externalDependencies.txt": page.EXTERNAL_DEPENDENCIES,
        "licenses/license.txt": licence(),
    }
    binaries = {
        f"{file.parent.name}/{build.name}{file.suffix}": file.read_bytes()
        for file in BINARIES.rglob("*.*")
    }
    contents = {
        "modelDescription.xml": ElementTree.tostring(root, "UTF-8", xml_declaration=True),
        **{f"documentation/{name}": text.encode() for name, text in documents.items()},
        **{f"resources/{name}": content for name, content in files.items()},
        **{f"binaries/{name}": content for name, content in binaries.items()},
        **reference.files_of_reference(interface),
        **terminals.files_of_terminals(interface),
    }
    write_archive(contents, fmu)


def licence() -> str:
    """The licence of the project and that of pythonfmu."""
    metadata = importlib.metadata.distribution("pythonfmu")
    theirs = next(f for f in metadata.files or () if f.name == "LICENSE")
    return f"{LICENSE.read_text()}\nThe FMI wrapper is PythonFMU's:\n\n{theirs.read_text()}"
