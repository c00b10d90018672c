"""The file that a command reads: its system, with the start values and inputs of the command line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from .. import describe
from ..engine.control import Adaptive
from ..engine.settings import RunSettings
from ..errors import SetupError
from ..formats.osp import FILE, read_osp
from ..formats.ssp.read import Package, read_ssp
from ..formats.values import read_values
from ..scratch import scratch
from ..series import Series
from ..system import (
    Network,
    Port,
    System,
    connect,
    describe_fmu,
    legal_part_name,
    require_cosimulation,
    value_of_text,
)
from .options import OPTIONS, Parser, assignment
from .output import require_separate_files

#: The time [s] of a check where nothing states a stop: a convention of FMI, whose default experiment lasts 1 s.
CHECKED_TIME = 1.0
#: Commas in a name of --record, outside of brackets, at most. A convention: names of FMI may have any.
MOST_COMMAS = 8
#: The options of settings that are not called like them; that of the start is one of the system.
SETTING_OPTIONS = {"tolerance": "--fmu-tolerance", "start": ""}
FIELDS = [field.name for field in fields(RunSettings)]


@dataclass(frozen=True)
class SystemFile:
    """A system that has been read and checked, the package that it came from, and a title for it."""

    network: Network
    package: Package
    title: str

    @property
    def system(self) -> System:
        """The system with the values of the command line."""
        return self.network.system

    @property
    def start(self) -> float:
        """The start time of the file [s], 0 where it states none."""
        return self.package.start or 0.0

    @property
    def states_step(self) -> bool:
        """Whether the file or an FMU states a communication step."""
        return self.package.step is not None or bool(describe.preferred_steps(self.network))

    def step(self, requested: float | None) -> float:
        """Return the step [s] that was requested, or the file's, or the shortest that an FMU prefers."""
        preferred = min(describe.preferred_steps(self.network).values(), default=None)
        for step in (requested, self.package.step, preferred):
            if step is not None:
                return step
        raise SetupError("no FMU prefers a communication step: give --step")

    def times(
        self, options: argparse.Namespace, *, is_checked_only: bool = False
    ) -> tuple[float, float]:
        """Return start and stop [s] of the options or of the file; without a stop those of a check, else SetupError."""
        start = self.start if options.start is None else options.start
        stop = self.package.stop if options.stop is None else options.stop
        if stop is None and is_checked_only:
            stop = start + CHECKED_TIME
        if stop is None:
            raise SetupError(f"{' '.join(options.files)} states no stop time: give --stop")
        return start, stop

    def substeps(self, options: argparse.Namespace, step: float | Adaptive) -> dict[str, int]:
        """Return the sub-steps of the options over those of the file, which hold for its own step."""
        requested = substep_counts(vars(options).get("substeps", []))
        stated = {name: n for name, n in self.package.substeps.items() if name not in requested}
        if stated and step != self.package.step:
            print(
                f"warning: the file's own steps of {', '.join(stated)} hold for its step of "
                f"{self.package.step!r} s only and are ignored; give --substeps",
                file=sys.stderr,
            )
            stated = {}
        return stated | requested

    def settings(
        self, options: argparse.Namespace, *, is_checked_only: bool = False
    ) -> RunSettings:
        """Return how to run: by the options, else by the file, else as the FMUs prefer; a check needs no times.

        What no option mends, an FMU without co-simulation, is told before what one does.
        """
        try:
            return self._settings(options, is_checked_only=is_checked_only)
        except SetupError:
            require_cosimulation(self.network.descriptions, self.system.parts)
            raise

    def _settings(self, options: argparse.Namespace, *, is_checked_only: bool) -> RunSettings:
        start, stop = self.times(options, is_checked_only=is_checked_only)
        if options.step is not None and options.adaptive is not None:
            raise SetupError("--step and --adaptive cannot be used together")
        is_adaptive = options.adaptive is not None
        step: float | Adaptive
        if is_adaptive:
            step = Adaptive(options.adaptive)
        elif is_checked_only and options.step is None and not self.states_step:
            step = stop - start
        else:
            step = self.step(options.step)
        if not isinstance(step, Adaptive) and options.step is None and start < stop:
            step = min(step, stop - start)
        requested = {k: value for k, value in vars(options).items() if k in FIELDS}
        requested |= {"substeps": self.substeps(options, step)}
        if requested.get("record"):
            requested["record"] = recorded_names(self.network, requested["record"])
        return RunSettings(**requested | {"start": start, "stop": stop, "step": step})


@contextmanager
def open_system(options: argparse.Namespace, *, runnable: bool = True) -> Iterator[SystemFile]:
    """Read the system of the file, with the values of --parameters and of --set over its own."""
    with TemporaryDirectory(dir=scratch()) as folder:
        package = read_package(options.files, Path(folder) / "ssp")
        wires = [*package.system.wires, *options.wire]
        system = replace(package.system, wires=wires)
        network = connect(system, runnable=False)
        values = read_values(options.parameters, network) if options.parameters else {}
        for name, text in map(assignment, options.start_values):
            for port, factor, offset in network.behind(name):
                value = value_of_text(network, port, text)
                if (factor, offset) != (1.0, 0.0):
                    value = (
                        factor * float(value) + offset if isinstance(value, int | float) else value
                    )
                values[port.name] = value
        system = replace(system, start={**system.start, **values})
        network = connect(system, runnable=False)
        require_separate_files(options, network.system.parts.values())
        network = connect(with_inputs(network, options), runnable=runnable)
        for text in network.flaw_texts() if options.strict else ():
            raise SetupError(f"part {text}")
        several = len(options.files) > 1
        title = " ".join(system.parts) if several else Path(options.files[0]).stem
        yield SystemFile(network, package, title)


def with_inputs(network: Network, options: argparse.Namespace) -> System:
    """Return the system with --at, and with the columns of --input on the inputs that --map, or their names, say.

    "NAME=>COLUMN" takes the numbers as they are, whatever their unit. Raises SetupError.
    """
    system = network.system
    if "input" not in options:
        return system
    columns = dict(assignment(text) for text in options.map)
    if options.input is None:
        if columns:
            raise SetupError("--map needs an --input")
        return replace(system, changes=options.at)
    columns = {k: f"{text[1:]}:" if text[:1] == ">" else text for k, text in columns.items()}
    if not columns:
        columns = {port.name: name for name, port in equal_names(network, options.input)}
    inputs = {name: Series.read(options.input, column) for name, column in columns.items()}
    if options.held:
        inputs = {name: table.held() for name, table in inputs.items()}
    return replace(system, inputs=inputs, changes=options.at)


def equal_names(network: Network, path: Path) -> list[tuple[str, Port]]:
    """The columns of a file that have the name of an input; raises SetupError if none has."""
    table = Series.read(path)
    found: list[tuple[str, Port]] = []
    for name in table.names:
        with suppress(SetupError):
            port = network.port(name)
            if name != table.clock and port.variable.causality == "input":
                found.append((name, port))
    if not found:
        raise SetupError(
            f"no column of {path} has the name of an input: give --map NAME=COLUMN; "
            f"it has {', '.join(table.names)}"
        )
    return found


def read_package(files: Sequence[str], unpack_to: Path) -> Package:
    """Read the system of a file or a folder, or of several FMUs; packages are unpacked into `unpack_to`.

    Raises SetupError for files that are neither, and for parts of one name.
    """
    path = Path(files[0])
    is_named = "=" in files[0] and not path.exists()
    if len(files) == 1 and path.suffix != ".fmu" and not is_named:
        if path.suffix == ".xml" or (path / FILE).is_file():
            return read_osp(path)
        if path.suffix in (".ssp", ".ssd") or path.is_dir():
            return read_ssp(path, unpack_to)
        raise SetupError(
            f"{path} must be an .ssp, an .ssd, an {FILE}, a folder that contains one, or an .fmu"
        )
    parts: dict[str, Path] = {}
    for name, fmu in map(named_fmu, files):
        if name in parts:
            raise SetupError(
                f"two parts are named {name}: {parts[name]} and {fmu}; write another NAME={fmu}"
            )
        parts[name] = fmu
    experiments = [
        describe_fmu(name, fmu, runnable=False).defaultExperiment for name, fmu in parts.items()
    ]
    starts, stops = {e.start for e in experiments}, {e.stop for e in experiments}
    return Package(System(parts), _agreed(starts), _agreed(stops))


def named_fmu(text: str) -> tuple[str, Path]:
    """A part of the command line, "motor=Motor.fmu", or an FMU whose part is named like its file.

    Raises SetupError for another text.
    """
    name, equals, file = text.partition("=")
    if not equals or Path(text).is_file():
        name, file = legal_part_name(Path(text).stem), text
    path = Path(file).expanduser()
    if not name or path.suffix != ".fmu":
        raise SetupError(
            f"{text!r} must read NAME=FILE.fmu; of several files, each is the FMU of a part"
        )
    return name, path


def _agreed(times: set[float | None]) -> float | None:
    """The time [s] that all FMUs which state one agree on."""
    stated = times - {None}
    return stated.pop() if len(stated) == 1 else None


def recorded_names(network: Network, texts: Sequence[str]) -> list[str]:
    """The names of --record; pieces with a comma between them that are one name of a variable belong together."""
    known = {*network.system.connectors}
    known |= {f"{part}.{name}" for part, fmu in network.fmus.items() for name in fmu.variables}
    names: list[str] = []
    rest = list(texts)
    while rest:
        longest = min(len(rest), MOST_COMMAS + 1)
        joined = (",".join(rest[:n]) for n in range(longest, 1, -1))
        name = next((name for name in joined if name in known), rest[0])
        names.append(name)
        del rest[: name.count(",") + 1 - rest[0].count(",") if name != rest[0] else 1]
    return names


def substep_counts(texts: Sequence[str]) -> dict[str, int]:
    """Return "motor=4" as the number of sub-steps by part."""
    counts = dict(map(assignment, texts))
    for name, count in counts.items():
        if not count.isdecimal():
            raise SetupError(f"substeps of {name} = {count} must be a whole number")
    return {name: int(count) for name, count in counts.items()}


def add_system_options(parser: Parser, *, is_timed: bool = False, needs_file: bool = True) -> None:
    """Add the file or files, wires between parts, start values and how strictly all is read."""
    text = (
        f".ssp, .ssd, {FILE}, a folder that contains one, or FMUs: a.fmu, or motor=a.fmu pump=b.fmu"
    )
    parser.add_argument("files", help=text, metavar="file", nargs="+" if needs_file else "*")
    parser.take("--wire", "--parameters", "--set", "--start", "--strict")
    if is_timed:
        parser.take("--from")


def add_stepping_options(parser: Parser, *, records: bool = True) -> None:
    """Add the options of how a system is stepped, one for each field of the settings, and if it `records` what."""
    for name in FIELDS:
        option = SETTING_OPTIONS.get(name, f"--{name.replace('_', '-')}")
        if option in OPTIONS and (records or name != "record"):
            parser.take(option)
    parser.take("--adaptive", "--input", "--map", "--held", "--at")
