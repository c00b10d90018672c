"""A function that needs nothing but Python."""

import sys


def modules(_: None) -> list[str]:
    """What is loaded here."""
    return sorted(sys.modules)
