"""Component in, FMU out: pages, packing and the checks no public tool makes."""
