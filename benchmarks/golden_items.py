"""The items of the golden dump: what the project does today, one entry for each question, command and name.

An item is a name within its kind. `KINDS` gives for each kind the function that lists its items and the one
that makes an entry, plain data for JSON. Both use only what users have: command lines, the public names of
the packages, and the built files. Thus they outlive what lies behind these.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile

from benchmarks.golden_commands import ROOT, Entry, execute, mask
from benchmarks.golden_live import live_entry, live_items
from benchmarks.golden_systems import METHODS, SYSTEMS

FMUS = ROOT / "fmus"
#: flavours of FMUs, by the folder of `fmus` in which a build puts them
FOLDERS = {"python": "", "native": "native", "fmi3": "fmi3"}
#: questions with two parameter sets, which are asked for both
TWO_SETS = (
    "resonance",
    "resonance_map",
    "mean_values",
    "classical",
    "rod_force",
    "run_up",
    "packing_line",
    "identify",
)
#: answers with another part, by the names of their items
COMPARED = {
    "classical": ["resonance", "--theory", "classical"],
    "iron_kinematics": ["iron_cycle", "--compare", "dimensions"],
    "orientator_limit": ["orientation_time", "--compare", "formula"],
    "orientator_neglect": ["orientation_time", "--compare", "neglected"],
}
STAGES = ("falling", "joint", "turning", "released")
#: options of questions about a record, which need one; the other questions are asked with their defaults
RECORDS = {
    "identify": [
        "--data", "examples/conveyor_record.csv", "--map", "time=t", "--map", "conveyor.w=n",
        "--map", "motor.tau=M*0.8:N.m", "--known", "conveyor.trough.m=200+-5",
        "--known", "conveyor.spring.c=720e3+-2%", "--rated-torque", "80", "--starts", "2",
    ],
    "iron_identify": [
        "--data", "examples/iron_record.csv", "--map", "time=t", "--map", "iron.w=n",
        "--map", "motor.tau=M*0.02:N.m", "--known", "iron.iron.m=4.4+-1%", "--until", "1.65",
        "--starts", "2",
    ],
    "orientator_identify": [
        "--data", "examples/orientator_record.csv", "--map", "orientator.w=n",
        *(word for x in STAGES for word in ("--map", f"orientator.t_{x}={x}")),
        *(word for x in STAGES for word in ("--noise", f"orientator.t_{x}=0.5ms")),
        "--starts", "2",
    ],
}  # fmt: skip
GUID = rb"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}"
#: a container says when it was made
DATE = rb'generationDateAndTime="[^"]*"'
#: a module of a Python FMU carries a hash of its content in its name
MODULE = rb"(?<=_)[0-9a-f]{12}(?=\b|_fmu)"
PACKAGES = ("cosim", "fmukit", "scenarios", "workbench")


class Kind(NamedTuple):
    """Items of one kind: how they are listed, and how the entry of one is made in an empty folder."""

    items: Callable[[], list[str]]
    entry: Callable[[str, Path], Entry]


def digest(content: bytes) -> str:
    """The SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def table(path: Path) -> Entry:
    """The columns, the number of rows and the hash of a CSV file."""
    lines = path.read_bytes().splitlines()
    header = lines[0].decode() if lines else ""
    return {"columns": header, "rows": len(lines) - 1, "sha256": digest(path.read_bytes())}


def key_types(content: Any) -> Any:
    """The keys of JSON data, with types instead of values; a list has the trees of its elements."""
    if isinstance(content, dict):
        return {key: key_types(value) for key, value in content.items()}
    if isinstance(content, list):
        trees = {json.dumps(key_types(value), sort_keys=True) for value in content}
        return [json.loads(text) for text in sorted(trees)]
    return "null" if content is None else type(content).__name__


def files(folder: Path) -> Entry:
    """The tables and the trees of JSON files that programs wrote to a folder."""
    return {
        "tables": {path.name: table(path) for path in sorted(folder.glob("*.csv"))},
        "keys": {
            path.name: key_types(json.loads(path.read_text(encoding="utf-8")))
            for path in sorted(folder.glob("*.json"))
        },
    }


@cache
def questions() -> list[str]:
    """The names of the questions, as the command line lists them."""
    process = subprocess.run(
        [sys.executable, "-m", "scenarios", "list"], cwd=ROOT, check=True, capture_output=True, text=True
    )  # fmt: skip
    return [*(line.split()[0] for line in process.stdout.splitlines() if line.strip()), *COMPARED]


def question_items() -> list[str]:
    """Each question, for both of its parameter sets where it has two."""
    names = []
    for name in questions():
        names += [f"{name} --set {x}" for x in "AB"] if name in TWO_SETS else [name]
    return names


def question_entry(item: str, folder: Path) -> Entry:
    """What a question answers on native FMUs: figures, verdict, hashes of rows, keys of its JSON."""
    name, *options = item.split()
    name, *compared = COMPARED.get(name, [name])
    options += compared
    options += RECORDS.get(name, [])
    arguments = ["-m", "scenarios", "run", name, *options, "--flavour", "native", "--jobs", "1"]
    out = folder / "out"
    entry = {"options": " ".join(options)} | execute([*arguments, "--out", str(out)], folder)
    answer = out / f"{name}.json"
    if answer.is_file():
        content = json.loads(answer.read_text(encoding="utf-8"))
        entry |= {key: content.get(key) for key in ("verdict", "warnings", "figures")}
    names = sorted(path.name for path in out.iterdir()) if out.is_dir() else []
    return entry | files(out) | {"files": names}


def native() -> list[str]:
    """The names of the native FMUs."""
    return sorted(path.stem for path in (FMUS / "native").glob("*.fmu"))


def command_table() -> dict[str, list[str]]:
    """The command lines of `cosim` for each item; FOLDER is an empty folder, DRIVE a drive as an SSP."""
    span = "--stop 0.2 --step 1e-3"
    items = {
        "verify": ["verify"],
        "run without a stop time": ["run fmus/native/DriveMotor.fmu"],
        "run a file that is not there": ["run missing.ssp --stop 1"],
        "info drive": ["info DRIVE"],
        "check drive, jacobi": [f"check DRIVE {span} --algorithm jacobi"],
        "run drive, certified": [f"run DRIVE {span} --out FOLDER/rows.csv --certify"],
        "run drive, adaptive": ["run DRIVE --stop 0.2 --adaptive 1e-4 --out FOLDER/rows.csv"],
        "run drive, wrong start value": [f"run DRIVE {span} --set motor.T=-1"],
        "oracle drive": [f"oracle DRIVE {span} --out FOLDER/rows.csv"],
        "compare drive": [
            f"run DRIVE {span} --out FOLDER/coarse.csv",
            "run DRIVE --stop 0.2 --step 5e-4 --out FOLDER/fine.csv",
            "compare FOLDER/coarse.csv FOLDER/fine.csv",
            "compare FOLDER/coarse.csv FOLDER/fine.csv --value 1e-9 --time 1e-9",
        ],
        "export drive": [
            f"export DRIVE --step 1e-3 --to {kind} --out FOLDER/export{suffix}"
            for kind, suffix in (("ssp", ".ssp"), ("osp", "_osp"), ("container", ".fmu"))
        ],
    }
    for algorithm in ("jacobi", "gauss-seidel", "strang", "iterated"):
        run = f"DRIVE {span} --algorithm {algorithm} --out FOLDER/rows.csv"
        items[f"run drive, {algorithm}"] = [f"run {run}"]
        items[f"diagnose drive, {algorithm}"] = [
            f"diagnose DRIVE --step 1e-3 --algorithm {algorithm}"
        ]
    for name in native():
        fmu = f"fmus/native/{name}.fmu"
        items[f"info {name}"] = [f"info {fmu}"]
        items[f"check {name}"] = [f"check {fmu} {span}"]
        items[f"run {name}"] = [f"run {fmu} {span} --out FOLDER/rows.csv"]
        items[f"diagnose {name}"] = [f"diagnose {fmu} --step 1e-3"]
        items[f"oracle {name}"] = [f"oracle {fmu} {span} --out FOLDER/rows.csv"]
        items[f"crosscheck {name}"] = [f"crosscheck {fmu}"]
        items[f"compare {name}"] = [
            f"run {fmu} {span} --part {name} --out FOLDER/rows.csv",
            f"compare FOLDER/rows.csv FOLDER/{name}_ref.csv",
        ]
    return items


def command_entry(item: str, folder: Path) -> Entry:
    """What commands of `cosim` say and write."""
    lines = command_table()[item]
    drive = folder / "drive.ssp"
    if any("DRIVE" in line for line in lines):
        from cosim import write_ssp

        write_ssp(SYSTEMS["conveyor, stiff drive"].system(FMUS / "native"), drive, 0.2)
    if any("_ref.csv" in line for line in lines):
        name = item.split()[1]
        (folder / f"{name}_ref.csv").write_bytes(reference(FMUS / "native" / f"{name}.fmu")[1])
    entry: Entry = {"commands": {}}
    for line in lines:
        arguments = line.replace("DRIVE", str(drive)).replace("FOLDER", str(folder)).split()
        entry["commands"][line] = execute(["-m", "cosim", *arguments], folder)
    exported = {}
    for path in sorted(folder.glob("export.*")):
        with ZipFile(path) as archive:
            exported[path.name] = contents(archive)
    return entry | files(folder) | ({"members": exported} if exported else {})


def help_items() -> list[str]:
    """Every command and subcommand, as it is typed after `python`."""
    items = ["build_fmus.py", "-m gallery", "-m fmukit", "-m fmukit build", "-m cosim"]
    items += ["-m scenarios", "-m scenarios run", "-m scenarios study"]
    items += [f"-m scenarios run {name}" for name in questions()]
    text = "\n".join(execute(["-m", "cosim", "--help"], ROOT)["output"])
    commands = re.findall(r"^    (\w+)(?= |$)", text, re.MULTILINE)
    return items + [f"-m cosim {name}" for name in commands if name != "COMMAND"]


def help_entry(item: str, folder: Path) -> Entry:
    """The help of a command."""
    return execute([*item.split(), "--help"], folder)


def member_items() -> list[str]:
    """The built FMUs of all flavours, and the modules for browsers."""
    items = [
        f"{flavour}/{path.name}"
        for flavour, folder in FOLDERS.items()
        for path in (FMUS / folder).glob("*.fmu")
    ]
    return items + [f"wasm/{path.name}" for path in (FMUS / "wasm").glob("*.wasm")]


def anonymous(content: bytes) -> bytes:
    """The content without GUIDs, times of generation and hashes in names of modules."""
    for pattern, replacement in ((GUID, b"GUID"), (DATE, b""), (MODULE, b"0" * 12)):
        content = re.sub(pattern, replacement, content)
    return content


def contents(archive: ZipFile) -> Entry:
    """The hash of each member of an archive, as `anonymous` leaves it; an FMU among the members has the
    hash of its own members' hashes.
    """
    hashes = {}
    for name in sorted(archive.namelist()):
        content = archive.read(name)
        if name.endswith(".fmu"):
            with ZipFile(BytesIO(content)) as inner:
                content = json.dumps(contents(inner), sort_keys=True).encode()
        hashes[anonymous(name.encode()).decode()] = digest(anonymous(content))
    return hashes


def reference(fmu: Path) -> tuple[str, bytes]:
    """The name and the content of the reference rows that an FMU carries; empty where it has none."""
    with ZipFile(fmu) as archive:
        for name in archive.namelist():
            if name.endswith("_ref.csv"):
                return name, archive.read(name)
    return "", b""


def member_entry(item: str, folder: Path) -> Entry:
    """The hashes of the members of an FMU, its GUID, and its reference rows."""
    flavour, name = item.split("/")
    if flavour == "wasm":
        return {"sha256": digest(anonymous((FMUS / item).read_bytes()))}
    path = FMUS / FOLDERS[flavour] / name
    with ZipFile(path) as archive:
        text, members = archive.read("modelDescription.xml"), contents(archive)
    guid = re.search(rb'(?:guid|instantiationToken)="([^"]*)"', text)
    member, rows = reference(path)
    lines = rows.decode().splitlines()
    return {
        "guid": guid.group(1).decode() if guid else None,
        "members": members,
        "reference": {
            "member": member,
            "columns": lines[0] if lines else "",
            "rows": max(0, len(lines) - 1),
            "last": lines[-1] if lines else "",
            "sha256": digest(rows),
        },
    }


def row_items() -> list[str]:
    """Every system, coupled by every method, from FMUs of FMI 2.0 and 3.0."""
    return [f"{x}; {method}; FMI {v}" for x in SYSTEMS for method in METHODS for v in (2, 3)]


def row_entry(item: str, folder: Path) -> Entry:
    """The rows of a coupled system: columns, hash and the last row in all digits, or the refusal."""
    from cosim import Adaptive, SetupError, SimulationError, quiet, run

    name, method, version = item.split("; ")
    coupling = SYSTEMS[name]
    flavour = {"FMI 2": coupling.flavour, "FMI 3": "fmi3"}[version]
    location = FMUS / FOLDERS[flavour]
    for fmu in sorted(set(coupling.parts.values())):
        if not (location / f"{fmu}.fmu").is_file():
            return {"refusal": f"there is no FMU {fmu} of the flavour {flavour}"}
    settings: dict[str, Any] = {"step": coupling.step} | METHODS[method]
    if "tolerance" in settings:
        settings["step"] = Adaptive(settings.pop("tolerance"))
    try:
        with quiet():
            result = run(coupling.system(location), stop=coupling.stop, **settings)
    except (SetupError, SimulationError) as error:
        return {"refusal": f"{type(error).__name__}: {mask(str(error), folder)}"}
    return {
        "columns": list(result.names),
        "rows": len(result.data),
        "last": {x: number(value) for x, value in zip(result.names, result.data[-1])},
        "sha256": digest(result.data.astype("<f8").tobytes()),
        "warnings": [mask(text, folder) for text in result.warnings],
    }


def number(value: Any) -> float | str:
    """A number for JSON, which has neither nan nor infinity: these become text."""
    return float(value) if math.isfinite(value) else str(float(value))


def name_items() -> list[str]:
    """The public names of the packages, those that are loaded on request among them."""
    items = []
    for package in PACKAGES:
        module = import_module(package)
        items += [f"{package}.{name}" for name in sorted(module.__all__)]
    return items


def annotation(note: Any) -> str:
    """An annotation as it stands in the code."""
    text = note.__name__ if isinstance(note, type) else str(note)
    return re.sub(r"ForwardRef\(('[^']*')[^)]*\)", r"\1", text)


def signature(value: Any) -> str:
    """The signature of a function, or the type of what is none."""
    try:
        return annotation(mask(str(inspect.signature(value)), ROOT))
    except (TypeError, ValueError):
        return type(value).__name__


def name_entry(item: str, folder: Path) -> Entry:
    """What a package offers by a name: signature, and for a class its fields and public methods."""
    package, name = item.rsplit(".", 1)
    offered = getattr(import_module(package), name)
    if not inspect.isclass(offered):
        value = {} if callable(offered) else {"value": mask(repr(offered), ROOT)}
        return {"kind": type(offered).__name__, "signature": signature(offered)} | value
    fields: dict[str, str] = {}
    methods: dict[str, str] = {}
    for base in reversed(offered.__mro__[:-1]):
        notes = inspect.get_annotations(base)
        fields |= {
            key: annotation(note).strip("'")
            for key, note in notes.items()
            if not key.startswith("_")
        }
        for key, member in vars(base).items():
            function = getattr(member, "__func__", member)
            if not key.startswith("_") and (
                inspect.isfunction(function) or isinstance(member, property)
            ):
                methods[key] = signature(function)
    return {"kind": "class", "signature": signature(offered), "fields": fields, "methods": methods}


KINDS = {
    "help": Kind(help_items, help_entry),
    "names": Kind(name_items, name_entry),
    "members": Kind(member_items, member_entry),
    "rows": Kind(row_items, row_entry),
    "cosim": Kind(lambda: list(command_table()), command_entry),
    "questions": Kind(question_items, question_entry),
    "live": Kind(live_items, live_entry),
}
