"""The FMU that runs in a Python interpreter."""
