"""Direct feedthrough as a model declares it, compared with what its traced outputs are computed from."""

from __future__ import annotations

from collections.abc import Iterator

from ..declare.interface import Interface, Variable
from .dependencies import arguments_of
from .graph import Function


def require(interface: Interface, outputs: Function) -> None:
    """Raise TypeError for an output with direct feedthrough from an input that it does not declare.

    `outputs` is the traced function of the outputs; its parameter `u` has the inputs in their order.
    """
    for output, inputs in inputs_by_output(interface, outputs):
        declared = output.declaration.feedthrough
        missing = [name for name in inputs if name not in declared]
        if missing:
            raise TypeError(
                f"{output.name} of Outputs depends on {' and '.join(missing)} without delay: "
                f"write {declaration_line(output, (*declared, *missing))}"
            )


def superfluous_declarations(interface: Interface, outputs: Function) -> Iterator[str]:
    """A sentence for each output that declares an input without direct feedthrough to it."""
    for output, inputs in inputs_by_output(interface, outputs):
        declared = output.declaration.feedthrough
        idle = [name for name in declared if name not in inputs]
        if idle:
            rest = tuple(name for name in declared if name in inputs)
            yield (
                f"{output.name} of Outputs declares feedthrough of {' and '.join(idle)}, which its "
                f"equation does not use: write {declaration_line(output, rest)}"
            )


def inputs_by_output(
    interface: Interface, outputs: Function
) -> Iterator[tuple[Variable, list[str]]]:
    """Each calculated output with the names of the inputs with direct feedthrough to it."""
    inputs = interface.variables[interface.inputs]
    arguments_by_output = arguments_of(outputs)
    for output, arguments in zip(
        interface.variables[interface.outputs], arguments_by_output, strict=True
    ):
        yield output, [v.name for index, v in enumerate(inputs) if ("u", index) in arguments]


def declaration_line(output: Variable, feedthrough: tuple[str, ...]) -> str:
    """The declaration of an output with this feedthrough, as its class has it."""
    base_name, _, index = output.name.partition("[")
    function_name = (
        "array" if index else "real" if output.declaration.fmi_type == "Real" else "discrete"
    )
    inputs = "".join(f'"{name}", ' for name in feedthrough)
    end = f", feedthrough=({inputs.strip()})" if feedthrough else ""
    return f'{base_name}: ... = {function_name}(..., "..."{end})'
