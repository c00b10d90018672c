"""What a user writes of a system, and the network that is checked before a run."""

from .base_units import (
    ANGLE,
    BASES,
    unit_conversion,
    unit_exponents,
)
from .description import (
    NUMERIC,
    READ,
    STATE,
    VARIABLE_STEP,
    ModelDescription,
    Value,
    Variable,
    declared_start,
    enumeration,
    feedthrough,
    parts_without,
)
from .network import (
    Connection,
    Network,
    connect,
    connect_for_export,
    require_cosimulation,
    require_fmi2,
    run_obstacles,
    types_match,
)
from .ports import (
    Port,
    conversion_to,
    is_continuous_input,
)
from .reading import (
    TERMINALS,
    describe_fmu,
    legal_part_name,
    time_and_size,
)
from .start_values import (
    literal,
    value_of_text,
)
from .wires import (
    System,
    Wire,
)

__all__ = [
    "ANGLE",
    "BASES",
    "NUMERIC",
    "READ",
    "STATE",
    "TERMINALS",
    "VARIABLE_STEP",
    "Connection",
    "ModelDescription",
    "Network",
    "Port",
    "System",
    "Value",
    "Variable",
    "Wire",
    "connect",
    "connect_for_export",
    "conversion_to",
    "declared_start",
    "describe_fmu",
    "enumeration",
    "feedthrough",
    "is_continuous_input",
    "legal_part_name",
    "literal",
    "parts_without",
    "require_cosimulation",
    "require_fmi2",
    "run_obstacles",
    "time_and_size",
    "types_match",
    "unit_conversion",
    "unit_exponents",
    "value_of_text",
]
