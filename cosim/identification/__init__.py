"""A machine from its record: parameters, start values and what follows from them, with intervals."""
