"""The package as a project of the workbench: its questions, and where their FMUs are."""

from workbench.project import Project

from . import fmu_files
from .old_names import OLD_NAMES

PROJECT = Project(fmu_files.PACKAGE, fmu_files.FOLDERS, fmu_files.problem, OLD_NAMES)
PROGRAM = "scenarios"
