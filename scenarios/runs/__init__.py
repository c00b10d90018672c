"""Runs of scenarios in processes of their own, on this machine and on a cluster."""
