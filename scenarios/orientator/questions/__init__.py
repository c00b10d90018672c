"""The questions about this machine; none imports another."""
