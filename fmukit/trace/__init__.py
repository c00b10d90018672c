"""Equations run with symbols: what they compute, as trees."""
