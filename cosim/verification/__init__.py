"""Does the master do what theory says? Linear systems with known answers."""
