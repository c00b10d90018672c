"""Design studies: a TOML file says which inputs of a scenario vary, and a table shows the results."""

from .file import Study, load
from .run import run, work

__all__ = ["Study", "load", "run", "work"]
