"""Design studies: a TOML file says which inputs of a scenario vary, a table says what came of it."""

from .plan import Study, load
from .run import run

__all__ = ["Study", "load", "run"]
