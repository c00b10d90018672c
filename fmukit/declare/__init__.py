"""Declarations of a model: variables with quantity, start, bounds and meaning."""
