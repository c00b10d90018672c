"""Systems from and to .ssp files (System Structure and Parameterization 1.0)."""

from .read import Package, read_ssp
from .write import write_ssp

__all__ = ["Package", "read_ssp", "write_ssp"]
