"""Traced equations as C and as Python."""
