"""The physics: one module, one model, one FMU."""

CATALOGUE = ("drive_motor", "crank_conveyor", "iron_drive", "gravity_orientator", "linear_system")

PYTHON_ONLY = {"linear_system": "its matrix exponential is computed in decimals, which C has not"}
