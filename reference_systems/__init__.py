"""Coupled systems with exact answers, for whoever makes a co-simulation master."""
