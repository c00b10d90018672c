"""The FMUs of a system on their wires, for any number of runs one after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import MappingProxyType

from ..errors import FmuError, SetupError
from ..fmu.buffers import Slot
from ..fmu.fmi2 import CoSimulation2
from ..fmu.fmi3 import CoSimulation3
from ..fmu.instance import CoSimulation
from ..fmu.library import Library
from ..system import Network, Value
from ..system.description import ModelDescription, Variable
from .algorithms import find_algorithm
from .energy import by_bond
from .initialise import WiredParts, add_bond_sides, interpolate_inputs
from .iteration import Iteration
from .links import Link
from .loop import Loop, lay_out
from .moments import Moments, event_watches
from .part import Part
from .process_guard import ProcessGuard
from .row import RowReader
from .schedule import Advance, coupling_context, explicit, schedule
from .setup import Setup
from .snapshot import SystemState, require_same_buffers, resume

#: The tools whose FMUs have no variables besides those of their instances, so that each thread may have instances of
#: its own and a reset leaves nothing behind: their binaries have neither .data nor .bss, which a test shows of every FMU
#: that is built here. Others may differ after a reset at times, which no number of trials can rule out.
KNOWN_TOOLS = ("build_fmus.py",)


def open_cosimulation(
    name: str, description: ModelDescription, fmu: Library, within: Sequence[Variable] = ()
) -> CoSimulation:
    """An instance that steps, and shows the variables `within` its steps if it can; raises FmuError."""
    kind = CoSimulation2 if description.fmiVersion == "2.0" else CoSimulation3
    return kind(name, description, fmu, within)


def is_reset_trusted(network: Network) -> bool:
    """Whether all FMUs are of tools whose instances keep nothing over a reset."""
    descriptions = network.descriptions.values()
    return all((d.generationTool or "").startswith(KNOWN_TOOLS) for d in descriptions)


class SystemInstance:
    """Instances of all FMUs of a checked system, by the settings of its runs but for step, stop and distance of rows.

    Instances that keep nothing over a reset begin again; of other tools' FMUs each run has new ones.

    Attributes
    ----------
    parts, stepped
        The parts by name, and in their stepping order.
    bonds
        The two sides of each power bond.
    parameters
        What reads the parameters of each part.
    steps
        The operations of an explicit step; None of an implicit algorithm.
    order, first_order, instant
        With which order results converge, which outputs only with the first, and which wired ones have direct feedthrough.
    chunk
        Fixed steps that are taken at once: as many as the last run could take in a short time.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.state: SystemState | None = None
        self.is_reset_trusted = is_reset_trusted(setup.network)
        self.chunk = 16
        self.process = ProcessGuard()
        self._stack = ExitStack()
        self._wired: WiredParts[CoSimulation] | None = None
        self.begins_again = self._shows_within = False
        self.parts: dict[str, Part] = {}

    def begin(
        self,
        setup: Setup,
        state: SystemState | None = None,
        case: Mapping[str, Value] = MappingProxyType({}),
    ) -> None:
        """Be at the start of a run, with its start values or those of a case over them, or in a state, ready for a step.

        Raises SetupError where an FMU refuses, where the start values have no solution, and for the state of another system.
        """
        self.setup, self.state = setup, state
        network, settings = setup.network, setup.settings
        try:
            is_new = self._be_as_new()
            assert self._wired is not None
            if state is None:
                self._wired.begin(network, settings, setup.sequence, case)
            else:
                self._wired.wire(network, settings, {})
            if self.parts is not self._wired.parts:
                self._lay_out(self._wired.slots)
            if state is None:
                self._begin_steps()
            else:
                self._resume(state)
            if is_new:
                self.process.restore()
        except FmuError as error:
            self.process.restore()
            raise SetupError(str(error)) from error

    def close(self) -> None:
        """Free the instances; the next run has new ones."""
        self.detach().close()
        self.process.restore()

    def rest(self) -> None:
        """Free the instances if they cannot begin again."""
        if not self.begins_again:
            self.close()

    def detach(self) -> ExitStack:
        """Leave the instances to who closes this stack; the next run has new ones."""
        self._wired, self.parts = None, dict[str, Part]()
        return self._stack.pop_all()

    @property
    def is_abandoned(self) -> bool:
        """Whether an FMU may not be called any more."""
        instances = () if self._wired is None else self._wired.instances.values()
        return any(instance.session.fmu.abandoned for instance in instances)

    def _be_as_new(self) -> bool:
        """Reset the instances, or make new ones, whether the latter; raises FmuError."""
        shows_within = self.setup.settings.steps_per_row() is None
        lent = {} if self.state is None else self.state.live
        may = self.begins_again and shows_within == self._shows_within and not lent
        if self._wired is not None and may and self._wired.reset():
            return False
        self.close()
        self.process = ProcessGuard()
        self.begins_again, self._shows_within = self.is_reset_trusted and not lent, shows_within
        within = self.setup.ports if shows_within else ()

        def opener(name: str, description: ModelDescription, fmu: Library) -> CoSimulation:
            watched = [port.variable for port in within if port.part == name]
            return open_cosimulation(name, description, fmu, watched)

        self._wired = WiredParts(self.setup.network, self._stack, opener, lent)
        return True

    def _lay_out(self, slots: Mapping[str, Slot]) -> None:
        """What follows from the wired parts and the settings."""
        assert self._wired is not None
        setup, self.parts = self.setup, self._wired.parts
        settings = setup.settings
        if settings.input_order:
            interpolate_inputs(self.parts, settings.input_order)
        add_bond_sides(setup.network, self.parts, slots, setup.bonds)
        self.stepped = [self.parts[name] for name in setup.sequence]
        self.bonds = by_bond(side for part in self.parts.values() for side in part.bond_sides)
        self.parameters = {
            name: part.instance.session.reader(
                [v for v in part.description.modelVariables if v.causality == "parameter"]
            )
            for name, part in self.parts.items()
        }
        self.row = RowReader(list(self.parts.values()), setup.ports)
        algorithm = find_algorithm(settings.algorithm)
        by_name = {part.name: part for part in self.stepped}
        self.steps = (
            None if algorithm.is_implicit else schedule(algorithm.stages(setup.sequence), by_name)
        )
        context = coupling_context(self.stepped, settings.input_order)
        self.order = algorithm.convergence_order(context)
        self.first_order = algorithm.first_order_outputs(context)
        self.instant = {each.output for each in context.feedthroughs if each.is_wired}
        self.forget_loop()

    def links(self) -> list[Link]:
        """The ends of all wires at the inputs."""
        return [link for part in self.stepped for link in part.links]

    def forget_loop(self) -> None:
        """Lay out the steps in C anew, after a link has changed."""
        self._loop: list[Loop | OSError | None] = []

    def loop(self) -> Loop | OSError | None:
        """The steps in C, or why they cannot be; None where steps need Python."""
        if not self._loop:
            watches, steps = event_watches(self.stepped), self.steps
            program = None if steps is None else lay_out(watches, steps, self.row.extra)
            try:
                self._loop = [None if program is None else Loop(program, self.row.columns)]
            except OSError as error:
                self._loop = [error]
        return self._loop[0]

    def advance(self) -> Advance:
        """The step of all parts, whatever jumps."""
        if self.steps is None:
            return Iteration(find_algorithm(self.setup.settings.algorithm), self.stepped)
        loop = self.loop()
        return explicit(self.steps) if loop is None or isinstance(loop, OSError) else loop.advance

    def _begin_steps(self) -> None:
        """Go through the events of the start; read what steps begin with."""
        start = self.setup.settings.start
        Moments(self.stepped, ()).happen(start)
        for part in self.parts.values():
            for operation in part.read_operations():
                operation(start, 0.0)
            for side in part.bond_sides:
                side.begin_with_present_output()

    def _resume(self, state: SystemState) -> None:
        """Take the state of another run; raises FmuError, SetupError."""
        for name, part in self.parts.items():
            require_same_buffers(part, state.parts[name])
        for name, part in self.parts.items():
            resume(part, state.parts[name])
