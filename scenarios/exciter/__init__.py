"""The questions about one machine."""
