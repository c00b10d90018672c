"""Analysis of coupled systems and of results: damping, linearisation, coupling theory, comparison, crosscheck."""
