"""What a run is worth: errors, damping, words, and a process of its own for it."""
