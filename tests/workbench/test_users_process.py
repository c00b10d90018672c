"""What asking, running and showing leave of a user's process: everything as it was."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

SCRIPT = """
import json, logging, os, signal, sys, warnings, locale
from pathlib import Path
import numpy as np
import pandas, scipy.interpolate, scipy.linalg, scipy.sparse, scipy.special, scipy.stats  # filter warnings
fmus = Path(sys.argv[1])
import cosim, scenarios, workbench
def state():
    logs = {name: (log.level, log.propagate, log.disabled, list(map(repr, log.handlers)), len(log.filters))
            for name, log in sorted(logging.root.manager.loggerDict.items())
            if isinstance(log, logging.Logger) and name.split(".")[0] in ("cosim", "mine", "root")}
    log = logging.root
    found = {
        "loggers": [logs, log.level, list(map(repr, log.handlers)), logging.root.manager.disable],
        "signals": {number.name: repr(signal.getsignal(number)) for number in signal.valid_signals()
                    if isinstance(number, signal.Signals)},
        "numpy": [np.geterr(), np.get_printoptions()["precision"]],
        "warnings": list(map(repr, warnings.filters)), "cwd": os.getcwd(), "umask": umask(),
        "environment": dict(os.environ), "locale": locale.setlocale(locale.LC_ALL), "path": sys.path,
        "hooks": [repr(sys.excepthook), repr(sys.unraisablehook), repr(sys.stdout), repr(sys.stderr)],
    }
    if PLOT:
        found["matplotlib"] = [plt.get_backend(), repr(dict(mpl.rcParams)), plt.get_fignums()]
    return found
def umask():
    now = os.umask(0)
    os.umask(now)
    return now
PLOT = sys.argv[2] == "plot"
if PLOT:
    import matplotlib as mpl
    mpl.use("svg")
    from matplotlib import pyplot as plt
    mpl.rcParams["font.size"] = 17.0
    plt.figure()
def mine(number, frame): pass
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, mine)
logging.getLogger("cosim").setLevel(logging.DEBUG)
logging.getLogger("cosim").addHandler(logging.StreamHandler(sys.stdout))
logging.basicConfig(level=logging.INFO, stream=sys.stdout)
motor = cosim.System({"motor": fmus / "DriveMotor.fmu"}, [], {"motor.w": 3.0})
def run(): return cosim.run(motor, stop=0.1, step=1e-3)
def certify():
    return cosim.certify(motor, lambda r: {"t": cosim.largest(r["time"], r["motor.tau"])}, stop=0.1, step=1e-3)
def ask():
    return scenarios.ask("orientator_cycle", flavour="native", step="1ms", out=Path("answer"))
def refuse():
    try:
        scenarios.ask("orientator_cycle", flavour="native", speed=-1.0)
    except cosim.SetupError as error:
        return error
def sweep(): return scenarios.ask("orientation_time", flavour="native", frictions=[0.35], speeds=[40.0, 41.0], jobs=2)
jobs = [run, certify, refuse, ask, sweep]
if PLOT:
    jobs += [lambda: run()._repr_html_(), lambda: run().plot(), lambda: ask()._repr_html_(), lambda: sweep()._repr_html_()]
changes = []
for number, job in enumerate(jobs):
    before = state()
    job()
    after = state()
    changes += [(number, key, str(before[key])[:3000], str(after[key])[:3000]) for key in before if before[key] != after[key]]
Path("changes.json").write_text(json.dumps(changes))
"""


@pytest.mark.parametrize("kind", [pytest.param("plot", marks=pytest.mark.slow), "bare"])
def test_nothing_global_is_changed(kind: str, tmp_path: Path) -> None:
    """Backend, style and figures of matplotlib, loggers, handlers of signals, NumPy, warnings."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(ROOT / "fmus" / "native"), kind],
        cwd=tmp_path, env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    changes = json.loads((tmp_path / "changes.json").read_text())
    assert not changes, "\n".join(f"{key} after job {n}:\n{a}\n{b}" for n, key, a, b in changes)
