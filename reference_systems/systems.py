"""The reference systems: their FMUs and wires, every number that they depend on, and what a master should reach."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from cosim import System
from fmukit.fmu.make import make_all

ROOT = Path(__file__).resolve().parents[1]
MODELS = Path(__file__).with_name("models")
#: With which power of the step the error falls at least, by algorithm, where inputs are held or follow a polynomial
#: through earlier values (Busch, ZAMM 96, 2016). The first steps have fewer values, which ends the order at 3.
SMOOTH_ORDERS = {"held": 1, "held, Strang": 2, "order 1": 2, "order 2 and more": 3}
#: A damper passes on what another part does in the same step, and a limit is a kink.
PASSED_ON_ORDERS = {"held": 1, "held, Strang": 1, "order 1": 2, "order 2 and more": 2}
#: Where a signal jumps within a step, what crosses a wire in that step is wrong by the jump.
JUMP_ORDERS = dict.fromkeys(SMOOTH_ORDERS, 1)


@dataclass(frozen=True)
class ReferenceSystem:
    """A system and its experiment.

    Attributes
    ----------
    title : str
        What it is.
    models : mapping of str to str
        By part, the component or the model in `models` that its FMU is made of.
    wires, start
        Those of a `cosim.System`, with every parameter and state that the answer depends on.
    stop : float
        When the run ends [s]; it begins at 0.
    figure : str
        A signal whose last value is certified by benchmarks.
    orders : mapping of str to int
        With which power of the step the error falls at least, by how inputs are coupled.
    steps : sequence of float
        Communication steps to run it with [s].
    """

    title: str
    models: Mapping[str, str]
    wires: Sequence[str]
    start: Mapping[str, float]
    stop: float
    figure: str
    orders: Mapping[str, int]
    steps: Sequence[float] = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)

    def system(self, flavour: str = "native", fmus: Path = ROOT / "fmus") -> System:
        """The system with the FMUs of a flavour, "native" for FMI 2.0 or "fmi3"."""
        return System(
            {part: fmu_file(model, flavour, fmus) for part, model in self.models.items()},
            self.wires,
            self.start,
        )

    @property
    def signals(self) -> list[str]:
        """The outputs that other parts take, in the order of the wires."""
        return list(dict.fromkeys(source for source, _ in self.wire_ends))

    @property
    def wire_ends(self) -> list[tuple[str, str]]:
        """Source and target of each wire; no wire here has a factor."""
        return [(a, b) for a, _, b in map(str.split, self.wires)]


def fmu_file(model: str, flavour: str, fmus: Path) -> Path:
    """The FMU of a component, or of a model in `models`."""
    name = "".join(word[:1].upper() + word[1:] for word in model.split("_"))
    folder = fmus / "reference" if (MODELS / f"{model}.py").is_file() else fmus
    return folder / flavour / f"{name}.fmu"


def build_fmus(platforms: str = "host", fmus: Path = ROOT / "fmus") -> list[str]:
    """Build the FMUs of all systems that are not up to date, for "host" or "all"; the errors of those that failed.

    Without a compiler those that are there are taken as they are.
    """
    if find_spec("ziglang") is None:
        return require_fmus(fmus)
    names = {model for system in SYSTEMS.values() for model in system.models.values()}
    files = [MODELS / f"{name}.py" for name in sorted(names)]
    own = [file for file in files if file.is_file()]
    rest = [ROOT / "components" / file.stem / "model.py" for file in files if file not in own]
    return [
        error
        for flavour in ("native", "fmi3")
        for models, folder in ((own, fmus / "reference"), (rest, fmus))
        for error in make_all(models, flavour, folder, platforms=platforms)
    ]


def require_fmus(fmus: Path) -> list[str]:
    """Print and return what to install where an FMU of a system is missing."""
    flavours = ("native", "fmi3")
    parts = (
        x
        for system in SYSTEMS.values()
        for y in flavours
        for x in system.system(y, fmus).parts.values()
    )
    missing = sorted(
        {str(Path(path).relative_to(fmus)) for path in parts if not Path(path).is_file()}
    )
    if not missing:
        return []
    error = (
        f'{", ".join(missing)} must be built first, which needs a C compiler: write pip install "drive-fmus[native]", in a '
        "clone uv sync --extra native"
    )
    print(f"error: {error}", file=sys.stderr)
    return [error]


CONVEYOR = {
    "conveyor.rotor.J": 0.49, "conveyor.crank.r": 0.01, "conveyor.trough.m": 200.0, "conveyor.trough.d": 4000.0,
    "conveyor.spring.c": 720e3, "conveyor.phi": 0.0,
}  # fmt: skip
DRIVE = {"motor": "drive_motor", "conveyor": "crank_conveyor"}
TURN = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
TWO_MASSES = {"first": "gearbox", "shaft": "shaft_link", "second": "gearbox"}
ELASTIC = (
    "first.w_b -> shaft.w_a", "shaft.tau_a -> first.tau_b", "second.w_a -> shaft.w_b",
    "shaft.tau_b -> second.tau_a",
)  # fmt: skip
MASSES = {
    "first.i": 1.0, "first.eta": 1.0, "first.J": 1.1, "second.i": 1.0, "second.eta": 1.0, "second.J": 2.2,
    "shaft.b": 0.0,
}  # fmt: skip
SYSTEMS = {
    "conveyor_drive_a": ReferenceSystem(
        "Vibrating conveyor at its resonance, turned by a stiff motor",
        DRIVE,
        TURN,
        {"motor.A": 8000.0, "motor.B": 199.8, "motor.T": 0.0625, "motor.tau": 8.0, "conveyor.w": 40.0}
        | CONVEYOR,
        0.5,
        "motor.tau",
        SMOOTH_ORDERS,
    ),
    "conveyor_drive_b": ReferenceSystem(
        "The same conveyor, turned by a soft motor",
        DRIVE,
        TURN,
        {"motor.A": 1440.0, "motor.B": 35.8, "motor.T": 0.02, "motor.tau": 8.0, "conveyor.w": 40.0}
        | CONVEYOR,
        0.5,
        "motor.tau",
        SMOOTH_ORDERS,
    ),
    "two_masses": ReferenceSystem(
        "Two masses on an elastic shaft with little damping",
        TWO_MASSES,
        ELASTIC,
        {"first.tau_a": 0.0, "second.tau_b": 0.0, "first.w_a": 10.0, "second.w_a": 10.0, "shaft.c": 1e4,
         "shaft.d": 1.0, "shaft.twist": 0.01} | MASSES,
        1.0,
        "shaft.twist",
        PASSED_ON_ORDERS,
    ),
    "controlled_drive": ReferenceSystem(
        "Direct-current motor with controller, gearbox, elastic shaft and conveyor",
        {"controller": "speed_controller", "motor": "DC_motor", "gear": "gearbox", "shaft": "shaft_link",
         "conveyor": "crank_conveyor"},
        ("controller.tau => motor.v", "gear.w_a -> motor.w", "gear.w_a -> controller.w", "motor.tau -> gear.tau_a",
         "shaft.tau_a -> gear.tau_b", "gear.w_b -> shaft.w_a", "conveyor.w -> shaft.w_b", "shaft.tau_b -> conveyor.tau"),
        {"controller.K": 5.0, "controller.T_i": 0.5, "controller.T_t": 0.1, "controller.tau_max": 75.0,
         "controller.w_ref": 150.0, "controller.tau_i": 0.0, "motor.R": 0.5, "motor.L": 0.002, "motor.k": 0.2,
         "motor.i": 0.0, "gear.i": 5.0, "gear.eta": 0.9, "gear.J": 0.01, "gear.w_0": 0.1, "gear.w_a": 100.0,
         "shaft.b": 0.0, "shaft.c": 4000.0, "shaft.d": 5.0, "shaft.twist": 0.0, "conveyor.w": 20.0} | CONVEYOR,
        1.0,
        "conveyor.w",
        PASSED_ON_ORDERS,
    ),
    "quarter_car": ReferenceSystem(
        "Quarter car on a step of the road",
        {"wheel": "wheel", "chassis": "chassis"},
        ("wheel.z -> chassis.z_w", "wheel.v -> chassis.v_w", "chassis.z -> wheel.z_c", "chassis.v -> wheel.v_c"),
        {"wheel.m": 40.0, "wheel.k": 150e3, "wheel.h": 0.1, "wheel.c": 15e3, "wheel.d": 1e3, "wheel.z": 0.0,
         "wheel.v": 0.0, "chassis.m": 400.0, "chassis.c": 15e3, "chassis.d": 1e3, "chassis.z": 0.0,
         "chassis.v": 0.0},
        2.0,
        "chassis.z",
        SMOOTH_ORDERS,
    ),
    "event_within_step": ReferenceSystem(
        "Hammer that bounces on an anvil, hung from a frame: its speed jumps within a step",
        {"hammer": "hammer", "frame": "frame"},
        ("hammer.z -> frame.z", "hammer.v -> frame.v", "frame.f -> hammer.f"),
        {"hammer.m": 2.0, "hammer.g": 9.81, "hammer.e": 0.7, "hammer.z": 0.05, "hammer.v": 0.0, "frame.m": 20.0,
         "frame.c_0": 8e4, "frame.d_0": 50.0, "frame.c": 500.0, "frame.d": 5.0, "frame.z_frame": 0.0,
         "frame.v_frame": 0.0},
        0.3,
        "hammer.z",
        JUMP_ORDERS,
    ),
    "input_jump": ReferenceSystem(
        "Motor whose voltage is switched at no communication point",
        {"source": "pulse", "motor": "DC_motor", "rotor": "gearbox"},
        ("source.v -> motor.v", "rotor.w_a -> motor.w", "motor.tau -> rotor.tau_a"),
        {"source.V": 48.0, "source.t_1": 0.10037, "source.t_2": 0.30121, "motor.R": 0.5, "motor.L": 0.002,
         "motor.k": 0.2, "motor.i": 0.0, "rotor.i": 1.0, "rotor.eta": 1.0, "rotor.J": 0.002, "rotor.w_a": 0.0,
         "rotor.tau_b": 0.0},
        0.5,
        "rotor.w_a",
        JUMP_ORDERS,
    ),
    "stiff_bond": ReferenceSystem(
        "Two masses on a shaft so stiff that it swings within a step",
        TWO_MASSES,
        ELASTIC,
        {"first.tau_a": 20.0, "second.tau_b": -5.0, "first.w_a": 0.0, "second.w_a": 0.0, "shaft.c": 1e7,
         "shaft.d": 2000.0, "shaft.twist": 0.0} | MASSES,
        0.2,
        "first.w_b",
        PASSED_ON_ORDERS,
    ),
}  # fmt: skip
