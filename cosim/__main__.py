"""cosim info | check | run | diagnose | oracle | export FILE; crosscheck, compare, verify."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile, mkdtemp
from typing import Any, NamedTuple

from . import __version__, describe
from .accuracy.certify import SUMMARY, UNKNOWN, Estimate, by_rows, certify, summary
from .accuracy.reference import METHODS, oracle, true_errors
from .commandline import (
    Help,
    Parser,
    StartAction,
    assignment,
    exit_code,
    literal,
    require,
    seconds,
)
from .engine.algorithms import ALGORITHMS
from .engine.control import Adaptive
from .engine.instance import quiet
from .engine.recorder import Stream
from .engine.settings import RunSettings
from .errors import SetupError, pluralize
from .formats.container import write_container
from .formats.osp import FILE, read_osp, write_osp
from .formats.ssp.read import Package, read_ssp
from .formats.ssp.write import write_ssp
from .formats.values import read_values
from .isolated import run_isolated
from .judge.compare import SHARE, compare
from .judge.crosscheck import crosscheck
from .judge.crosscheck.report import writer
from .judge.diagnose import diagnose
from .progress import bar
from .requirements import setup_problems
from .result import Interrupted, Result, SimulationError, require_names
from .result import partial as partial_file
from .scratch import scratch
from .system import (
    Network,
    System,
    Value,
    connect,
    conversion_to,
    default_experiment,
    describe_fmu,
    part_name,
)
from .system.inputs import Table
from .units import QUANTITY

HERE = Path(__file__).resolve().parent
EXACT = next(
    (
        path
        for path in (
            HERE / "verification" / "LinearSystem.fmu",
            HERE.parent / "fmus/LinearSystem.fmu",
        )
        if path.is_file()
    ),
    Path("fmus/LinearSystem.fmu"),
)
#: The longest step, as a share of a run: one, and a little for what rounding makes of it.
LONGEST_STEP = 1.0 + 1e-9
TIMED = ("check", "run", "oracle")
OTHER_NAMES = {"certify": "run --certify"}


class Task(NamedTuple):
    """A system that has been read and checked, and the file it came from."""

    network: Network
    package: Package

    @property
    def system(self) -> System:
        return self.network.system

    @property
    def start(self) -> float:
        return self.package.start or 0.0

    def step(self, given: float | None) -> float:
        """The step [s] that is given, or the file's, or the shortest that an FMU prefers."""
        preferred = min(describe.preferred_steps(self.network).values(), default=None)
        for step in (given, self.package.step, preferred):
            if step is not None:
                return step
        raise SetupError("no FMU prefers a communication step: give --step")


def over_time(system: System, options: argparse.Namespace) -> System:
    """The system with the columns of --input on the inputs that --map names, and with --at."""
    if "input" not in options:
        return system
    columns = dict(assignment(text) for text in options.map)
    if columns and options.input is None:
        raise SetupError("--map needs an --input")
    inputs = {
        name: Table.read(options.input, column, held=options.held)
        for name, column in columns.items()
    }
    if options.input is not None and not inputs:
        raise SetupError("--input needs a --map NAME=COLUMN")
    return replace(system, inputs=inputs, changes=options.at)


@contextmanager
def opened(options: argparse.Namespace, *, runnable: bool = True) -> Iterator[Task]:
    """The system of the file, with the start values of --parameters and of --set over its own."""
    with TemporaryDirectory(dir=scratch()) as folder:
        package = read(options.file, Path(folder) / "ssp")
        system = package.system
        network = connect(system, runnable=runnable)
        values = read_values(options.parameters, network) if options.parameters else {}
        for name, text in map(assignment, options.given):
            values[name] = start_value(network, name, text)
        system = replace(system, start={**system.start, **values})
        network = connect(over_time(system, options), runnable=runnable)
        for part, schema_warning in network.schema_warnings.items() if options.strict else ():
            raise SetupError(f"part {part}: {schema_warning}")
        yield Task(network, package)


def start_value(network: Network, name: str, text: str) -> Value:
    """The value that a text gives a variable; that of a Real may be in any unit that fits its own."""
    port = network.port(name)
    quantity = QUANTITY.fullmatch(text) if port.type == "Real" else None
    if quantity and quantity[2]:
        factor, offset = conversion_to(network, port, quantity[2], "be given")
        return factor * float(quantity[1]) + offset
    return text if port.type in ("String", "Binary") else literal(text)


def read(path: Path, folder: Path) -> Package:
    """The system of a file or a folder; packages are unpacked into `folder`."""
    if path.suffix == ".fmu":
        system = alone(path)
        ((name, fmu),) = system.parts.items()
        experiment = default_experiment(describe_fmu(name, fmu, runnable=False))
        return Package(system, experiment.start, experiment.stop)
    if path.suffix == ".xml" or (path / FILE).is_file():
        return read_osp(path)
    if path.suffix in (".ssp", ".ssd") or path.is_dir():
        return read_ssp(path, folder)
    raise SetupError(f"{path} must be an .ssp, an .ssd, an {FILE}, a folder with one, or an .fmu")


def alone(path: Path) -> System:
    """A single FMU, named like its file as far as that is a name."""
    return System({part_name(path.stem): path})


def names(text: str) -> list[str]:
    """ "a,b" as a list; commas in brackets, as in A[2,1], belong to the name."""
    return [name.strip() for name in re.split(r",(?![^\[]*\])", text) if name.strip()]


def rates(texts: Sequence[str]) -> dict[str, int]:
    """ "motor=4" as substeps by part."""
    found = dict(map(assignment, texts))
    for name, count in found.items():
        if not count.isdecimal():
            raise SetupError(f"substeps of {name} = {count} must be a whole number")
    return {name: int(count) for name, count in found.items()}


def parser() -> Parser:
    """The command line."""
    top = Parser(prog="cosim", description="Couple co-simulation FMUs of FMI 2.0 and 3.0.")
    top.add_argument("--version", action="version", version=f"cosim {__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND", dest="command")

    def command(name: str, does: Callable[..., int], text: str, *, file: bool = True) -> Parser:
        one = commands.add_parser(name, help=text, description=text, formatter_class=Help)
        one.set_defaults(does=does)
        if file:
            one.path(
                "file", f".ssp, .ssd, {FILE}, a folder with one, or a single .fmu", metavar="file"
            )
            values = "start values: an .ssv, or a .csv with the columns name, value and unit"
            one.path("--parameters", values)
            value = "start value of a parameter or input, by its dotted name"
            value += ", with a unit if need be: motor.T=5ms"
            one.several("--set", value, dest="given", metavar="NAME=VALUE")
            text = "start value, as with --set (repeatable)"
            if name in TIMED:
                text += "; or start time [s], as with --from"
                one.time("--from", "start time [s]; the file's by default", dest="start")
            one.add_argument(
                "--start", help=text, action=StartAction,
                metavar="NAME=VALUE", default=None if name in TIMED else argparse.SUPPRESS,
            )  # fmt: skip
            text = "refuse an FMU whose model description is not valid"
            one.add_argument("--strict", action="store_true", help=text)
        return one

    command("info", show, "show what a system is made of")
    stepping(command("check", examine, "check whether a system can run, without running it"))
    one = command("run", simulate, "run a system and write its rows")
    stepping(one)
    one.path("--out", ".csv or .parquet file; a JSON file next to it gives units and provenance")
    one.time("--timeout", "longest time that a step may take [s]; no limit by default", math.inf)
    one.add_argument(
        "--part", metavar="NAME", help="write only this part's columns, under their bare names"
    )
    one.path("--plot", "image file with a plot of all columns")
    text = "also run with smaller steps and state the coupling errors"
    one.add_argument("--certify", action="store_true", help=text)

    one = command("diagnose", measure, "measure what the coupling does to the damping")
    shared(one, "--step", "--algorithm")
    one.number("--share", "artificial damping allowed, as a share of the real damping", 0.05)
    one.time("--settle", "time [s] to settle before the measurement", 0.0)

    one = command("oracle", judge, "find the true errors of a run by model exchange")
    shared(one, "--stop", "--step", "--algorithm")
    text = "longest time that an integration of the oracle may take [s]; no limit by default"
    one.time("--timeout", text, math.inf)
    text = "integrator; the last two are for stiff systems"
    one.add_argument("--method", choices=METHODS, default=METHODS[0], help=text)
    shared(one, "--record")
    one.path("--out", ".csv or .parquet file for the oracle's rows")
    one.set_defaults(adaptive=None, output_step=None, plot=None, part=None, certify=True)

    one = command("export", export, "write a system in another format")
    formats = ("ssp", "osp", "container")
    one.add_argument("--to", choices=formats, required=True, help="format")
    one.path("--out", "file to write, or folder for osp", required=True)
    one.time("--step", "communication step [s]")

    one = command("crosscheck", cross, "check whether an FMU keeps its promises", file=False)
    one.path("fmu", "a co-simulation FMU of FMI 2.0 or 3.0", metavar="fmu")
    one.time("--step", "communication step [s]; by default the one the FMU prefers")
    one.time("--timeout", "longest time that a check may take [s]", 60.0)
    one.several("--out", "report file: .txt, .xml (JUnit) or .html", metavar="FILE", type=Path)

    one = command(
        "compare", beside, "check whether a result stays close to a reference", file=False
    )
    one.path("result", ".csv or .parquet file whose first column is the time", metavar="result")
    one.path("reference", "likewise: another result or a measurement", metavar="reference")
    text = (
        "columns of result and reference, w=n:rpm or tau=M*0.73:N.m; "
        "by default, all columns with the same name"
    )
    one.several("--map", text, metavar="NAME=COLUMN")
    one.number("--value", "half the height of the band, as a share of the reference's range", SHARE)
    one.number("--time", f"half the width of the band [s]; {SHARE} of the time compared by default")
    text = "error of a column, in the reference's unit or with its own, as in 7.3rpm"
    one.several("--error", text, metavar="NAME=VALUE")
    text = "skip gaps longer than this between rows of the reference [s]; no limit by default"
    one.number("--gap", text, math.inf)
    one.path("--plot", "image file with a plot of the curves and their bands")

    one = command("verify", verify, "test the master against closed-form solutions", file=False)
    one.path(
        "fmu",
        "LinearSystem.fmu, by default the one that came with cosim",
        metavar="fmu",
        nargs="?",
        default=EXACT,
    )
    return top


def shared(one: Parser, *options: str) -> None:
    """Options of several commands."""
    told: dict[str, dict[str, Any]] = {
        "--stop": {"type": seconds, "metavar": "TIME", "help": "stop time [s]; the file's by default"},
        "--step": {"type": seconds, "metavar": "TIME", "help": "communication step [s]; by default the file's, or the one the FMUs prefer"},
        "--algorithm": {"choices": ALGORITHMS, "default": "strang", "help": "coupling algorithm"},
        "--record": {"type": names, "metavar": "LIST", "help": "columns to record, by dotted names a,b,c; all outputs by default"},
    }  # fmt: skip
    for option in options:
        one.add_argument(option, **told[option])


def stepping(one: Parser) -> None:
    """The options of how a system is stepped."""
    shared(one, "--stop", "--step")
    one.number(
        "--adaptive",
        "choose the steps so that the coupling error stays within this tolerance",
        metavar="TOLERANCE",
    )
    shared(one, "--algorithm")
    add = one.add_argument
    add("--order", type=names, metavar="LIST", help="order in which parts step: a,b,c")
    add(
        "--input-order",
        type=int,
        default=0,
        metavar="N",
        help="polynomial order of inputs within a step",
    )
    one.several("--substeps", "sub-steps of a part within a communication step", metavar="PART=N")
    one.number(
        "--tolerance",
        "relative tolerance passed to the FMUs; by default the one that each FMU states",
    )
    text = "tell the FMUs the stop time before the start; by default only those that need it"
    add("--stop-time-defined", action="store_true", help=text)
    one.path("--input", "CSV file of inputs over time; its first column is the time [s]")
    one.several("--map", "input, and the column that drives it", metavar="NAME=COLUMN")
    add(
        "--held",
        action="store_true",
        help="hold the values of --input until the next row; do not interpolate",
    )
    one.several("--at", "change during the run", metavar="'TIME NAME=VALUE'")
    shared(one, "--record")
    one.time("--output-step", "time between rows [s]; a row at every step by default")


def times(task: Task, options: argparse.Namespace) -> tuple[float, float]:
    """Start and stop [s], as asked for or as the file says."""
    start = task.start if options.start is None else options.start
    stop = task.package.stop if options.stop is None else options.stop
    if stop is None:
        raise SetupError(f"{options.file} states no stop time: give --stop")
    return start, stop


def substeps(task: Task, options: argparse.Namespace, step: float | Adaptive) -> dict[str, int]:
    """The sub-steps asked for, over those of the file, which hold for the file's own step."""
    requested = rates(vars(options).get("substeps", []))
    stated = {name: n for name, n in task.package.substeps.items() if name not in requested}
    if stated and step != task.package.step:
        print(
            f"warning: the file's own steps of {', '.join(stated)} hold for its step of "
            f"{task.package.step!r} s only and are ignored; give --substeps",
            file=sys.stderr,
        )
        stated = {}
    return stated | requested


def settings(task: Task, options: argparse.Namespace) -> RunSettings:
    """How to run, as asked for, as the file says, or as the FMUs prefer."""
    start, stop = times(task, options)
    if options.step is not None and options.adaptive is not None:
        raise SetupError("--step and --adaptive exclude each other")
    adaptive = options.adaptive is not None
    step = Adaptive(options.adaptive) if adaptive else task.step(options.step)
    if options.step is not None and start < stop < start + options.step / LONGEST_STEP:
        span = f"the time from start to stop, {stop - start!r} s"
        raise SetupError(f"step = {options.step!r} s must be at most {span}")
    own = {
        name: value
        for name, value in vars(options).items()
        if name in {f.name for f in fields(RunSettings)}
    }
    own |= {"substeps": substeps(task, options, step)}
    return RunSettings(**own | {"start": start, "stop": stop, "step": step})


def show(options: argparse.Namespace) -> int:
    """cosim info."""
    with opened(options, runnable=False) as task:
        print("\n".join(describe.info(task.network)))
        for connector, port in task.package.connectors.items():
            print(f"connector {connector} is {port}")
        if task.package.stop is not None:
            print(f"default experiment: {task.start:g} to {task.package.stop:g} s")
        if task.package.step is not None:
            print(f"communication step: {task.package.step:g} s")
    return 0


def examine(options: argparse.Namespace) -> int:
    """cosim check; exit code 1 if something stands in the way."""
    with opened(options) as task:
        way = settings(task, options)
        errors, notes = (
            list(setup_problems(task.network, way)),
            list(describe.notes(task.network, way)),
        )
        if task.package.step is not None:
            notes.append(f"communication step: {task.package.step!r} s, given by the file")
    for note in notes:
        print(note)
    for error in errors:
        print(f"error: {error}")
    print("ready to run" if not errors else f"problems: {len(errors)}")
    return 1 if errors else 0


def simulate(options: argparse.Namespace) -> int:
    """cosim run."""
    with opened(options) as task:
        way = settings(task, options)
        given: dict[str, Any] = {k: v for k, v in vars(way).items() if v is not None}
        folders = new_folders(options)
        require_files(options, task.system)
        whole = options.out is not None and options.part is None and options.out.suffix == ".csv"
        figures: dict[str, Estimate] = {}
        later = None if whole else options.out
        with TemporaryDirectory(dir=scratch()) as folder, claimed(later):
            runner = partial(run_isolated, csv=Path(folder) / "rows.csv", timeout=options.timeout)
            if whole:
                given["csv"] = options.out
            try:
                with quiet(), bar(options.file.stem, way.start, way.stop) as progress:
                    given["progress"] = progress
                    if options.certify:
                        result, figures = certify(task.system, summary, runner=runner, **given)
                    else:
                        result = runner(task.system, **given)
            except (SimulationError, Interrupted) as stopped:
                warn(stopped.result)
                if later is not None:
                    keep(stopped.result, partial_file(later), options.part)
                raise
            if later is not None:
                keep(result, later, options.part)
            if options.plot is not None:
                result.plot(path=options.plot)
            print("\n".join(told(result)))
            print(
                "\n".join(new_files(options, folders)), end="\n" * bool(options.out or options.plot)
            )
            if options.out is None and options.plot is None:
                end = zip(result.columns, result.data[-1])
                table((name, f"{value:.6g} {result.units[name]}") for name, value in end)
    if figures:
        ways = ("step, a half and a quarter", "tolerance, a tenth and a hundredth")
        print(f"coupling errors, from runs with the {ways[options.adaptive is not None]} of it")
        rows = []
        for name, column in summed(result):
            x = figures[name]
            order = "" if x.error is None else f"order {x.order:.1f}"
            rows.append((name, x.text(result.units[column]), order))
        table(rows)
    warn(result)
    return 0


def keep(result: Result, path: Path, part: str | None) -> None:
    """Write a result at the end of its run, into a folder for temporary files if its own is full."""
    try:
        result.write(path, part=part)
    except OSError as error:
        other = Path(mkdtemp(prefix="rows_")) / f"{path.stem}.csv"
        result.write(other, part=part)
        raise OSError(
            f"{path} cannot be written: {error.strerror or error}; the rows are in {other}"
        ) from error


@contextmanager
def claimed(path: Path | None) -> Iterator[None]:
    """Keep other runs from a file that is written at the end; SetupError if one writes it now."""
    if path is None:
        yield
        return
    claim = Stream(partial_file(path.with_suffix(".csv")))
    try:
        yield
    finally:
        if claim.path.exists() and not claim.path.stat().st_size:
            claim.path.unlink()
        claim.close()


def require_files(options: argparse.Namespace, system: System) -> None:
    """Raise SetupError, before a run, for files that it could not write at its end."""
    require_image(options.plot)
    if options.out is not None:
        require_place(options.out)
        require_names(options.out)
        if options.out.suffix not in (".csv", ".parquet"):
            raise SetupError(f"{options.out} must end in .csv or .parquet")
        if options.out.suffix == ".parquet":
            require("pyarrow", f"{options.out}: Parquet")
    if options.certify:
        require("scipy", "--certify")
    if options.part is not None and options.part not in system.parts:
        raise SetupError(f"there is no part {options.part!r}, only {', '.join(system.parts)}")


def new_folders(options: argparse.Namespace) -> list[Path]:
    """The folders that must be made for the files to write, the outermost of each."""
    folders = []
    for path in filter(None, (options.out, options.plot)):
        missing = [folder for folder in path.parents if not folder.exists()]
        folders += missing[-1:]
    return list(dict.fromkeys(folders))


def new_files(options: argparse.Namespace, folders: Sequence[Path]) -> Iterator[str]:
    """Which files and folders a command has made."""
    if options.out is not None:
        facts = options.out.with_suffix(".json")
        yield f"rows written to {options.out}, units and provenance to {facts}"
    if options.plot is not None:
        yield f"plot written to {options.plot}"
    for folder in folders:
        yield f"new folder: {folder}"


def require_place(path: Path) -> None:
    """Raise SetupError for a path that no file can have; make its folder."""
    if path.is_dir():
        raise SetupError(f"{path} is a folder")
    folder = path.absolute().parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror}") from error


def require_image(path: Path | None) -> None:
    """Raise SetupError for an image that could not be written."""
    if path is None:
        return
    require_place(path)
    require("matplotlib", "--plot")
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix[1:] not in (kinds := FigureCanvasBase.get_supported_filetypes()):
        raise SetupError(f"{path} must end in one of {', '.join(kinds)}")


def warn(result: Result) -> None:
    """Say what a result warns of, beside the answer."""
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)


def table(rows: Iterable[Sequence[str]]) -> None:
    """Print rows in aligned columns."""
    print("\n".join(f"  {line}" for line in describe.table(list(rows))))


def summed(result: Result) -> Iterator[tuple[str, str]]:
    """The names of the figures of `summary`, each with its column."""
    return ((f"{column}{what}", column) for column in result.columns[1:] for what in SUMMARY)


def told(result: Result) -> Iterator[str]:
    """What a run did, in a few lines."""
    ran = result.provenance
    did = pluralize(ran["steps"], "step")
    for what in ("rejected", "discarded"):
        did += f", {ran[what]} {what}" if ran[what] else ""
    pace = (ran["reached"] - ran["start"]) / ran["wall_time"]
    if ran["reason"]:
        yield str(ran["reason"])
    yield (
        f"{ran['algorithm']}, {ran['communication']}: {did} in {ran['wall_time']:.3g} s "
        f"({pace:.3g} x real time), {pluralize(ran['rows'], 'row')}"
    )
    for bond, energy in result.energy.items():
        yield (
            f"{bond}: {energy['given']:.6g} J given, {energy['taken']:.6g} J taken, "
            f"{-energy['residual']:+.2g} J made by the coupling"
        )


def measure(options: argparse.Namespace) -> int:
    """cosim diagnose."""
    with opened(options) as task:
        found = diagnose(
            task.system, step=task.step(options.step), algorithm=options.algorithm,
            share=options.share, start=task.start, settle=options.settle,
        )  # fmt: skip
    print(found.text())
    return 0


def judge(options: argparse.Namespace) -> int:
    """cosim oracle."""
    folders = new_folders(options)
    require_files(options, System({}))
    with opened(options) as task:
        descriptions = task.network.descriptions.items()
        if lone := [name for name, d in descriptions if d.coSimulation is None]:
            return truth(task, options, lone, folders)
        way = settings(task, options)
        with quiet():
            found = true_errors(
                task.system, start=way.start, stop=way.stop, step=task.step(options.step),
                record=options.record, method=options.method, algorithm=options.algorithm,
                timeout=options.timeout,
            )  # fmt: skip
    if options.out is not None:
        found.result.write(options.out)
    print("the oracle's figure, the certified one, its true error")
    rows = []
    for name, column in summed(found.result):
        x, unit = found.figures[name], found.result.units[column]
        rows.append((name, f"{x.true:.9g} {unit}", x.certified.text(unit), f"{x.error:.2g} {unit}"))
    table(rows)
    print("\n".join(new_files(options, folders)), end="\n" * bool(options.out))
    warn(found.result)
    return 0


def truth(
    task: Task, options: argparse.Namespace, lone: Sequence[str], folders: Sequence[Path]
) -> int:
    """cosim oracle, where no run can be beside it."""
    start, stop = times(task, options)
    with quiet():
        result = oracle(
            task.system, start=start, stop=stop, output_step=options.step, record=options.record,
            method=options.method, timeout=options.timeout,
        )  # fmt: skip
    if options.out is not None:
        result.write(options.out)
    print(
        f"the oracle's figures, with no run to compare: {', '.join(lone)} offers no co-simulation"
    )
    figures = summary(result)
    between, off = by_rows(summary, result, figures), result.provenance["errors"]
    rows = []
    for name, column in summed(result):
        error = None if (gap := between[name]) is None else gap + off[column]
        found = Estimate(figures[name], error, math.nan, reason=UNKNOWN)
        rows.append((name, found.text(result.units[column])))
    table(rows)
    print("\n".join(new_files(options, folders)), end="\n" * bool(options.out))
    warn(result)
    return 0


def export(options: argparse.Namespace) -> int:
    """cosim export."""
    with opened(options) as task:
        if options.to != "osp":
            require_place(options.out)
        start, stop = task.start, task.package.stop
        if options.to == "ssp":
            step = task.package.step if options.step is None else options.step
            drawing = task.package.geometry
            write_ssp(task.system, options.out, stop, start, step, geometry=drawing)
        elif options.to == "osp":
            step = task.step(options.step)
            write_osp(task.system, options.out, step=step, start=start, stop=stop)
        else:
            stop = start + 1.0 if stop is None else stop
            step = task.step(options.step)
            write_container(task.system, options.out, step=step, start=start, stop=stop)
    print(f"{options.out} written")
    return 0


def cross(options: argparse.Namespace) -> int:
    """cosim crosscheck; exit code 1 if a check failed."""
    for path in options.out:
        writer(path)
        require_place(path)
    found = crosscheck(options.fmu, step=options.step, timeout=options.timeout)
    for path in options.out:
        found.write(path)
    print(found.text())
    return 0 if found.passed else 1


def beside(options: argparse.Namespace) -> int:
    """cosim compare; exit code 1 if a column leaves its band."""
    require_image(options.plot)
    found = compare(
        options.result, options.reference, columns=dict(map(assignment, options.map)) or None,
        value=options.value, time=options.time, errors=dict(map(assignment, options.error)),
        gap=options.gap,
    )  # fmt: skip
    print(found.text())
    if options.plot is not None:
        found.plot(options.plot)
    return 0 if found.passed else 1


def verify(options: argparse.Namespace) -> int:
    """cosim verify; exit code 1 if anything differs from theory."""
    require("scipy", "verify")
    from .verification import main as verified

    if not options.fmu.is_file():
        raise SetupError(f"there is no file {options.fmu}; build_fmus.py makes it")
    return 0 if verified(options.fmu) else 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that was typed; its exit code."""

    def act() -> int:
        words = sys.argv[1:] if arguments is None else arguments
        if words and words[0] in OTHER_NAMES:
            raise SetupError(f"there is no command {words[0]!r}: use {OTHER_NAMES[words[0]]}")
        options = parser().parse_args(arguments)
        return int(options.does(options))

    return exit_code(act)


if __name__ == "__main__":
    sys.exit(main())
