"""What JSON can express."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

Json = None | bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"]


def json_text(value: Json) -> str:
    """The value as readable JSON, a line at the end; numbers that JSON cannot express are null."""
    return f"{json.dumps(without_infinities(value), indent=2)}\n"


def without_infinities(value: Json) -> Json:
    """The value in which numbers that JSON cannot express are null."""
    if isinstance(value, Mapping):
        return {key: without_infinities(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [without_infinities(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
