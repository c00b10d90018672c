"""Couple co-simulation FMUs of FMI 2.0 and 3.0: systems of parts and wires, and their coupling errors."""

from .names import load_on_request

__version__ = "1.0.0"

__getattr__, __dir__, __all__ = load_on_request(__name__, __file__)
