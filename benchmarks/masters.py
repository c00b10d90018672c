"""Co-simulation masters on the reference systems.

FOLDER gets the reference systems, unless it has them. Each master of the package index runs in an environment of its own
that uv makes (`--environments` takes ready ones instead), all with the same FMUs, start values, wires and steps. The
results go to FOLDER/results/MASTER, and are judged as `cosim referee --scoreboard FOLDER` does: FOLDER/scoreboard.html, .json, .png.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import Result, SimulationError, run, scoreboard, write_ssp
from reference_systems.make import write_all, write_rows
from reference_systems.systems import SYSTEMS, ReferenceSystem, build_fmus

#: The page that this backs, and its heading.
CLAIM = ("docs/masters.md", "Compare with other tools")

CLIENTS = Path(__file__).with_name("masters_clients.py")
#: what uv installs for each master; FMPy is needed in the version that CoFMuPy asks for
REQUIREMENTS = {
    "fmpy": ("fmpy==0.3.32",),
    "pathsim-cs": ("pathsim==0.27.1", "pathsim-fmi==0.1.1"),
    "pathsim-me": ("pathsim==0.27.1", "pathsim-fmi==0.1.1"),
    "cofmupy-jacobi": ("cofmupy==1.0.0",),
    "cofmupy-gauss-seidel": ("cofmupy==1.0.0",),
    "ecos": ("ecospy==0.7.2", "tbb"),
    "libcosim": ("libcosimpy==0.0.6",),
}
#: algorithms of the master of this project, and how often each steps a part in a communication step
OURS: dict[str, tuple[dict[str, Any], float]] = {
    "cosim-jacobi": ({"algorithm": "jacobi"}, 1),
    "cosim-gauss-seidel": ({"algorithm": "gauss-seidel"}, 1),
    "cosim-strang": ({"algorithm": "strang"}, 2),
    **{
        f"cosim-gauss-seidel-{n}": ({"algorithm": "gauss-seidel", "input_order": n}, 1)
        for n in (1, 2, 3, 4, 6)
    },
}
TITLES = {
    "fmpy": "FMPy, SSP", "pathsim-cs": "PathSim, co-simulation", "pathsim-me": "PathSim, model exchange (RK4)",
    "cofmupy-jacobi": "CoFMuPy, Jacobi", "cofmupy-gauss-seidel": "CoFMuPy, Gauss-Seidel", "ecos": "Ecos",
    "libcosim": "libcosim", "omsimulator": "OMSimulator", "cosim-jacobi": "this project, Jacobi",
    "cosim-gauss-seidel": "this project, Gauss-Seidel", "cosim-strang": "this project, Strang",
    **{f"cosim-gauss-seidel-{n}": f"this project, Gauss-Seidel, inputs of order {n}" for n in (1, 2, 3, 4, 6)},
}  # fmt: skip
#: what is no package that uv can install, and why
NOT_RUN = {
    "OMSimulator": "its package downloads the program while it is installed: --omsimulator PROGRAM",
    "PyFMI": "the newest on the package index, of 2018, wants the FMI Library and a C compiler",
    "MasterSim": "not on the package index",
    "Maestro": "not on the package index: a Java archive",
    "Vico": "not on the package index",
}
#: the steps that all masters run [s]
STEPS = (2e-3, 1e-3, 5e-4)
#: Seed of the hashes of texts in the programs of the others: chosen. CoFMuPy 1.0.0 steps the parts of a loop in the order
#: of a set of their names (`GraphEngine._get_order`), which without a seed is another one in each process.
HASH_SEED = "0"
Array = NDArray[np.float64]


class Client:
    """A program that runs a master of others, as long as the benchmark needs it."""

    def __init__(self, tool: str, environments: Path | None) -> None:
        if environments:
            python = [str(environments / REQUIREMENTS[tool][0].split("==")[0] / "bin" / "python")]
        else:
            packages = [x for name in REQUIREMENTS[tool] for x in ("--with", name)]
            uv = [sys.executable, "-m", "uv", "run", "-q", "--no-project", "--isolated"]
            python = [*uv, "--python", "3.11", *packages, "python"]
        self.program = subprocess.Popen(
            [*python, str(CLIENTS), tool], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, env={**os.environ, "PYTHONHASHSEED": HASH_SEED},
        )  # fmt: skip

    def ask(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a task; a failure where the program ended."""
        assert self.program.stdin and self.program.stdout
        try:
            print(json.dumps(task), file=self.program.stdin, flush=True)
        except BrokenPipeError:
            return {"failure": "the program ended"}
        for line in self.program.stdout:
            if line.startswith("ANSWER "):
                answer: dict[str, Any] = json.loads(line.removeprefix("ANSWER "))
                return answer
        return {"failure": "the program ended"}

    def close(self) -> None:
        """End the program."""
        assert self.program.stdin
        self.program.stdin.close()
        self.program.wait()


class OmSimulator:
    """The program OMSimulator, which takes the SSP of a system and writes a table."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program, self.folder = program.absolute(), folder
        done = subprocess.run(
            [self.program, "--version"], check=True, capture_output=True, text=True
        )
        self.version = done.stdout.strip().removeprefix("OMSimulator ")

    def ask(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a task, in which each row is there once, with what follows from an event at its time."""
        result = self.folder / "omsimulator.csv"
        result.unlink(missing_ok=True)
        began = time.process_time()
        subprocess.run(
            [self.program, f"--stepSize={task['step']}", f"--stopTime={task['step'] * task['steps']}",
             f"--resultFile={result}", Path(task["ssp"]).name],
            check=False, cwd=Path(task["ssp"]).parent, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        if not result.is_file():
            return {"failure": "no result"}
        table = pd.read_csv(result, skipinitialspace=True).drop_duplicates("time", keep="last")
        columns = [
            next(x for x in map(str, table) if x.endswith(f".{port}")) for port in task["record"]
        ]
        return {
            "rows": table[["time", *columns]].to_numpy().tolist(),
            "seconds": time.process_time() - began, "versions": {"omsimulator": self.version},
        }  # fmt: skip

    def close(self) -> None:
        """Nothing runs on."""


class Ours:
    """The master of this project with one algorithm."""

    def __init__(self, name: str) -> None:
        self.settings = OURS[name][0]

    def ask(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a task; the time is that of the steps, without the set-up."""
        reference: ReferenceSystem = SYSTEMS[task["key"]]
        system, ports = reference.system(), reference.signals

        def measured(stop: float) -> tuple[Result, float]:
            began = time.process_time()
            result = run(system, stop=stop, step=task["step"], record=ports, **self.settings)
            return result, time.process_time() - began

        try:
            result, once = measured(reference.stop)
        except SimulationError as failure:
            return {"failure": str(failure)}
        _, set_up = measured(task["step"])
        rows = np.column_stack([result["time"], *(result[port] for port in ports)])
        return {"rows": rows.tolist(), "seconds": once - set_up, "versions": {}}

    def close(self) -> None:
        """Nothing runs on."""


def enter(
    name: str,
    client: Client | OmSimulator | Ours,
    keys: list[str],
    steps: list[float],
    folder: Path,
) -> None:
    """Run a master on these systems, and write its results and what failed."""
    out = folder / "results" / name
    out.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = {
        "title": TITLES[name], "calls": OURS[name][1] if name in OURS else int(name != "pathsim-me"),
        "failed": {}, "seconds": {},
    }  # fmt: skip
    for key in keys:
        reference = SYSTEMS[key]
        first = pd.read_csv(folder / key / f"{key}_ref.csv", nrows=1).iloc[0]
        for step in steps:
            result = out / f"{key}_{1e3 * step:g}ms.csv"
            result.unlink(missing_ok=True)
            system = reference.system()
            ssp = out / f"{key}.ssp"
            write_ssp(system, ssp, stop=reference.stop, step=step)
            answer = client.ask({
                "key": key, "parts": {part: str(fmu) for part, fmu in system.parts.items()},
                "wires": reference.wire_ends, "start": dict(reference.start), "step": step,
                "steps": round(reference.stop / step), "record": reference.signals, "ssp": str(ssp),
                "inputs": {b: float(first[a]) for a, b in reference.wire_ends},
            })  # fmt: skip
            ssp.unlink()
            print(
                f"{key:18} {name:26} {1e3 * step:5g} ms {answer.get('failure', 'ran')}", flush=True
            )
            if "failure" in answer:
                facts["failed"][key] = f"{1e3 * step:g} ms: {answer['failure'][:100]}"
                continue
            facts["seconds"][result.stem] = answer["seconds"]
            if answer["versions"]:
                facts["version"] = ", ".join(f"{k} {v}" for k, v in answer["versions"].items())
            rows = np.array(answer["rows"], float)
            write_rows(result, rows[:, 0], dict(zip(reference.signals, rows[:, 1:].T)))
    (out / "master.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Read the options, and run the masters one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--environments", type=Path, help="folder of ready environments by package")
    parser.add_argument("--masters", default=",".join((*OURS, *REQUIREMENTS)), help="which masters")
    parser.add_argument("--omsimulator", type=Path, help="the program OMSimulator")
    parser.add_argument("--systems", default=",".join(SYSTEMS), help="which systems")
    parser.add_argument(
        "--steps", default=",".join(f"{1e3 * s:g}" for s in STEPS), help="steps [ms]"
    )
    options = parser.parse_args()
    folder = options.folder.absolute()
    keys = options.systems.split(",")
    if missing := [key for key in keys if not (folder / key).is_dir()]:
        build_fmus()
        write_all(folder, missing)
    names = options.masters.split(",") + ["omsimulator"] * bool(options.omsimulator)
    for name in names:
        client: Client | OmSimulator | Ours
        if name in OURS:
            client = Ours(name)
        elif name == "omsimulator":
            client = OmSimulator(options.omsimulator, folder)
        else:
            client = Client(name, options.environments)
        enter(
            name,
            client,
            keys,
            [1e-3 * float(x) for x in options.steps.split(",")],
            folder,
        )
        client.close()
    for name, reason in NOT_RUN.items():
        if name.lower() not in names:
            out = folder / "results" / name.lower()
            out.mkdir(parents=True, exist_ok=True)
            facts = {"title": name, "not_run": reason}
            (out / "master.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    board = scoreboard(folder, progress=lambda line: print(line, flush=True))
    for suffix in ("html", "json", "png"):
        board.write(folder / f"scoreboard.{suffix}")
    print(board.text())


if __name__ == "__main__":
    main()
