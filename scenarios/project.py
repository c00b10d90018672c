"""The package as a project of the workbench: its questions, and where their FMUs are."""

from workbench.project import Project

from . import fmu_files

PROJECT = Project(fmu_files.PACKAGE, fmu_files.FOLDERS, fmu_files.problem)
PROGRAM = "scenarios"
