"""The native FMU: C compiled for every platform."""
