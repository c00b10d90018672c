"""What makes the parts of a system step together."""
